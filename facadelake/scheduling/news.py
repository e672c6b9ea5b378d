"""What of a report is worth a message: failures, the worst grade, growth, and inspections that have become overdue."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from facadelake.scheduling.due_dates import InspectionDates
from facadelake.scheduling.report import PortfolioReport, describe_overdue


def find_news(report: PortfolioReport, on: Collection[str], told_overdue: Collection[str]) -> list[str]:
    """Lines of a message; empty where there is nothing to tell.

    ``on`` are the kinds of ``NotifySetting``. An overdue inspection is told once for each of its dates
    (``told_overdue``); the report lists it every time.
    """
    news: list[str] = []
    if "failed" in on:
        news += [f"FAILED {one.building_id} {one.campaign_id}: {one.problem}" for one in report.list_failed()] + [
            f"NOT DONE {name}: the inspection of the portfolio was stopped" for name in report.not_done
        ]
        news += [
            f"LEFT OUT {one.building_id} {one.campaign_id}: {one.reason}"
            for one in report.left_out
            if one.kind in ("too_large", "unreadable")
        ]
    done = [one for one in report.outcomes if one.outcome == "committed"]
    if "worst_grade" in on:
        news += [
            f"WORST GRADE {one.building_id} {one.campaign_id}: {one.worst_defects} defects are {one.worst_severity}"
            for one in done
            if one.worst_defects
        ]
    if "growth" in on:
        news += [
            f"GROWTH {one.building_id} {one.campaign_id}: {one.states['grown']} defects have grown significantly"
            for one in done
            if one.states.get("grown")
        ]
    if "overdue" in on:
        news += [
            f"OVERDUE {one.building_id}: {describe_overdue(one)}"
            for one in report.list_overdue()
            if not set(list_overdue_dates(one)) <= set(told_overdue)
        ]
    return news


def list_overdue_dates(one: InspectionDates) -> list[str]:
    """Names of what is overdue of a building: its date by schedule, its last day by law."""
    by_law = [f"{one.building_id} law {one.legal_deadline}"] if one.legal_overdue else []
    by_schedule = [f"{one.building_id} schedule {one.overdue_since:%Y-%m-%d}"] if one.overdue_since else []
    return by_law + by_schedule


def format_address(address: str) -> str:
    """An address for a log: without user, password and what follows the host."""
    found: Sequence[str] = re.findall(r"^([\w+-]+://)(?:[^@/]*@)?([^/?]*)", address)
    return "".join(found[0]) + "/…" if found else address
