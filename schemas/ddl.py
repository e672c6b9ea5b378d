"""The tables' SQL, for the first migration: ``python -m schemas.ddl > sql/migrations/0001_tables.sql``.

Once a lake has left the house, a change of schemas/ is a new migration written by hand; a test compares the outcome
of all migrations with schemas/.
"""

from __future__ import annotations

from schemas.column import GEO_CRS
from schemas.tables import LAKE_TABLES, Table

HEADER = """-- The first tables, made from schemas/ by `python -m schemas.ddl`.
-- Never edit a migration that a lake outside has seen: add the next one.
"""


def create_table(table: Table) -> str:
    """``CREATE TABLE`` of one table, NOT NULL where a value is required (DuckLake has no keys; checks test them)."""
    width = max(len(column.name) for column in table.columns)
    lines = [
        f"    {column.name:<{width}} {column.kind.sql}" + ("" if column.name in table.optional else " NOT NULL")
        for column in table.columns
    ]
    comments = [
        f"COMMENT ON COLUMN {table.name}.{name} IS '{GEO_CRS}: longitude, latitude, ellipsoidal height';\n"
        for name in table.geometry_columns
    ]
    body = f"CREATE TABLE {table.name} (\n" + ",\n".join(lines) + "\n);\n"
    return f"-- {table.name}: one row per {table.grain}\n{body}{''.join(comments)}"


def main() -> None:
    """Print the SQL of all tables."""
    print("\n".join([HEADER, *(create_table(table) for table in LAKE_TABLES.values())]), end="")


if __name__ == "__main__":
    main()
