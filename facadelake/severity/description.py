"""The severity of a defect in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

GRADED_BY_RULES = "rules"  # value of graded_by for a proposal by rules; a person's grade has the person's name


def describe_severity(row: Mapping[str, Any]) -> str:
    """The severity of a row of table ``defects``, with the range that its width's error leaves where it is uncertain.

    Such as "severe (moderate to severe)".
    """
    severity = str(row["severity"])
    if row["graded_by"] not in (None, GRADED_BY_RULES) or row["severity_low"] == row["severity_high"]:
        return severity
    return f"{severity} ({row['severity_low']} to {row['severity_high']})"
