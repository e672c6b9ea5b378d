"""Read the lake's tables, now or as of an earlier version."""

from __future__ import annotations

from pathlib import Path

import duckdb
import pyarrow as pa

from facadelake.errors import SchemaError, StoreError
from facadelake.lake.connect import reading, store_errors
from facadelake.lake.migrate import refuse_newer, schema_version
from facadelake.lake.sqlfiles import statements
from schemas.columns import Kind
from schemas.tables import SCHEMA_VERSION, TABLES


def check_version(connection: duckdb.DuckDBPyConnection, lake: Path) -> None:
    """Raise StoreError unless the attached lake has the schema version that this Facadelake reads."""
    with store_errors(f"reading the lake {lake}", "check that its files are whole"):
        found = schema_version(connection)
    refuse_newer(found, SCHEMA_VERSION)
    if found < SCHEMA_VERSION:
        raise StoreError(
            f"the lake {lake} had schema version {found} then, this Facadelake reads {SCHEMA_VERSION}; "
            "inspect any campaign once more to bring the lake up to date, or ask for a later version"
        )


def read_table(
    lake: Path,
    name: str,
    *,
    building_id: str | None = None,
    campaign_id: str | None = None,
    as_of: int | None = None,
) -> pa.Table:
    """Rows of table ``name`` ordered by its key, in the lake's columns; geometry is WKB (EPSG:4979).

    Without building or campaign all of them; without ``as_of`` the newest version. Raises SchemaError for a table
    that there is not, StoreError for a lake that cannot be read or has no such version.
    """
    if name not in TABLES:
        raise SchemaError(f"there is no table {name}; the tables are {', '.join(TABLES)}")
    kind = TABLES[name]
    columns = [f"ST_AsWKB({c.name}) AS {c.name}" if c.kind is Kind.GEOMETRY else c.name for c in kind.columns]
    wanted = {"building_id": building_id, "campaign_id": campaign_id}
    given = {key: value for key, value in wanted.items() if value is not None}
    where = f"WHERE {' AND '.join(f'{key} = ?' for key in given)}" if given else ""
    with reading(lake, as_of=as_of) as connection:
        check_version(connection, lake)
        with store_errors(f"reading {name} of the lake {lake}", "check that the lake's files are whole"):
            rows = connection.execute(
                f"SELECT {', '.join(columns)} FROM lake.{name} {where} ORDER BY {', '.join(kind.key)}",
                list(given.values()),
            ).to_arrow_table()
    return rows.cast(kind.arrow)


def versions(lake: Path) -> pa.Table:
    """One row per commit: version, committed_at (UTC), building_id, campaign_id, run_id; the oldest first."""
    with reading(lake) as connection:
        check_version(connection, lake)
        with store_errors(f"reading the versions of the lake {lake}", "check that the lake's files are whole"):
            view = next(view for view in statements("views") if view.name == "versions")
            rows = connection.execute(f"SELECT * FROM ({view.sql}) ORDER BY version").to_arrow_table()
    return rows.cast(
        pa.schema(
            [
                ("version", pa.int64()),
                ("committed_at", pa.timestamp("us", tz="UTC")),
                ("building_id", pa.string()),
                ("campaign_id", pa.string()),
                ("run_id", pa.string()),
            ]
        )
    )
