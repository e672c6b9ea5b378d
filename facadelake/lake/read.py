"""Read the lake at any version: whole tables, or a SELECT; nothing here can write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import duckdb
import pyarrow as pa

from facadelake.core.checkout import locate_source
from facadelake.core.duckdb_engine import find_extension_file, quote_sql_string, quote_sql_value, wrap_store_errors
from facadelake.core.errors import InputDataError, SchemaError, StoreError
from facadelake.core.sql_files import read_statements
from facadelake.core.sql_guard import require_plain_select
from facadelake.lake.connect import DATA, open_to_read
from facadelake.lake.damage import name_damaged_files, wrap_lake_errors
from facadelake.lake.migrate import get_schema_version, refuse_newer
from schemas.column_type import Kind
from schemas.tables import LAKE_TABLES, SCHEMA_VERSION

VIEWS = locate_source("sql/views")
EARLIER = locate_source("sql/earlier")
SPATIAL = ("spatial",)
NO_EXTENSION = ()
Value = str | int | float | bool | None


def present_current_schema(connection: duckdb.DuckDBPyConnection, lake: Path) -> None:
    """Present tables of an earlier schema (an old version, or a lake not yet migrated) with the current columns.

    Views of ``sql/earlier/<schema version>/`` shadow the tables in this connection; the lake is not written.
    Raises StoreError for a lake that a newer Facadelake has written.
    """
    with wrap_store_errors(f"reading the lake {lake}", "check that its files are whole"):
        found = get_schema_version(connection)
        refuse_newer(found, SCHEMA_VERSION)
        newest: dict[str, str] = {}
        for version in range(found, SCHEMA_VERSION):
            for step in read_statements(EARLIER / str(version)):
                view = f"{step.name}_of_schema_{version + 1}"
                source = newest.get(step.name, f"lake.{step.name}")
                connection.execute(f"CREATE TEMP VIEW {view} AS {step.sql.replace('{earlier}', source)}")
                newest[step.name] = view
        for name, view in newest.items():
            connection.execute(f"CREATE TEMP VIEW {name} AS FROM {view}")


def read_table(
    lake: Path,
    name: str,
    *,
    building_id: str | None = None,
    campaign_id: str | None = None,
    as_of: int | None = None,
) -> pa.Table:
    """Rows of a table ordered by its key; geometry is WKB (EPSG:4979).

    Args:
        lake: folder of the lake.
        name: the table.
        building_id: only this building; None: all.
        campaign_id: only this campaign; None: all.
        as_of: an earlier version; None: the newest.

    Raises SchemaError for an unknown table, StoreError for a lake that cannot be read or has no such version.
    """
    return read_tables(lake, [name], building_id=building_id, campaign_id=campaign_id, as_of=as_of)[name]


def read_tables(
    lake: Path,
    names: Sequence[str],
    *,
    building_id: str | None = None,
    campaign_id: str | None = None,
    as_of: int | None = None,
    columns: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, pa.Table]:
    """Several tables of the same version, by name; arguments as of ``read_table``.

    Args:
        lake: folder of the lake.
        names: the tables.
        building_id: only this building; None: all.
        campaign_id: only this campaign; None: all.
        as_of: an earlier version; None: the newest.
        columns: the columns to read of a table; all of those that it does not name.

    Raises SchemaError for an unknown table, StoreError for a lake that cannot be read or has no such version.
    """
    unknown = [name for name in names if name not in LAKE_TABLES]
    if unknown:
        raise SchemaError(f"there is no table {', '.join(unknown)}; the tables are {', '.join(LAKE_TABLES)}")
    chosen = {"building_id": building_id, "campaign_id": campaign_id}
    given = {key: value for key, value in chosen.items() if value is not None}
    where = f"WHERE {' AND '.join(f'{key} = {quote_sql_value(given[key])}' for key in given)}" if given else ""
    found = {}
    with open_to_read(lake, as_of=as_of) as connection:
        present_current_schema(connection, lake)
        with wrap_lake_errors(
            lake, f"reading {', '.join(names)} of the lake {lake}", "check that the lake's files are whole", as_of
        ):
            connection.execute("BEGIN")  # one transaction sees one version
            for name in names:
                kind = LAKE_TABLES[name]
                wanted = [c for c in kind.columns if c.name in (columns or {}).get(name, kind.arrow.names)]
                selected = [f"ST_AsWKB({c.name}) AS {c.name}" if c.kind is Kind.GEOMETRY else c.name for c in wanted]
                rows = connection.execute(
                    f"SELECT {', '.join(selected)} FROM {name} {where} ORDER BY {', '.join(kind.key)}"
                ).to_arrow_table()
                found[name] = rows.cast(pa.schema([kind.arrow.field(c.name) for c in wanted], kind.arrow.metadata))
    return found


def list_versions(lake: Path) -> pa.Table:
    """One row per commit and campaign: version, committed_at (UTC), building_id, campaign_id (null of a history by
    itself), content, run_id (null where no inspection made the version), code_sha256 (null of regradings, reviews and
    versions of an earlier Facadelake), regraded_by and reviewed_by (null where they did not); the oldest first."""
    with open_to_read(lake) as connection:
        present_current_schema(connection, lake)
        with wrap_lake_errors(
            lake, f"reading the versions of the lake {lake}", "check that the lake's files are whole"
        ):
            view = next(view for view in read_statements(VIEWS) if view.name == "versions")
            rows = connection.execute(f"SELECT * FROM ({view.sql}) ORDER BY version, campaign_id").to_arrow_table()
    return rows.cast(
        pa.schema(
            [
                ("version", pa.int64()),
                ("committed_at", pa.timestamp("us", tz="UTC")),
                ("building_id", pa.string()),
                ("campaign_id", pa.string()),
                ("content", pa.string()),
                ("run_id", pa.string()),
                ("code_sha256", pa.string()),
                ("regraded_by", pa.string()),
                ("reviewed_by", pa.string()),
            ]
        )
    )


def query(lake: Path, sql: str, parameters: Mapping[str, Value] | None = None, *, as_of: int | None = None) -> pa.Table:
    """Rows of one SELECT over the lake's tables and the views of sql/views/; geometry is WKB.

    Spatial functions (ST_...) are available.

    Args:
        lake: folder of the lake.
        sql: the SELECT.
        parameters: values bound to ``$name``.
        as_of: an earlier version; None: the newest.

    Raises InputDataError for anything but a
    SELECT over tables and views, or one that DuckDB cannot answer; StoreError where the lake cannot be read.
    """
    try:
        return _query_with(NO_EXTENSION, lake, sql, parameters, as_of)
    except InputDataError:
        # Loading the spatial extension takes longer than most questions: only for those that need it, or fail.
        return _query_with(SPATIAL, lake, sql, parameters, as_of)


def _query_with(
    extensions: Sequence[str], lake: Path, sql: str, parameters: Mapping[str, Value] | None, as_of: int | None
) -> pa.Table:
    with open_sealed(lake, as_of, extensions) as connection:
        views = {view.name for view in read_statements(VIEWS)}
        require_plain_select(connection, sql, frozenset(LAKE_TABLES) | views)
        try:
            with name_damaged_files(lake, as_of):
                rows = _execute(connection, sql, parameters or {}).to_arrow_table()
        except (duckdb.IOException, duckdb.InternalException, duckdb.FatalException) as error:
            raise StoreError(f"the lake {lake} could not be read: {error}; check that its files are whole") from error
        except duckdb.ConversionException as error:
            raise InputDataError(_describe_conversion(error, parameters)) from error
        except duckdb.Error as error:
            reason = str(error).strip().removeprefix("Invalid Input Error: ")  # what a question's own error() says
            raise InputDataError(f"the question cannot be answered: {reason}") from error
    names = _make_unique(rows.schema.names)
    plain = [  # without DuckDB's metadata
        pa.field(name, field.type, field.nullable) for name, field in zip(names, rows.schema, strict=True)
    ]
    return pa.Table.from_arrays(rows.columns, schema=pa.schema(plain))


def _make_unique(names: Sequence[str]) -> list[str]:
    """The names of an answer's columns; each later one of the same name has a number after it, as in DuckDB: a, a_1.

    A row is told by the names of its columns, in JSON and elsewhere, so that of two equal ones the first would be lost.
    """
    unique: list[str] = []
    for name in names:
        free, number = name, 0
        while free in unique:
            number += 1
            free = f"{name}_{number}"
        unique.append(free)
    return unique


def _describe_conversion(error: duckdb.Error, parameters: Mapping[str, Value] | None) -> str:
    """DuckDB shows the line of SQL, which the user of a stored question did not write."""
    reason = str(error).splitlines()[0].removeprefix("Conversion Error: ")
    given = ", ".join(f"{name}={value}" for name, value in (parameters or {}).items() if value is not None)
    return f"the question cannot be answered{f' with {given}' if given else ''}: {reason}; give a value of that type"


def _execute(
    connection: duckdb.DuckDBPyConnection, sql: str, parameters: Mapping[str, Value]
) -> duckdb.DuckDBPyConnection:
    """The statement with the values bound to its parameters, see ``quote_sql_value``."""
    if not parameters:
        return connection.execute(sql)
    connection.execute(f"PREPARE question AS {sql}")
    values = ", ".join(f'"{name}" := {quote_sql_value(value)}' for name, value in parameters.items())
    return connection.execute(f"EXECUTE question({values})")


@contextmanager
def open_sealed(
    lake: Path, as_of: int | None, extensions: Sequence[str] = SPATIAL
) -> Iterator[duckdb.DuckDBPyConnection]:
    """A read-only connection with the views that can open no other files and cannot be reconfigured."""
    with open_to_read(lake, as_of=as_of) as connection:
        present_current_schema(connection, lake)
        with wrap_store_errors(f"preparing the lake {lake} for questions", "check that its files are whole"):
            for extension in extensions:
                connection.execute(f"LOAD {quote_sql_string(find_extension_file(extension))}")
            for view in read_statements(VIEWS):
                connection.execute(f"CREATE TEMP VIEW {view.name} AS {view.sql}")
            data = quote_sql_string(f"{lake.resolve() / DATA}/")
            connection.execute(f"SET allowed_directories = [{data}]")
            connection.execute("SET enable_external_access = false")
            connection.execute("SET lock_configuration = true")
        yield connection
