"""DuckDB in memory, with the extensions of its wheels and nothing from the network."""

from __future__ import annotations

import os
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import duckdb

from facadelake.core.errors import StoreError

# What DuckDB raises for a statement that it cannot run.
SqlError = duckdb.Error


@cache
def find_extension_file(name: str) -> Path:
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


def quote_sql_string(text: str | Path) -> str:
    """The text as an SQL string."""
    return "'" + str(text).replace("'", "''") + "'"


@contextmanager
def wrap_store_errors(doing: str, remedy: str) -> Iterator[None]:
    """DuckDB's, SQLite's and the disk's errors inside the block become StoreError."""
    try:
        yield
    except (duckdb.Error, sqlite3.Error, OSError) as error:
        raise StoreError(f"{doing} failed: {str(error).strip()}; {remedy}") from error


def open_duckdb(*extensions: str) -> duckdb.DuckDBPyConnection:
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
        connection.execute(f"LOAD {quote_sql_string(find_extension_file(name))}")
    connection.execute("SET TimeZone = 'UTC'")
    return connection
