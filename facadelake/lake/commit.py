"""A campaign enters the lake in one transaction, or not at all."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import duckdb
import pyarrow as pa

from facadelake.core.errors import SchemaError
from facadelake.lake.connect import LOCK_TIMEOUT_S
from facadelake.lake.damage import wrap_lake_errors
from facadelake.lake.history import (
    TrackedHistory,
    find_version_of_history,
    replace_changed_history,
    replace_history,
    require_current_history,
)
from facadelake.lake.migrate import open_to_write
from facadelake.lake.transaction import get_last_version, insert, make_version
from schemas.tables import RUN_KEYS, TABLES

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class CommitResult:
    """The lake's version that last changed the campaign or the history of its building.

    ``changed``: whether this call wrote the campaign.
    ``regraded_before``: the rule packs of a regrading that this call's rows have replaced by their own grades.
    """

    version: int
    changed: bool
    regraded_before: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _Run:
    building_id: str
    campaign_id: str
    run_id: str
    inputs_sha256: str
    code_sha256: str
    configuration: str


def commit_campaign(
    lake: Path,
    *,
    building_id: str,
    campaign_id: str,
    run_id: str,
    tables: Mapping[str, pa.Table],
    inputs_sha256: str,
    history: TrackedHistory | None = None,
    lock_timeout_s: float = LOCK_TIMEOUT_S,
) -> CommitResult:
    """Replace the campaign's rows of every table, and the building's history, in one transaction.

    A campaign that was made of the same inputs, code and configuration stays as it is, and ``changed`` is False; the
    history is replaced alone where it differs. ``version`` is the one that last changed either of them. Earlier
    versions stay readable.

    Args:
        lake: folder of the lake; it is created if it does not exist.
        building_id: the building.
        campaign_id: the campaign.
        run_id: the run.
        tables: every table of ``schemas.tables.TABLES`` by name, with the run keys as first columns.
        inputs_sha256: hash of the run's inputs, as in table ``runs``.
        history: the tracks of all campaigns of the building, with this one; None: those of the lake stay.
        lock_timeout_s: seconds to wait for another process that writes the lake.

    Raises SchemaError for tables that are not as schemas/ declares, HistoryOutdatedError where the lake has changed
    since the history was tracked, StoreError when the lake cannot be written (it then stays as it was).
    """
    run = _check_run(building_id, campaign_id, run_id, tables, inputs_sha256)
    doing = f"committing {building_id} {campaign_id} to the lake {lake}"
    with open_to_write(lake, lock_timeout_s) as connection, wrap_lake_errors(lake, doing, _REMEDY):
        known = _find_version_of_same_run(connection, run)
        if known is not None:
            logger.info("%s %s is in the lake already, version %d", building_id, campaign_id, known)
            if history is not None:  # another campaign, or a review, may have changed it
                replace_changed_history(connection, lake, history, building_id)
            return CommitResult(version=max(known, find_version_of_history(connection, building_id)), changed=False)
        if history is not None:
            require_current_history(connection, history, building_id, but=campaign_id)
        regraded = _read_regrading_rules(connection, run)
        version = _replace(connection, run, tables, history)
    logger.info("%s %s committed as version %d", building_id, campaign_id, version)
    return CommitResult(version=version, changed=True, regraded_before=regraded)


_REMEDY = (
    "nothing of this run was written and the earlier versions are whole; "
    "check free space and rights of the lake's folder, then run again (the stages' results are cached)"
)


def _check_run(
    building_id: str, campaign_id: str, run_id: str, tables: Mapping[str, pa.Table], inputs_sha256: str
) -> _Run:
    if tables.keys() != TABLES.keys():
        missing, strange = sorted(TABLES.keys() - tables.keys()), sorted(tables.keys() - TABLES.keys())
        raise SchemaError(f"a commit needs every table of schemas/: missing {missing}, unknown {strange}")
    keys = dict(zip(RUN_KEYS, (building_id, campaign_id, run_id), strict=True))
    for name, table in tables.items():
        wanted = TABLES[name].arrow
        if not table.schema.equals(wanted):
            raise SchemaError(f"table {name} has the columns {table.schema.to_string()}; the lake's are {wanted}")
        for key, value in keys.items():
            found = set(table.column(key).unique().to_pylist()) - {value}
            if found:
                raise SchemaError(f"table {name} has rows with {key} {sorted(map(str, found))}; this run's is {value}")
    runs = tables["runs"].select(["inputs_sha256", "code_sha256", "configuration"]).to_pylist()
    if len(runs) != 1 or runs[0]["inputs_sha256"] != inputs_sha256:
        raise SchemaError(
            f"table runs must have one row, of the inputs {inputs_sha256}; it has {len(runs)}, "
            f"of {[row['inputs_sha256'] for row in runs]}"
        )
    return _Run(**keys, **runs[0])


# snapshot_id is DuckLake's own column: the snapshot that brought the row. A regrading brings rows of defects alone.
_REGRADED = """SELECT d.snapshot_id, d.severity_rule FROM defects AS d JOIN runs AS r USING (building_id, campaign_id)
    WHERE building_id = ? AND campaign_id = ? AND d.snapshot_id > r.snapshot_id"""


def _find_version_of_same_run(connection: duckdb.DuckDBPyConnection, run: _Run) -> int | None:
    row = connection.execute(
        "SELECT snapshot_id FROM runs WHERE building_id = ? AND campaign_id = ? "
        "AND inputs_sha256 = ? AND code_sha256 = ? AND configuration = ?",
        [run.building_id, run.campaign_id, run.inputs_sha256, run.code_sha256, run.configuration],
    ).fetchone()
    if row is None:
        return None
    regraded = connection.execute(
        f"SELECT max(snapshot_id) FROM ({_REGRADED})", [run.building_id, run.campaign_id]
    ).fetchone()
    return max(int(version) for version in (*row, *(regraded or ())) if version is not None)


def _read_regrading_rules(connection: duckdb.DuckDBPyConnection, run: _Run) -> tuple[str, ...]:
    rows = connection.execute(
        f"SELECT DISTINCT severity_rule FROM ({_REGRADED}) ORDER BY severity_rule", [run.building_id, run.campaign_id]
    ).fetchall()
    return tuple(str(row[0]) for row in rows)


def _replace(
    connection: duckdb.DuckDBPyConnection, run: _Run, tables: Mapping[str, pa.Table], history: TrackedHistory | None
) -> int:
    names = ("building_id", "campaign_id", "run_id", "code_sha256")
    origin = {name: getattr(run, name) for name in names}
    with make_version(connection, f"{run.building_id} {run.campaign_id}", origin):
        for name, table in tables.items():
            connection.execute(
                f"DELETE FROM {name} WHERE building_id = ? AND campaign_id = ?", [run.building_id, run.campaign_id]
            )
            insert(connection, TABLES[name], table)
        if history is not None:
            replace_history(connection, history, run.building_id)
    return get_last_version(connection)
