"""One version of the lake: a transaction with its origin, of all or nothing."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import duckdb
import pyarrow as pa

from facadelake.core.duckdb_engine import quote_sql_string
from facadelake.core.errors import StoreError
from schemas.column_type import Kind
from schemas.tables import Table

logger = logging.getLogger(__name__)


@contextmanager
def run_transaction(connection: duckdb.DuckDBPyConnection) -> Iterator[None]:
    """The block's statements in one transaction, which an error or an interrupt inside it undoes."""
    connection.execute("BEGIN")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:  # an interrupt, too, must leave nothing half-written
        _roll_back(connection)
        raise


@contextmanager
def make_version(connection: duckdb.DuckDBPyConnection, message: str, origin: Mapping[str, Any]) -> Iterator[None]:
    """A transaction that makes a version of the lake; ``origin`` is what view ``versions`` tells of it."""
    with run_transaction(connection):
        yield
        connection.execute(
            f"CALL lake.set_commit_message('facadelake', {quote_sql_string(message)}, "
            f"extra_info => {quote_sql_string(json.dumps(dict(origin)))})"
        )


def get_last_version(connection: duckdb.DuckDBPyConnection) -> int:
    """The version that this connection's last transaction made."""
    row = connection.execute("SELECT id FROM lake.last_committed_snapshot()").fetchone()
    if row is None or row[0] is None:
        raise StoreError("DuckLake named no version for the commit; list the lake's versions and run again")
    return int(row[0])


def insert(connection: duckdb.DuckDBPyConnection, kind: Table, table: pa.Table) -> None:
    """Append an Arrow table of ``kind`` (lake form, geometry as WKB) to the attached lake's table of that name."""
    values = [f"ST_GeomFromWKB({c.name})" if c.kind is Kind.GEOMETRY else c.name for c in kind.columns]
    connection.register("staged", table)
    try:
        connection.execute(
            f"INSERT INTO lake.{kind.name} ({', '.join(c.name for c in kind.columns)}) "
            f"SELECT {', '.join(values)} FROM staged"
        )
    finally:
        connection.unregister("staged")


def _roll_back(connection: duckdb.DuckDBPyConnection) -> None:
    """End a failed transaction, which the failure itself may have ended already."""
    try:
        connection.execute("ROLLBACK")
    except duckdb.Error as error:
        logger.debug("nothing to roll back: %s", error)
