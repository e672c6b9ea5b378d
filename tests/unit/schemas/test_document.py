"""docs/tables.md and the tables' definitions."""

from pathlib import Path

from facadelake.core.tables import get_stage_schema
from schemas.column_type import Kind
from schemas.columns import COLUMNS
from schemas.document import build_document
from schemas.expectations import derive_expectations
from schemas.tables import LAKE_TABLES, RUN_KEYS, TABLES

REPOSITORY = Path(__file__).resolve().parents[3]


def test_document_is_current() -> None:
    text = (REPOSITORY / "docs" / "tables.md").read_text("utf-8")
    assert text == build_document(), "run: python -m schemas.document > docs/tables.md"


def test_every_column_is_used_by_a_table_and_says_its_unit() -> None:
    used = {column.name for table in LAKE_TABLES.values() for column in table.columns}
    assert used == set(COLUMNS)
    for name in used:
        for suffix, unit in (("_m", "m"), ("_mm", "mm"), ("_deg", "deg"), ("_px", "px"), ("_m2", "m2")):
            if name.endswith(suffix):
                assert COLUMNS[name].unit == unit, name


def test_keys_are_columns_that_are_never_empty() -> None:
    for table in LAKE_TABLES.values():
        names = {column.name for column in table.columns if column.name not in table.optional}
        assert set(table.key) <= names, table.name
        assert set(RUN_KEYS) <= names, table.name


def test_expectations_cover_every_plain_column_that_promises_something() -> None:
    for table in TABLES.values():
        looked_at = {name for one in derive_expectations(table) for name in one.columns}
        for column in table.columns:
            promises = column.name not in table.optional or column.allowed or column.minimum is not None
            if promises and column.kind is not Kind.GEOMETRY and column.name not in RUN_KEYS:
                assert column.name in looked_at, f"{table.name}.{column.name}"


def test_expectations_ask_for_the_stage_tables_columns() -> None:
    for table in TABLES.values():
        first = derive_expectations(table)[0]
        plain = [name for name in get_stage_schema(table.name).names if name not in table.geometry_columns]
        assert first.settings == {"column_list": plain}
