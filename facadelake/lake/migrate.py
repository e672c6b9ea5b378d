"""Migrations: the lake's tables are created and altered by numbered SQL files only, in order, under the lock."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import duckdb

from facadelake.core.checkout import locate_source
from facadelake.core.errors import StoreError
from facadelake.lake.connect import LOCK_TIMEOUT_S, hold_lock, open_catalog_to_write
from facadelake.lake.damage import wrap_lake_errors
from facadelake.lake.opening_script import write_opening_script
from facadelake.lake.transaction import run_transaction

MIGRATIONS = locate_source("sql/migrations")
# The only table that no migration creates: it records those that were applied.
LEDGER = """CREATE TABLE IF NOT EXISTS migrations (
    number BIGINT NOT NULL, name VARCHAR NOT NULL, applied_at TIMESTAMP WITH TIME ZONE NOT NULL)"""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Migration:
    """One file ``NNNN_name.sql``."""

    number: int
    name: str
    sql: str


@cache
def read_migrations(folder: Path = MIGRATIONS) -> tuple[Migration, ...]:
    """All migrations, numbered 1, 2, ... without a gap (StoreError otherwise)."""
    found = [
        Migration(number=int(path.stem.split("_")[0]), name=path.stem, sql=path.read_text("utf-8"))
        for path in sorted(folder.glob("[0-9][0-9][0-9][0-9]_*.sql"))
    ]
    numbers = [migration.number for migration in found]
    if not found or numbers != list(range(1, len(found) + 1)):
        raise StoreError(f"the migrations in {folder} are numbered {numbers}; they must run 1, 2, 3 without a gap")
    return tuple(found)


def get_schema_version(connection: duckdb.DuckDBPyConnection) -> int:
    """Number of the last migration applied to the attached lake; 0 for a new one."""
    try:
        row = connection.execute("SELECT coalesce(max(number), 0) FROM lake.migrations").fetchone()
    except duckdb.CatalogException:  # no such table
        return 0
    return int(row[0]) if row else 0


def refuse_newer(found: int, wanted: int) -> None:
    """Raise StoreError for a lake that a newer Facadelake has written."""
    if found > wanted:
        raise StoreError(
            f"the lake has schema version {found}, this Facadelake knows versions up to {wanted}; "
            "update Facadelake, or name another lake"
        )


def migrate(connection: duckdb.DuckDBPyConnection, lake: Path, folder: Path = MIGRATIONS) -> int:
    """Bring the attached ``lake`` to the newest schema and return its version; hold the lake's lock.

    Each migration is one transaction, so that a failure leaves the lake at the version before it.
    """
    steps = read_migrations(folder)
    with wrap_lake_errors(lake, "reading the lake's schema version", "check that the lake's files are whole"):
        found = get_schema_version(connection)
    refuse_newer(found, len(steps))
    for step in steps[found:]:
        logger.info("lake migration %s", step.name)
        doing, remedy = f"migration {step.name} of the lake", "the lake stays as it was; check free space"
        with wrap_lake_errors(lake, doing, remedy), run_transaction(connection):
            connection.execute(LEDGER)
            connection.execute(step.sql)
            connection.execute("INSERT INTO migrations VALUES (?, ?, now())", [step.number, step.name])
    return len(steps)


@contextmanager
def open_to_write(lake: Path, lock_timeout_s: float = LOCK_TIMEOUT_S) -> Iterator[duckdb.DuckDBPyConnection]:
    """An exclusive connection to write the lake, created if it does not exist and migrated to the newest schema."""
    with hold_lock(lake, timeout_s=lock_timeout_s), open_catalog_to_write(lake) as connection:
        migrate(connection, lake)
        yield connection
        write_opening_script(lake)
