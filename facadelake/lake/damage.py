"""Damaged files of a lake: which ones, what they hold, and from where it can be had again."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq

from facadelake.core.duckdb_engine import wrap_store_errors
from facadelake.core.errors import StoreError
from facadelake.lake.connect import CATALOG, DATA

_PUBLISHED = "published"
_LISTED_MAX = 3
# Errors of the statement itself, which no file can cause.
_OF_THE_STATEMENT = (duckdb.ParserException, duckdb.BinderException, duckdb.CatalogException)
_FILES = """
SELECT
    tables.table_name,
    files.begin_snapshot,
    files.end_snapshot,
    (
        SELECT max(changes.snapshot_id) FROM ducklake_snapshot_changes AS changes
        WHERE changes.snapshot_id < files.begin_snapshot AND changes.commit_extra_info IS NOT NULL
    ) AS whole,
    files.file_size_bytes,
    CASE WHEN files.path_is_relative THEN schemas.path || tables.path || files.path ELSE files.path END AS path,
    (
        SELECT group_concat(
            stats.min_value || CASE WHEN stats.max_value <> stats.min_value THEN ' to ' || stats.max_value ELSE '' END,
            ' '
        )
        FROM ducklake_file_column_stats AS stats
        JOIN ducklake_column AS columns ON columns.column_id = stats.column_id AND columns.table_id = stats.table_id
        WHERE stats.data_file_id = files.data_file_id
            AND columns.end_snapshot IS NULL
            AND columns.column_name IN ('building_id', 'campaign_id')
    ) AS content
FROM ducklake_data_file AS files
JOIN ducklake_table AS tables ON tables.table_id = files.table_id AND tables.end_snapshot IS NULL
JOIN ducklake_schema AS schemas ON schemas.schema_id = tables.schema_id
WHERE files.begin_snapshot <= :version AND (files.end_snapshot IS NULL OR files.end_snapshot > :version)
ORDER BY path
"""


@dataclass(frozen=True, kw_only=True)
class DamagedFile:
    """A data file that cannot be read.

    ``content``: its buildings and campaigns. ``first`` and ``last``: the versions that use it (None: the newest does).
    ``whole``: the last version before, None where there is none.
    """

    path: Path
    table: str
    content: str
    first: int
    last: int | None
    whole: int | None
    problem: str


@contextmanager
def wrap_lake_errors(lake: Path, operation: str, remedy: str, as_of: int | None = None) -> Iterator[None]:
    """Raise errors of DuckDB, SQLite and the file system as StoreError; a damaged file of the lake is named.

    Args:
        lake: folder of the lake.
        operation: what the block does, for the message.
        remedy: what to do about other errors than a damaged file, for the message.
        as_of: the version that is read; None: the newest.

    Raises:
        StoreError: an error inside the block.
    """
    with wrap_store_errors(operation, remedy), name_damaged_files(lake, as_of):
        yield


@contextmanager
def name_damaged_files(lake: Path, as_of: int | None) -> Iterator[None]:
    """Raise StoreError for an error of DuckDB inside the block that a damaged file of the version causes.

    Other errors pass.
    """
    try:
        yield
    except _OF_THE_STATEMENT:
        raise
    except duckdb.Error as error:
        try:
            damaged = find_damaged_files(lake, as_of)
        except sqlite3.Error:  # the catalog itself is locked or damaged
            damaged = ()
        if not damaged:
            raise error
        raise StoreError(_describe(lake, damaged)) from error


def find_damaged_files(lake: Path, as_of: int | None) -> tuple[DamagedFile, ...]:
    """The files of a version (None: the newest) that are missing, of another size than written, or unreadable."""
    lake = lake.resolve()
    with closing(sqlite3.connect(f"{(lake / CATALOG).as_uri()}?mode=ro", uri=True)) as catalog:
        version = as_of
        if version is None:
            (version,) = catalog.execute("SELECT max(snapshot_id) FROM ducklake_snapshot").fetchone()
        rows = catalog.execute(_FILES, {"version": version}).fetchall()
    damaged = []
    for table, first, end, whole, size_bytes, relative, content in rows:
        path = lake / DATA / relative
        problem = _find_problem(path, size_bytes)
        if problem:
            damaged.append(
                DamagedFile(
                    path=path,
                    table=table,
                    content=content or "",
                    first=first,
                    last=None if end is None else end - 1,
                    whole=whole,
                    problem=problem,
                )
            )
    return tuple(damaged)


def _find_problem(path: Path, size_bytes: int) -> str:
    try:
        size = path.stat().st_size
        if size != size_bytes:
            return f"it has {size:,} of {size_bytes:,} bytes"
        pq.ParquetFile(path).read()
    except FileNotFoundError:
        return "it does not exist"
    except (OSError, pa.ArrowException) as error:
        return f"it cannot be read: {str(error).splitlines()[0]}"
    return ""


def _describe_versions(one: DamagedFile) -> str:
    if one.last is None:
        return f"version {one.first} and later"
    return f"version {one.first}" if one.last == one.first else f"versions {one.first} to {one.last}"


def _describe(lake: Path, damaged: tuple[DamagedFile, ...]) -> str:
    listed = [
        f"{one.path} of table {one.table} ({one.problem}; it holds {one.content or 'no campaign'}, in "
        f"{_describe_versions(one)})"
        for one in damaged[:_LISTED_MAX]
    ]
    more = f" and {len(damaged) - _LISTED_MAX} more" if len(damaged) > _LISTED_MAX else ""
    whole = [one.whole for one in damaged]
    earlier = (
        f"version {min(one for one in whole if one is not None)} was made before it (--as-of); "
        if None not in whole
        else ""
    )
    published = lake / _PUBLISHED
    releases = f"{published} has the published files of each version; " if published.is_dir() else ""
    return (
        f"the lake {lake} is damaged: {'; '.join(listed)}{more}. The way back: restore the file from a backup of the "
        f"lake; {earlier}{releases}or inspect the campaign again into another lake (--lake)"
    )
