"""The report of an inspection of the portfolio: done, failed and what to bring, overdue, next dates, left out."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

from facadelake.scheduling.building_log import PORTFOLIO_FOLDER, AttemptOutcome
from facadelake.scheduling.due_dates import InspectionDates
from facadelake.scheduling.plan import LeftOutCampaign

LATEST = "latest"


@dataclass(frozen=True, kw_only=True)
class CampaignOutcome:
    """What became of a campaign that was inspected.

    ``refused``: its input is at fault, and ``problem`` says what to bring. ``failed`` and ``killed`` (by a signal) are
    tried again. ``states`` counts the building's tracks by state. ``worst_defects`` have the worst grade of the rule
    pack, ``worst_severity``. ``log`` is the file of the run's messages.
    """

    building_id: str
    campaign_id: str
    outcome: Literal["committed", "unchanged"] | AttemptOutcome
    problem: str = ""
    version: int | None = None
    defects: int = 0
    states: dict[str, int] = field(default_factory=dict)
    worst_severity: str = ""
    worst_defects: int = 0
    photographs: int = 0
    seconds: float = 0.0
    peak_mib: float = 0.0
    need_mib: float = 0.0
    warnings: tuple[str, ...] = ()
    log: str = ""

    @property
    def is_done(self) -> bool:
        """Whether the campaign is in the lake as its photographs are."""
        return self.outcome in ("committed", "unchanged")


@dataclass(frozen=True, kw_only=True)
class PortfolioReport:
    """What an inspection of the portfolio did. ``not_done`` were waiting or running when it was stopped.

    ``remarks`` are what else is to be told, such as a notification that could not be sent.
    """

    started_at: datetime
    finished_at: datetime
    outcomes: tuple[CampaignOutcome, ...]
    left_out: tuple[LeftOutCampaign, ...]
    not_done: tuple[str, ...]
    dates: tuple[InspectionDates, ...]
    remarks: tuple[str, ...] = ()

    def list_failed(self) -> list[CampaignOutcome]:
        """The campaigns that were not committed."""
        return [one for one in self.outcomes if not one.is_done]

    def list_overdue(self) -> list[InspectionDates]:
        """The buildings whose inspection is overdue, by law first, and the longest first."""
        overdue = [one for one in self.dates if one.is_overdue]
        return sorted(overdue, key=lambda one: (not one.legal_overdue, str(one.overdue_since), one.building_id))


def describe_overdue(one: InspectionDates) -> str:
    """Since when an inspection is overdue; empty: it is not."""
    said = []
    if one.legal_overdue:
        said.append(f"by law: the last day was {one.legal_deadline}")
    if one.overdue_since is not None:
        said.append(f"by schedule since {one.overdue_since:%Y-%m-%d}")
    if said and one.last_inspected_at is None:
        said.append("never inspected")
    return "; ".join(said)


def summarise_report(report: PortfolioReport) -> str:
    """One line, such as the subject of a message."""
    failed = report.list_failed()
    parts = [f"{len(report.outcomes) - len(failed)} inspected"]
    counts = [
        (len(failed), "failed"), (len(report.list_overdue()), "overdue"), (len(report.left_out), "left out"),
        (len(report.not_done), "not done"),
    ]  # fmt: skip
    return ", ".join(parts + [f"{count} {word}" for count, word in counts if count])


def format_report(report: PortfolioReport) -> str:
    """The report as Markdown."""
    duration = format_duration((report.finished_at - report.started_at).total_seconds())
    lines = [
        f"# Inspection of the portfolio, {report.started_at:%Y-%m-%d %H:%M} UTC",
        f"{summarise_report(report)}. It took {duration}.",
    ]
    failed = report.list_failed()
    if failed:
        lines += ["## Failed"]
        lines += [
            f"- **{one.building_id} {one.campaign_id}** ({one.outcome}): {one.problem}"
            + (f" Log: `{one.log}`" if one.log else "")
            for one in failed
        ]
    if report.not_done:
        lines += ["## Not done", *(f"- {name}" for name in report.not_done)]
    overdue = report.list_overdue()
    if overdue:
        lines += ["## Overdue", *(f"- **{one.building_id}**: {describe_overdue(one)}" for one in overdue)]
    done = [one for one in report.outcomes if one.is_done]
    if done:
        lines += ["## Inspected", _format_table(_DONE_COLUMNS, map(_list_done_cells, done))]
        lines += [f"- {one.building_id} {one.campaign_id}: {text}" for one in done for text in one.warnings]
    if report.left_out:
        lines += ["## Left out"]
        lines += [f"- {one.building_id} {one.campaign_id} ({one.kind}): {one.reason}" for one in report.left_out]
    lines += ["## Dates", _format_table(_DATE_COLUMNS, map(_list_date_cells, report.dates))]
    lines += [f"- {one.building_id}: {text}" for one in report.dates for text in one.remarks]
    if report.remarks:
        lines += ["## Remarks", *(f"- {text}" for text in report.remarks)]
    return _join_blocks(lines)


_DONE_COLUMNS = ("building", "campaign", "version", "defects", "worst grade", "states", "photographs", "time", "memory")
_DATE_COLUMNS = ("building", "last inspection", "next date", "last day by law", "overdue")


def _list_done_cells(one: CampaignOutcome) -> tuple[str, ...]:
    return (
        one.building_id,
        one.campaign_id,
        f"{one.version}" + (" (unchanged)" if one.outcome == "unchanged" else ""),
        f"{one.defects}",
        f"{one.worst_defects} {one.worst_severity}" if one.worst_defects else "",
        ", ".join(f"{count} {state}" for state, count in one.states.items()),
        f"{one.photographs}",
        format_duration(one.seconds),
        f"{one.peak_mib / 1024:.1f} GiB",
    )


def _list_date_cells(one: InspectionDates) -> tuple[str, ...]:
    return (
        one.building_id,
        f"{one.last_inspected_at:%Y-%m-%d}" if one.last_inspected_at else "never",
        f"{one.next_date:%Y-%m-%d}" if one.next_date else "no schedule",
        f"{one.legal_deadline}" if one.legal_deadline else "",
        describe_overdue(one),
    )


def _format_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


def _join_blocks(lines: Sequence[str]) -> str:
    """Items of a list stand together; everything else is a paragraph."""
    text = ""
    for before, line in zip(["", *lines], lines, strict=False):
        text += ("\n" if line.startswith("- ") and before.startswith("- ") else "\n\n") + line
    return text.strip() + "\n"


def format_duration(seconds: float) -> str:
    """Such as ``45 s``, ``3 min`` or ``2 h 5 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def write_report(report: PortfolioReport, lake: Path) -> Path:
    """Write the report as Markdown and as JSON; ``latest`` links to it. Returns the path of the Markdown."""
    folder = lake / PORTFOLIO_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    stem = f"{report.started_at:%Y%m%dT%H%M%SZ}"
    content = json.dumps(asdict(report), indent=1, default=str)
    for suffix, text in ((".md", format_report(report)), (".json", content)):
        path = folder / f"{stem}{suffix}"
        path.write_text(text, encoding="utf-8")
        link = folder / f".{LATEST}{suffix}"
        link.unlink(missing_ok=True)
        link.symlink_to(path.name)
        link.replace(folder / f"{LATEST}{suffix}")
    return folder / f"{stem}.md"
