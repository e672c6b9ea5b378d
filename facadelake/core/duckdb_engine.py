"""DuckDB in memory, with extensions from Python wheels and none from the network."""

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

# Raised by DuckDB for a statement that it cannot execute.
SqlError = duckdb.Error
Connection = duckdb.DuckDBPyConnection


@cache
def find_extension_file(name: str) -> Path:
    """The extension's file inside its wheel.

    Raises StoreError where the wheel is missing or was built for another version of DuckDB.
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
    """The text as an SQL string literal."""
    return "'" + str(text).replace("'", "''") + "'"


def quote_sql_value(value: str | int | float | bool | None) -> str:
    """The value as an SQL literal.

    Where DuckDB binds a Python value it first imports pandas to recognise its types: 0.25 s, more than most questions.
    """
    if value is None:
        return "NULL"
    if isinstance(value, bool):
        return str(value).upper()
    if isinstance(value, float):
        return f"{quote_sql_string(repr(value))}::DOUBLE"  # also nan and inf
    return quote_sql_string(value) if isinstance(value, str) else str(value)


@contextmanager
def wrap_store_errors(operation: str, remedy: str) -> Iterator[None]:
    """Raise errors of DuckDB, SQLite and the file system inside the block as StoreError.

    The message is "``operation`` failed: cause; ``remedy``".
    """
    try:
        yield
    except (duckdb.Error, sqlite3.Error, OSError) as error:
        raise StoreError(f"{operation} failed: {str(error).strip()}; {remedy}") from error


def open_duckdb(*extensions: str) -> duckdb.DuckDBPyConnection:
    """An in-memory DuckDB in UTC with the named extensions; it never downloads others.

    Their signatures are not verified here: they lie in wheels whose hashes the installation verified, like those of
    every other library, and hashing 70 MB takes 0.25 s. ``facadelake doctor`` verifies them.
    """
    temporary = Path(tempfile.gettempdir()) / f"facadelake-duckdb-{os.getuid()}"
    connection = duckdb.connect(
        config={
            "allow_unsigned_extensions": True,
            "autoinstall_known_extensions": False,
            "autoload_known_extensions": False,
            "temp_directory": str(temporary),
        }
    )
    connection.execute("SET enable_progress_bar = false")  # first: LOAD may show one, too
    for name in extensions:
        connection.execute(f"LOAD {quote_sql_string(find_extension_file(name))}")
    connection.execute("SET TimeZone = 'UTC'")
    return connection
