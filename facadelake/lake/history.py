"""The history of a building in the lake: replaced as a whole, by a commit of one of its campaigns or by itself."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import duckdb
import pyarrow as pa

from facadelake.core.errors import HistoryOutdatedError, SchemaError
from facadelake.lake.connect import LOCK_TIMEOUT_S
from facadelake.lake.damage import wrap_lake_errors
from facadelake.lake.migrate import open_to_write
from facadelake.lake.read import read_tables
from facadelake.lake.transaction import get_last_version, insert, make_version
from schemas.tables import HISTORY_TABLES

logger = logging.getLogger(__name__)

_REMEDY = "the building's history is as it was; check free space and rights of the lake's folder, then run again"


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedHistory:
    """The history of a building, and what it was made of.

    ``tables``: every table of ``schemas.tables.HISTORY_TABLES`` by name. ``run_ids``: the run of every campaign.
    ``known_tracks``: ids of the building's tracks in the lake when it was tracked. ``code_sha256``: the code that did.
    """

    tables: Mapping[str, pa.Table]
    run_ids: Mapping[str, str]
    known_tracks: frozenset[str]
    code_sha256: str


def commit_history(
    lake: Path, history: TrackedHistory, *, building_id: str, lock_timeout_s: float = LOCK_TIMEOUT_S
) -> int | None:
    """Replace the history of a building in one transaction; returns the version, None where nothing has changed.

    Args:
        lake: folder of the lake.
        history: the tracks of all campaigns of the building.
        building_id: the building.
        lock_timeout_s: seconds to wait for another process that writes the lake.

    Raises HistoryOutdatedError where the lake has changed since the history was tracked, StoreError when it cannot be
    written (it then stays as it was).
    """
    with (
        open_to_write(lake, lock_timeout_s) as connection,
        wrap_lake_errors(lake, f"writing the history of {building_id} to the lake {lake}", _REMEDY),
    ):
        version = replace_changed_history(connection, lake, history, building_id)
    return version


def replace_changed_history(
    connection: duckdb.DuckDBPyConnection, lake: Path, history: TrackedHistory, building_id: str
) -> int | None:
    """Replace the history of a building in a transaction of its own, where it differs from the lake's.

    Args:
        connection: to the lake, locked.
        lake: folder of the lake.
        history: the tracks of all campaigns of the building.
        building_id: the building.

    Returns:
        The version of the lake, None where nothing has changed.

    Raises:
        HistoryOutdatedError: the lake has changed since the history was tracked.
    """
    require_current_history(connection, history, building_id, but=None)
    held = read_tables(lake, list(HISTORY_TABLES), building_id=building_id)
    if all(_is_same(held[name], history.tables[name], name) for name in HISTORY_TABLES):
        return None
    origin = {"building_id": building_id, "tracked": True, "code_sha256": history.code_sha256}
    with make_version(connection, f"history of {building_id}", origin):
        replace_history(connection, history, building_id)
    version = get_last_version(connection)
    logger.info("the history of %s committed as version %d", building_id, version)
    return version


def find_version_of_history(connection: duckdb.DuckDBPyConnection, building_id: str) -> int:
    """The version that last changed the history of a building, 0 where it has none."""
    rows = " UNION ALL ".join(
        f"SELECT max(snapshot_id) AS version FROM {name} WHERE building_id = $building" for name in HISTORY_TABLES
    )
    found = connection.execute(f"SELECT coalesce(max(version), 0) FROM ({rows})", {"building": building_id}).fetchone()
    return int(found[0]) if found else 0


def _is_same(held: pa.Table, table: pa.Table, name: str) -> bool:
    """Whether two tables are equal but for the encoding of geometry, which follows the coordinates of defects."""
    encoded = list(HISTORY_TABLES[name].geometry_columns)
    return bool(held.drop_columns(encoded).equals(table.drop_columns(encoded)))


def require_current_history(
    connection: duckdb.DuckDBPyConnection, history: TrackedHistory, building_id: str, *, but: str | None
) -> None:
    """Require that the lake has the campaigns and tracks that the history was made of.

    Args:
        connection: to the lake, locked.
        history: the history to be written.
        building_id: its building.
        but: a campaign that is written together with it.

    Raises:
        HistoryOutdatedError: another process has committed a campaign of the building, or its tracks, meanwhile.
    """
    runs = dict(
        connection.execute("SELECT campaign_id, run_id FROM runs WHERE building_id = ?", [building_id]).fetchall()
    )
    expected = dict(history.run_ids)
    for found in (runs, expected):
        found.pop(but or "", None)
    tracks = connection.execute("SELECT track_id FROM tracks WHERE building_id = ?", [building_id]).fetchall()
    if runs != expected or {row[0] for row in tracks} != history.known_tracks:
        raise HistoryOutdatedError(
            f"the lake has other campaigns or tracks of {building_id} than when it was tracked: another process has "
            "committed meanwhile; nothing was written, run again"
        )


def replace_history(connection: duckdb.DuckDBPyConnection, history: TrackedHistory, building_id: str) -> None:
    """Replace the building's rows of all tables of the history, inside the caller's transaction."""
    if history.tables.keys() != HISTORY_TABLES.keys():
        raise SchemaError(f"a history needs the tables {sorted(HISTORY_TABLES)}; it has {sorted(history.tables)}")
    for name, table in history.tables.items():
        if not table.schema.equals(HISTORY_TABLES[name].arrow):
            raise SchemaError(
                f"table {name} has the columns {table.schema.to_string()}; the lake's are {HISTORY_TABLES[name].arrow}"
            )
        connection.execute(f"DELETE FROM {name} WHERE building_id = ?", [building_id])
        insert(connection, HISTORY_TABLES[name], table)
