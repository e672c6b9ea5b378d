"""Open a lake: DuckDB with a DuckLake catalog in SQLite and Parquet files beside it, without any download.

A lake is a folder: ``catalog.sqlite`` (versions), ``tables/`` (Parquet), ``.lock`` (one writer at a time). The folder
may be moved or copied as a whole while nobody writes.
"""

from __future__ import annotations

import os
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import duckdb
from filelock import FileLock, Timeout

from facadelake.core.errors import StoreError

CATALOG = "catalog.sqlite"
DATA = "tables"
LOCK = ".lock"
LOCK_TIMEOUT_S = 600.0
BUSY_TIMEOUT_MS = 30_000  # SQLite's own wait, for a reader that meets a commit and the other way round
_OPENING = "'facadelake sql history' lists its versions; check that its files are whole"
LAKE_EXTENSIONS = ("sqlite_scanner", "ducklake")  # GEOMETRY is DuckDB's own; spatial is only for questions


@cache
def extension_file(name: str) -> Path:
    """The extension's file inside its wheel; DuckDB verifies its signature when it is loaded.

    Raises StoreError where the wheel is missing or was made for another DuckDB.
    """
    spec = find_spec(f"duckdb_extension_{name}")
    wheel = f"duckdb-extension-{name.replace('_', '-')}=={duckdb.__version__}"
    if spec is None or spec.origin is None:
        raise StoreError(f"the DuckDB extension {name} is not installed; install {wheel} (uv sync does)")
    path = Path(spec.origin).parent / "extensions" / f"v{duckdb.__version__}" / f"{name}.duckdb_extension"
    if not path.is_file():
        raise StoreError(f"the DuckDB extension {name} is not for DuckDB {duckdb.__version__}; install {wheel}")
    return path


def quoted(text: str | Path) -> str:
    """The text as an SQL string."""
    return "'" + str(text).replace("'", "''") + "'"


@contextmanager
def store_errors(doing: str, remedy: str) -> Iterator[None]:
    """DuckDB's, SQLite's and the disk's errors inside the block become StoreError."""
    try:
        yield
    except (duckdb.Error, sqlite3.Error, OSError) as error:
        raise StoreError(f"{doing} failed: {str(error).strip()}; {remedy}") from error


def bare_connection(*extensions: str) -> duckdb.DuckDBPyConnection:
    """An in-memory DuckDB in UTC with the named extensions, which never looks for others on the network."""
    temporary = Path(tempfile.gettempdir()) / f"facadelake-duckdb-{os.getuid()}"
    connection = duckdb.connect(
        config={
            "autoinstall_known_extensions": False,
            "autoload_known_extensions": False,
            "temp_directory": str(temporary),
        }
    )
    connection.execute("SET enable_progress_bar = false")  # first: on a busy machine even LOAD draws one
    for name in extensions:
        connection.execute(f"LOAD {quoted(extension_file(name))}")
    connection.execute("SET TimeZone = 'UTC'")
    return connection


def _attach(connection: duckdb.DuckDBPyConnection, folder: Path, options: str) -> None:
    catalog = quoted(f"ducklake:sqlite:{folder / CATALOG}")
    # The catalog remembers an absolute data path; overriding it keeps a moved folder readable.
    connection.execute(
        f"ATTACH {catalog} AS lake (DATA_PATH {quoted(f'{folder / DATA}/')}, OVERRIDE_DATA_PATH true, "
        f"DATA_INLINING_ROW_LIMIT 0, META_BUSY_TIMEOUT {BUSY_TIMEOUT_MS}{options})"
    )
    connection.execute("USE lake")


def recover(folder: Path) -> None:
    """Let SQLite undo a commit that was killed half-way; without this a read-only opening of the catalog fails."""
    if (folder / f"{CATALOG}-journal").exists():
        with closing(sqlite3.connect(folder / CATALOG, timeout=BUSY_TIMEOUT_MS / 1000)) as catalog:
            catalog.execute("SELECT count(*) FROM sqlite_master").fetchone()


def exists(folder: Path) -> bool:
    """Whether the folder holds a lake."""
    return (folder / CATALOG).is_file()


@contextmanager
def reading(folder: Path, *, as_of: int | None = None) -> Iterator[duckdb.DuckDBPyConnection]:
    """A connection that can only read the lake ``folder``, now or as of an earlier version (see ``versions``).

    Raises StoreError where there is no lake, it is not readable, or it has no such version.
    """
    folder = folder.resolve()
    if not exists(folder):
        raise StoreError(f"there is no lake in {folder} (no {CATALOG}); inspect a campaign first, or name another lake")
    snapshot = "" if as_of is None else f", SNAPSHOT_VERSION {int(as_of)}"
    version = "" if as_of is None else f" at version {as_of}"
    with store_errors(f"opening the lake {folder}{version}", _OPENING):
        recover(folder)
        connection = bare_connection(*LAKE_EXTENSIONS)
    with closing(connection):
        with store_errors(f"opening the lake {folder}{version}", _OPENING):
            _attach(connection, folder, f", READ_ONLY{snapshot}")
        yield connection


@contextmanager
def locked(folder: Path, *, timeout_s: float = LOCK_TIMEOUT_S) -> Iterator[None]:
    """The lake's write lock; the kernel frees it when its holder dies, so a stale file never blocks.

    Raises StoreError when another process holds it longer than ``timeout_s`` seconds.
    """
    with store_errors(f"making the lake's folder {folder}", "choose a folder that you may write to"):
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
def writing(folder: Path) -> Iterator[duckdb.DuckDBPyConnection]:
    """A connection that may write the lake ``folder``, which is made if need be; hold ``locked`` around it."""
    folder = folder.resolve()
    with store_errors(f"opening the lake {folder} for writing", "check the folder's rights and free space"):
        (folder / DATA).mkdir(parents=True, exist_ok=True)
        connection = bare_connection(*LAKE_EXTENSIONS)
    with closing(connection):
        with store_errors(f"opening the lake {folder} for writing", "check the folder's rights and free space"):
            _attach(connection, folder, "")
        yield connection
