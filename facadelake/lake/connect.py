"""Open a lake: DuckDB with a DuckLake catalog in SQLite and Parquet files, without downloads.

A lake is a folder: ``catalog.sqlite`` (versions), ``tables/`` (Parquet), ``.lock`` (one writer at a time). The folder
may be moved or copied as a whole while nobody writes.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import duckdb
from filelock import FileLock, Timeout

from facadelake.core.duckdb_engine import open_duckdb, quote_sql_string, wrap_store_errors
from facadelake.core.errors import StoreError

CATALOG = "catalog.sqlite"
DATA = "tables"
LOCK = ".lock"
LOCK_TIMEOUT_S = 600.0
BUSY_TIMEOUT_MS = 30_000  # SQLite's wait of a reader for a commit, and of a commit for a reader
_WAY_BACK = (
    f"The way back: restore {CATALOG} from a backup of the lake, of the same time as its tables; published/ has the "
    "published files of each version; or inspect the campaigns again into another lake (--lake)"
)
_OPENING = "'facadelake sql versions' lists its versions; check that its files are whole"
LAKE_EXTENSIONS = ("sqlite_scanner", "ducklake")  # GEOMETRY is DuckDB's own; spatial is only for questions


def _attach(connection: duckdb.DuckDBPyConnection, folder: Path, options: str) -> None:
    catalog = quote_sql_string(f"ducklake:sqlite:{folder / CATALOG}")
    # The catalog remembers an absolute data path; overriding it keeps a moved folder readable.
    connection.execute(
        f"ATTACH {catalog} AS lake (DATA_PATH {quote_sql_string(f'{folder / DATA}/')}, OVERRIDE_DATA_PATH true, "
        f"DATA_INLINING_ROW_LIMIT 0, META_BUSY_TIMEOUT {BUSY_TIMEOUT_MS}{options})"
    )
    connection.execute("USE lake")


def recover(folder: Path) -> None:
    """Let SQLite roll back an interrupted commit; else opening the catalog read-only fails."""
    if (folder / f"{CATALOG}-journal").exists():
        with closing(sqlite3.connect(folder / CATALOG, timeout=BUSY_TIMEOUT_MS / 1000)) as catalog:
            catalog.execute("SELECT count(*) FROM sqlite_master").fetchone()


def has_lake(folder: Path) -> bool:
    """Whether the folder holds a lake.

    Raises StoreError where it is a file, or holds tables without the catalog, which a new lake would make unreadable.
    """
    if (folder / CATALOG).is_file():
        return True
    if folder.exists() and not folder.is_dir():
        raise StoreError(f"the lake {folder} is a file; a lake is a folder: name another with --lake")
    if _has_tables(folder):
        raise StoreError(f"the lake {folder} is damaged: it has tables, but no {CATALOG}. {_WAY_BACK}")
    return False


def _has_tables(folder: Path) -> bool:
    return any((folder / DATA).rglob("*.parquet"))


def _require_whole_catalog(folder: Path) -> None:
    """Raise StoreError where the catalog is not that of a lake: cut off, overwritten, or another program's file."""
    try:
        uri = f"{(folder / CATALOG).as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, uri=True, timeout=BUSY_TIMEOUT_MS / 1000)) as catalog:
            catalog.execute("SELECT count(*) FROM ducklake_snapshot").fetchone()
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            return  # another program's commit: DuckDB waits for it, too, and says so
        problem = f"its {CATALOG} cannot be read ({error})"
        raise StoreError(f"the lake {folder} is damaged: {problem}. {_WAY_BACK}") from error


@contextmanager
def open_to_read(folder: Path, *, as_of: int | None = None) -> Iterator[duckdb.DuckDBPyConnection]:
    """A read-only connection to the lake ``folder``, at the newest or an earlier version (see ``list_versions``).

    Raises StoreError where there is no lake, it is not readable, or it has no such version.
    """
    folder = folder.resolve()
    if not has_lake(folder):
        raise StoreError(f"there is no lake in {folder} (no {CATALOG}); inspect a campaign first, or name another lake")
    if as_of is not None:
        _require_version(folder, as_of)
    snapshot = "" if as_of is None else f", SNAPSHOT_VERSION {int(as_of)}"
    version = "" if as_of is None else f" at version {as_of}"
    with wrap_store_errors(f"opening the lake {folder}{version}", _OPENING):
        recover(folder)
        _require_whole_catalog(folder)
        connection = open_duckdb(*LAKE_EXTENSIONS)
    with closing(connection):
        with wrap_store_errors(f"opening the lake {folder}{version}", _OPENING):
            _attach(connection, folder, f", READ_ONLY{snapshot}")
        yield connection


def _require_version(folder: Path, as_of: int) -> None:
    """Raise StoreError where the lake has no such version, with those that it has."""
    with (
        open_to_read(folder) as connection,
        wrap_store_errors(f"reading the versions of the lake {folder}", "check that its files are whole"),
    ):
        first, last = connection.execute(
            "SELECT min(snapshot_id) FILTER (WHERE commit_extra_info IS NOT NULL), max(snapshot_id) "
            "FROM ducklake_snapshots('lake')"
        ).fetchall()[0]
    if first is None or not first <= as_of <= last:
        held = "none" if first is None else f"{first} to {last}"
        raise StoreError(
            f"the lake {folder} has no version {as_of}; it has {held} ('facadelake sql versions' lists what made them)"
        )


@contextmanager
def hold_lock(folder: Path, *, timeout_s: float = LOCK_TIMEOUT_S) -> Iterator[None]:
    """The lake's write lock; the kernel releases it when its holder ends, so a stale file never blocks.

    Raises StoreError when another process holds it longer than ``timeout_s`` seconds.
    """
    with wrap_store_errors(f"making the lake's folder {folder}", "choose a folder that you may write to"):
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK)
        try:
            lock.acquire(timeout=timeout_s)
        except Timeout as error:
            raise StoreError(
                f"the lake {folder} is being written by another process and stayed locked for {timeout_s:g} s; "
                "wait until that run has ended and run again (the result so far is cached)"
            ) from error
    try:
        yield
    finally:
        lock.release()


@contextmanager
def open_catalog_to_write(folder: Path) -> Iterator[duckdb.DuckDBPyConnection]:
    """A connection that may write the lake ``folder``, created if it does not exist; use it inside ``hold_lock``.

    Raises StoreError where it cannot be opened, or its catalog is lost or damaged.
    """
    folder = folder.resolve()
    with wrap_store_errors(f"opening the lake {folder} for writing", "check the folder's rights and free space"):
        if has_lake(folder) and ((folder / CATALOG).stat().st_size or _has_tables(folder)):
            recover(folder)
            _require_whole_catalog(folder)
        (folder / DATA).mkdir(parents=True, exist_ok=True)
        connection = open_duckdb(*LAKE_EXTENSIONS)
    with closing(connection):
        with wrap_store_errors(f"opening the lake {folder} for writing", "check the folder's rights and free space"):
            _attach(connection, folder, "")
        yield connection
