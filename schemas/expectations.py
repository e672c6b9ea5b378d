"""The expectations of a table that its columns imply, by their names in Great Expectations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from schemas.column_type import Kind
from schemas.tables import Table


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """One expectation; ``columns`` are those it looks at (none: the whole table), ``settings`` its other arguments."""

    name: str
    columns: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)


def derive_expectations(table: Table) -> tuple[Expectation, ...]:
    """The expectations of a stage table, which has no run keys: columns, rows, key, empty, allowed and limited values.

    A table whose key is run keys alone has one row.
    """
    return tuple(_derive_column_expectations(table))


def _derive_column_expectations(table: Table) -> Iterator[Expectation]:
    columns = table.stage_columns
    key = tuple(name for name in table.key if name not in table.filled_at_commit)
    yield Expectation(
        name="expect_table_columns_to_match_ordered_list",
        settings={"column_list": [column.name for column in columns if column.kind is not Kind.GEOMETRY]},
    )
    if not key:
        yield Expectation(name="expect_table_row_count_to_equal", settings={"value": 1})
    elif not table.may_be_empty:
        yield Expectation(name="expect_table_row_count_to_be_between", settings={"min_value": 1})
    if len(key) == 1:
        yield Expectation(name="expect_column_values_to_be_unique", columns=key)
    elif key:
        yield Expectation(name="expect_compound_columns_to_be_unique", columns=key)
    for column in columns:
        if column.kind is Kind.GEOMETRY:
            continue  # Great Expectations has no geometry type; sql/checks compare it with the coordinate columns
        if column.name not in table.optional:
            yield Expectation(name="expect_column_values_to_not_be_null", columns=(column.name,))
        if column.allowed:
            yield Expectation(
                name="expect_column_values_to_be_in_set",
                columns=(column.name,),
                settings={"value_set": list(column.allowed)},
            )
        limits = {"min_value": column.minimum, "max_value": column.maximum}
        given = {name: value for name, value in limits.items() if value is not None}
        if given:
            yield Expectation(name="expect_column_values_to_be_between", columns=(column.name,), settings=given)
