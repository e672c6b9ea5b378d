"""Grade committed defects by another rule pack, as a new version of the lake; earlier versions are kept.

Only the grades of defects and tracks change; the run that measured the defects stays theirs, so a later inspection
of unchanged inputs leaves the new grades alone. What a person has graded stays the person's.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.core.errors import InputDataError
from facadelake.lake.connect import LOCK_TIMEOUT_S
from facadelake.lake.damage import wrap_lake_errors
from facadelake.lake.migrate import open_to_write
from facadelake.lake.read import read_table
from facadelake.lake.transaction import get_last_version, make_version
from facadelake.severity import GRADE_COLUMNS, GRADED_BY_RULES, grade_defects

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class GradeChange:
    """Number of defects of a campaign that change from one grade to another, each ``severity`` with its rule pack."""

    campaign_id: str
    before: tuple[str, str]
    after: tuple[str, str]
    defects: int


@dataclass(frozen=True, kw_only=True)
class Regrading:
    """What a rule pack changes.

    ``unchanged`` defects already have its grade, ``graded_by_person`` ones are kept; ``version`` of the lake has the
    change (None: nothing was written).
    """

    building_id: str
    rules: str
    changes: tuple[GradeChange, ...]
    unchanged: int
    graded_by_person: int
    version: int | None = None

    @property
    def campaigns(self) -> tuple[str, ...]:
        """The campaigns with changes."""
        return tuple(sorted({step.campaign_id for step in self.changes}))


def preview_regrading(lake: Path, *, building_id: str, campaign_id: str | None, rule_file: Path) -> Regrading:
    """What ``regrade`` would change; nothing is written.

    Args:
        lake: folder of the lake.
        building_id: the building.
        campaign_id: the campaign; None: all of the building.
        rule_file: the SQL file of the rule pack.

    Raises InputDataError where the lake has no such defects, and what ``grade`` and ``read_table`` raise.
    """
    return _compare_grades(lake, building_id, campaign_id, rule_file)[0]


def regrade(
    lake: Path,
    *,
    building_id: str,
    campaign_id: str | None,
    rule_file: Path,
    lock_timeout_s: float = LOCK_TIMEOUT_S,
) -> Regrading:
    """Grade defects by a rule pack in one transaction; without a change no version is made.

    Args:
        lake: folder of the lake.
        building_id: the building.
        campaign_id: the campaign; None: all of the building.
        rule_file: the SQL file of the rule pack.
        lock_timeout_s: seconds to wait for another process that writes the lake.

    Raises as ``preview_regrading``, and StoreError when the lake cannot be written (it then stays as it was).
    """
    expected = preview_regrading(lake, building_id=building_id, campaign_id=campaign_id, rule_file=rule_file)
    if not expected.changes:  # neither this nor a refusal makes a lake or waits for its lock
        return expected
    with open_to_write(lake, lock_timeout_s) as connection:
        found, changed = _compare_grades(lake, building_id, campaign_id, rule_file)
        with wrap_lake_errors(lake, f"regrading {building_id} in the lake {lake}", _REMEDY):
            version = _write(connection, found, changed)
    logger.info("%s regraded by %s as version %d", building_id, found.rules, version)
    return Regrading(
        building_id=building_id,
        rules=found.rules,
        changes=found.changes,
        unchanged=found.unchanged,
        graded_by_person=found.graded_by_person,
        version=version,
    )


_REMEDY = "no grade was changed; check free space and rights of the lake's folder, then run again"


def _compare_grades(
    lake: Path, building_id: str, campaign_id: str | None, rule_file: Path
) -> tuple[Regrading, pa.Table]:
    """The regrading, and the rows that change with their new grades."""
    defects = read_table(lake, "defects", building_id=building_id, campaign_id=campaign_id)
    if not len(defects):
        raise InputDataError(
            f"the lake {lake} has no defects of {building_id}{f', campaign {campaign_id}' if campaign_id else ''}, "
            "so there is nothing to grade; 'facadelake campaigns' lists what it holds"
        )
    persons = pc.fill_null(pc.not_equal(defects.column("graded_by"), GRADED_BY_RULES), fill_value=False)
    graded = []
    for campaign in defects.column("campaign_id").unique().to_pylist():  # a rule may compare defects of a campaign
        ours = pc.equal(defects.column("campaign_id"), campaign)
        new = grade_defects(defects.filter(ours), rule_file).select(["campaign_id", "defect_id", *GRADE_COLUMNS])
        old = defects.filter(ours).select(GRADE_COLUMNS[:2]).rename_columns(["severity_before", "rule_before"])
        both = pa.Table.from_arrays([*new.columns, *old.columns], names=[*new.column_names, *old.column_names])
        graded.append(both.filter(pc.invert(persons.filter(ours))))
    table = pa.concat_tables(graded)
    differs = pc.or_(
        pc.not_equal(table.column("severity"), table.column("severity_before")),
        pc.not_equal(table.column("severity_rule"), table.column("rule_before")),
    )
    changed = table.filter(differs)
    found = Regrading(
        building_id=building_id,
        rules=rule_file.stem,
        changes=_count_grade_changes(changed),
        unchanged=len(table) - len(changed),
        graded_by_person=len(defects) - len(table),
    )
    return found, changed


def _count_grade_changes(changed: pa.Table) -> tuple[GradeChange, ...]:
    columns = ("campaign_id", "severity_before", "rule_before", "severity", "severity_rule")
    counts = Counter(zip(*(changed.column(name).to_pylist() for name in columns), strict=True))
    return tuple(
        GradeChange(campaign_id=campaign, before=(word, rule), after=(new_word, new_rule), defects=count)
        for (campaign, word, rule, new_word, new_rule), count in sorted(counts.items())
    )


def _write(connection: duckdb.DuckDBPyConnection, found: Regrading, changed: pa.Table) -> int:
    connection.register("graded", changed)
    origin = {"building_id": found.building_id, "campaigns": found.campaigns, "rules": found.rules}
    message = f"{found.building_id} {', '.join(found.campaigns)} regraded by {found.rules}"
    with make_version(connection, message, origin):
        connection.execute(
            f"UPDATE defects SET {', '.join(f'{name} = graded.{name}' for name in GRADE_COLUMNS)} FROM graded "
            "WHERE defects.building_id = ? AND defects.campaign_id = graded.campaign_id "
            "AND defects.defect_id = graded.defect_id",
            [found.building_id],
        )
        # A track has the grade of its latest detection. When it reaches the next limit is for tracking to say.
        connection.execute(
            "UPDATE tracks SET severity = defects.severity, severity_rule = defects.severity_rule, next_limit = NULL, "
            "next_severity = NULL, next_limit_from = NULL, next_limit_at = NULL, next_limit_to = NULL, "
            "trend_remark = 'regraded since; facadelake track tells the next limit' FROM defects "
            "WHERE tracks.building_id = ? AND defects.building_id = tracks.building_id "
            "AND defects.campaign_id = tracks.detected_campaign AND defects.defect_id = tracks.defect_id "
            "AND (tracks.severity, tracks.severity_rule) <> (defects.severity, defects.severity_rule)",
            [found.building_id],
        )
    return get_last_version(connection)
