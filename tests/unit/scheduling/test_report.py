"""The report of the portfolio, and what of it is worth a message."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, date, datetime
from pathlib import Path

import pytest

from facadelake.scheduling.due_dates import InspectionDates
from facadelake.scheduling.news import find_news, format_address, list_overdue_dates
from facadelake.scheduling.plan import LeftOutCampaign
from facadelake.scheduling.report import CampaignOutcome, PortfolioReport, format_duration, format_report, write_report

ALL = ("failed", "worst_grade", "growth", "overdue")
START = datetime(2026, 5, 1, 2, 0, tzinfo=UTC)
DATES = InspectionDates(
    building_id="wall",
    last_inspected_at=datetime(2025, 4, 2, tzinfo=UTC),
    next_date=datetime(2026, 10, 1, 4, tzinfo=UTC),
    overdue_since=datetime(2026, 4, 1, 4, tzinfo=UTC),
    legal_deadline=date(2026, 4, 2),
    legal_overdue=True,
    remarks=("clock of the future",),
)
REPORT = PortfolioReport(
    started_at=START,
    finished_at=datetime(2026, 5, 1, 4, 5, tzinfo=UTC),
    outcomes=(
        CampaignOutcome(
            building_id="castle", campaign_id="2026-04", outcome="committed", version=9, defects=40, photographs=29,
            states={"seen": 30, "grown": 2}, worst_severity="severe", worst_defects=3, seconds=400, peak_mib=1500,
        ),
        CampaignOutcome(
            building_id="tower", campaign_id="2026-04", outcome="refused", problem="no control; bring control points",
            log="/lake/worker.log",
        ),
    ),
    left_out=(
        LeftOutCampaign(building_id="wall", campaign_id="2026-04", kind="growing", reason="still copied"),
        LeftOutCampaign(building_id="dome", campaign_id="2026-04", kind="too_large", reason="needs 90 GiB"),
    ),
    not_done=("hall 2026-04",),
    dates=(DATES, replace(DATES, building_id="new", last_inspected_at=None, legal_overdue=False, legal_deadline=None)),
)  # fmt: skip


def test_the_report_says_what_is_done_failed_overdue_next_and_left_out() -> None:
    text = format_report(REPORT)
    for said in (
        "1 inspected, 1 failed, 2 overdue, 2 left out, 1 not done. It took 2 h 5 min.",
        "- **tower 2026-04** (refused): no control; bring control points Log: `/lake/worker.log`",
        "- hall 2026-04",
        "- **wall**: by law: the last day was 2026-04-02; by schedule since 2026-04-01\n",
        "- **new**: by schedule since 2026-04-01; never inspected",
        "| castle | 2026-04 | 9 | 40 | 3 severe | 30 seen, 2 grown | 29 | 7 min | 1.5 GiB |",
        "- wall 2026-04 (growing): still copied",
        "| wall | 2025-04-02 | 2026-10-01 | 2026-04-02 |",
        "- wall: clock of the future",
    ):
        assert said in text
    assert text.index("**wall**: by law") < text.index("**new**: by schedule")


def test_the_report_is_written_as_two_files_with_links_to_the_latest(tmp_path: Path) -> None:
    write_report(replace(REPORT, started_at=datetime(2026, 4, 30, 2, tzinfo=UTC)), tmp_path)
    path = write_report(REPORT, tmp_path)
    folder = tmp_path / "portfolio"
    assert path == folder / "20260501T020000Z.md"
    assert (folder / "latest.md").resolve() == path.resolve()
    found = json.loads((folder / "latest.json").read_text())
    assert found["outcomes"][0]["states"] == {"seen": 30, "grown": 2}
    assert found["dates"][0]["legal_deadline"] == "2026-04-02"
    assert len(list(folder.iterdir())) == 6


def test_news_are_failures_the_worst_grade_growth_and_what_became_overdue() -> None:
    assert find_news(REPORT, ALL, ()) == [
        "FAILED tower 2026-04: no control; bring control points",
        "NOT DONE hall 2026-04: the inspection of the portfolio was stopped",
        "LEFT OUT dome 2026-04: needs 90 GiB",
        "WORST GRADE castle 2026-04: 3 defects are severe",
        "GROWTH castle 2026-04: 2 defects have grown significantly",
        "OVERDUE wall: by law: the last day was 2026-04-02; by schedule since 2026-04-01",
        "OVERDUE new: by schedule since 2026-04-01; never inspected",
    ]
    assert find_news(REPORT, ("growth",), ()) == ["GROWTH castle 2026-04: 2 defects have grown significantly"]
    assert find_news(REPORT, ("overdue",), list_overdue_dates(DATES)) == [
        "OVERDUE new: by schedule since 2026-04-01; never inspected"
    ]
    unchanged = replace(REPORT.outcomes[0], outcome="unchanged")
    assert find_news(replace(REPORT, outcomes=(unchanged,)), ("worst_grade", "growth"), ()) == []


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("mailto://me:secret@mail.example/?to=you", "mailto://mail.example/…"),
        ("json://127.0.0.1:8080/token", "json://127.0.0.1:8080/…"),
        ("slack-webhook/owner", "slack-webhook/owner"),
    ],
)
def test_addresses_are_shown_without_their_secrets(address: str, shown: str) -> None:
    assert format_address(address) == shown


def test_durations_are_readable() -> None:
    assert [format_duration(one) for one in (8.4, 200, 7500)] == ["8 s", "3 min", "2 h 5 min"]
