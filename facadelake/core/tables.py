"""Arrow tables of the stages: the columns of schemas/ without the run keys, which the commit adds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from facadelake.core.errors import SchemaError
from schemas.tables import LAKE_TABLES, TABLES

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECONDS = {"s": 1_000_000, "ms": 1000, "us": 1}
# One row of a table: its values by column.
Row = dict[str, Any]


def get_stage_schema(name: str) -> pa.Schema:
    """The Arrow schema of table ``name`` as a stage makes it: without building_id, campaign_id and run_id.

    Tables of the history have them, since their rows are of several campaigns.
    """
    table = LAKE_TABLES[name]
    return pa.schema([table.arrow.field(column.name) for column in table.stage_columns])


def table_from_rows(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """The rows as table ``name``; optional columns may be missing in a row.

    Raises SchemaError for a column the table does not have, a missing required one, or a value of another type.
    """
    schema = get_stage_schema(name)
    for row in rows:
        unknown = row.keys() - set(schema.names)
        if unknown:
            raise SchemaError(f"table {name} has no column {sorted(unknown)}; its columns are {schema.names}")
    try:
        table = pa.Table.from_pylist([dict(row) for row in rows], schema=schema)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise SchemaError(f"table {name}: {error}") from error
    return check_table(name, table)


def check_table(name: str, table: pa.Table) -> pa.Table:
    """Return ``table`` if it has the columns and types of table ``name``.

    Raises SchemaError for other columns or types, and for nulls in required columns.
    """
    schema = get_stage_schema(name)
    if not table.schema.equals(schema):
        raise SchemaError(
            f"table {name} has the columns {table.schema.to_string()}; schemas/ declares {schema.to_string()}"
        )
    for field in schema:
        empty = table.column(field.name).null_count
        if empty and not field.nullable:
            raise SchemaError(f"table {name}: {empty} of {len(table)} rows have no {field.name}, which is required")
    return table


def write_table(name: str, table: pa.Table, folder: Path) -> Path:
    """Write ``folder/<name>.parquet`` and return its path."""
    path = folder / f"{name}.parquet"
    pq.write_table(check_table(name, table), path)
    return path


def read_table(name: str, folder: Path) -> pa.Table:
    """Read ``folder/<name>.parquet`` and check it against schemas/."""
    return check_table(name, pq.read_table(folder / f"{name}.parquet"))


def add_run_keys(name: str, table: pa.Table, *, building_id: str, campaign_id: str, run_id: str) -> pa.Table:
    """Prepend the columns of the run keys to a table of a stage.

    Args:
        name: the table of schemas/.
        table: rows of the stage, without run keys.
        building_id: the building of all rows.
        campaign_id: the campaign of all rows.
        run_id: the run that computed the rows.

    Returns:
        The table with the columns that the lake stores.
    """
    keys = {"building_id": building_id, "campaign_id": campaign_id, "run_id": run_id}
    columns = [pa.array([value] * len(table), pa.string()) for value in keys.values()]
    return pa.Table.from_arrays([*columns, *table.columns], schema=TABLES[name].arrow)


def list_rows(table: pa.Table) -> list[dict[str, Any]]:
    """The rows by column name; times are in UTC.

    As ``to_pylist``, which imports pandas for times with a zone: 0.25 s in a command that prints ten rows.
    """
    columns = [_list_values(table.column(name)) for name in table.column_names]
    return [dict(zip(table.column_names, values, strict=True)) for values in zip(*columns, strict=True)]


def _list_values(column: pa.ChunkedArray) -> list[Any]:
    kind = column.type
    if not pa.types.is_timestamp(kind) or kind.tz is None or kind.unit not in _MICROSECONDS:
        return list(column.to_pylist())
    factor = _MICROSECONDS[kind.unit]
    numbers = [number for chunk in column.chunks for number in chunk.view(pa.int64()).to_pylist()]
    return [None if number is None else _EPOCH + timedelta(microseconds=number * factor) for number in numbers]
