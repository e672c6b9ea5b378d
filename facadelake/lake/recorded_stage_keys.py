"""Which results of the stage cache the lake's versions were made of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from facadelake.lake.connect import has_lake, open_to_read
from facadelake.lake.damage import wrap_lake_errors
from facadelake.lake.migrate import get_schema_version

# Column stage_keys of table runs came with this schema version.
_SINCE_SCHEMA = 2


@dataclass(frozen=True, kw_only=True)
class RunKeys:
    """The keys, by stage, of the cache entries that a run's tables were made of."""

    building_id: str
    campaign_id: str
    run_id: str
    version: int
    keys: Mapping[str, str]


def read_stage_keys(lake: Path) -> tuple[RunKeys, ...]:
    """The runs of all versions that the lake keeps, also of those that a later run replaced; the oldest first.

    Runs committed before schema version 2 recorded no keys and are left out. Raises StoreError for a lake that cannot
    be read; a folder without a lake has no runs.
    """
    if not has_lake(lake):
        return ()
    with (
        open_to_read(lake) as connection,
        wrap_lake_errors(lake, f"reading the runs of the lake {lake}", "check that the lake's files are whole"),
    ):
        if get_schema_version(connection) < _SINCE_SCHEMA:
            return ()
        first, last = connection.execute(
            "SELECT min(snapshot_id), max(snapshot_id) FROM ducklake_snapshots('lake')"
        ).fetchall()[0]
        rows = connection.execute(
            "SELECT building_id, campaign_id, run_id, snapshot_id, stage_keys "
            f"FROM ducklake_table_insertions('lake', 'main', 'runs', {int(first)}, {int(last)}) "
            "WHERE stage_keys IS NOT NULL ORDER BY snapshot_id"
        ).fetchall()
    return tuple(
        RunKeys(building_id=building, campaign_id=campaign, run_id=run, version=int(version), keys=json.loads(keys))
        for building, campaign, run, version, keys in rows
    )
