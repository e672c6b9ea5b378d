"""The order of defects by severity, as their rule packs list the severities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import pyarrow as pa

from facadelake.core.errors import InputDataError
from facadelake.severity import RulePack, read_rule_pack


def read_rule_packs(rows: Sequence[Mapping[str, Any]]) -> dict[str, RulePack]:
    """The rule packs that graded the defects, by name, without those that are no longer there."""
    packs = {}
    for name in sorted({row["severity_rule"] for row in rows}):
        with suppress(InputDataError):
            packs[name] = read_rule_pack(name)
    return packs


def rank_severity(row: Mapping[str, Any], packs: Mapping[str, RulePack]) -> float:
    """Place of a defect's severity in its rule pack: 0 for the worst.

    A grade that its rule pack does not list (by a person, or of a pack that is no longer there) has 1, after the
    others.
    """
    severities = packs[row["severity_rule"]].severities if row["severity_rule"] in packs else ()
    return severities.index(row["severity"]) / len(severities) if row["severity"] in severities else 1.0


def sort_by_severity(defects: pa.Table) -> list[dict[str, Any]]:
    """Rows of table ``defects``: the most severe by their rule pack first, those of one grade by decreasing area."""
    rows: list[dict[str, Any]] = defects.to_pylist()
    packs = read_rule_packs(rows)
    return sorted(rows, key=lambda row: (rank_severity(row, packs), -row["area_m2"], row["defect_id"]))
