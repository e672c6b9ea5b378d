"""A quarter on a compressed clock: fifty buildings, uploads in pieces, an inspection of the portfolio every night.

Inspecting is marking as done; the dates of the schedules, and what counts for them, are enumerated here without the
code under test.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from facadelake.core.hashing import hash_file
from facadelake.registry import Building, Portfolio
from facadelake.registry.settings import Schedule
from facadelake.scheduling.building_log import write_building_log
from facadelake.scheduling.committed import CommittedBuilding, CommittedCampaign
from facadelake.scheduling.news import find_news, list_overdue_dates
from facadelake.scheduling.photograph_files import CommittedPhotograph, list_photograph_files
from facadelake.scheduling.plan import plan_portfolio
from facadelake.scheduling.report import PortfolioReport

BUILDINGS = 50
FIRST_NIGHT = datetime(2026, 2, 1, 2, tzinfo=UTC)  # the quarter has the beginning of summer time in it
NIGHTS = 92
DAY = timedelta(days=1)
MONTHS = {"0 6 1 * *": range(1, 13), "0 6 1 2,4 *": (2, 4), "0 6 1 3 *": (3,), "30 2 29 3 *": (3,)}


@dataclass(kw_only=True)
class Upload:
    """A campaign that arrives in pieces, one a day."""

    building: int
    first_day: int
    pieces: int
    campaign_id: str = ""


@dataclass(kw_only=True)
class Simulation:
    """What is in the lake, which uploads are whole, and what was inspected and told."""

    root: Path
    held: dict[str, CommittedBuilding] = field(default_factory=dict)
    growing: set[tuple[str, str]] = field(default_factory=set)
    inspected: Counter[tuple[str, str]] = field(default_factory=Counter)
    told: Counter[str] = field(default_factory=Counter)


UPLOADS = st.lists(
    st.builds(
        Upload,
        building=st.integers(0, BUILDINGS - 1),
        first_day=st.integers(0, NIGHTS - 1),
        pieces=st.integers(1, 4),
    ),
    min_size=30,
    max_size=80,
    unique_by=lambda one: (one.building, one.first_day),
)


def enumerate_dates(schedule: Schedule) -> list[datetime]:
    """All dates of three years."""
    minute, hour, day, *_ = schedule.cron.split()
    zone = ZoneInfo(schedule.timezone)
    found = [
        datetime(year, month, int(day), int(hour), int(minute), tzinfo=zone).astimezone(UTC)
        for year in (2024, 2025, 2026, 2027)
        for month in MONTHS[schedule.cron]
    ]
    in_gap = datetime(2026, 3, 29, 2, 30, tzinfo=ZoneInfo("Europe/Berlin")).astimezone(UTC)
    return sorted(datetime(2026, 3, 29, 1, 0, tzinfo=UTC) if one == in_gap else one for one in found)


def find_served(dates: list[datetime], captured: datetime, early_days: int) -> datetime:
    """The last date whose time for photographs has begun."""
    windows = [min(early_days * DAY, (after - before) / 2) for before, after in pairwise(dates)]
    return max(after for after, window in zip(dates[1:], windows, strict=True) if after - window <= captured)


@settings(
    max_examples=3,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(uploads=UPLOADS, seed=st.integers(0, 2**16))
def test_every_upload_is_inspected_once_and_every_overdue_date_is_told_once(
    uploads: list[Upload], seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    simulation = Simulation(root=tmp_path_factory.mktemp("quarter"))
    portfolio = Portfolio(buildings=tuple(make_building(simulation.root, number, seed) for number in range(BUILDINGS)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("facadelake.scheduling.plan.read_committed_buildings", lambda lake, ids: simulation.held)
        simulation.held = {building.id: CommittedBuilding() for building in portfolio.buildings}
        for day in range(NIGHTS):
            receive(simulation, uploads, day)
            inspect_night(simulation, portfolio, FIRST_NIGHT + day * DAY)
    whole = [one for one in uploads if one.first_day + one.pieces <= NIGHTS]
    assert simulation.inspected == Counter((f"b{one.building}", one.campaign_id) for one in whole)
    assert set(simulation.told.values()) <= {1}


def make_building(root: Path, number: int, seed: int) -> Building:
    crons = sorted(MONTHS)
    schedule = Schedule(
        cron=crons[(number + seed) % len(crons)],
        timezone=("UTC", "Europe/Berlin", "America/New_York")[(number * 7 + seed) % 3]
        if number % 4
        else "Europe/Berlin",
        early_days=(0, 10, 30)[number % 3],
        cycle_months=(None, 1, 12)[(number + seed) % 3],
    )
    if schedule.cron.startswith("30 2"):
        schedule = schedule.model_copy(update={"timezone": "Europe/Berlin"})
    (root / f"b{number}").mkdir()
    return Building(
        id=f"b{number}",
        name="b",
        model=f"{root}/m.ifc",
        photographs=f"{root}/b{number}/{{campaign}}",
        schedule=schedule,
    )


def receive(simulation: Simulation, uploads: list[Upload], day: int) -> None:
    """The pieces of the day; the campaign is named by its first day."""
    for one in uploads:
        piece = day - one.first_day
        if 0 <= piece < one.pieces:
            one.campaign_id = f"{FIRST_NIGHT.date() + one.first_day * DAY}"
            folder = simulation.root / f"b{one.building}" / one.campaign_id
            folder.mkdir(exist_ok=True)
            (folder / f"{piece}.jpg").write_bytes(bytes([piece]))
            key = (f"b{one.building}", one.campaign_id)
            (simulation.growing.discard if piece == one.pieces - 1 else simulation.growing.add)(key)


def inspect_night(simulation: Simulation, portfolio: Portfolio, now: datetime) -> None:
    lake = simulation.root / "lake"
    plan = plan_portfolio(
        portfolio,
        lake,
        code_sha256="c",
        now=now,
        check_upload=lambda building, campaign: "grows" if (building.id, campaign) in simulation.growing else "",
        memory_mib=1e6,
    )
    for one in plan.waiting:
        key = (one.building_id, one.campaign_id)
        assert key not in simulation.growing
        simulation.inspected[key] += 1
        folder = simulation.root / one.building_id / one.campaign_id
        simulation.held[one.building_id].campaigns[one.campaign_id] = CommittedCampaign(
            campaign_id=one.campaign_id,
            captured_to=datetime.combine(date.fromisoformat(one.campaign_id), FIRST_NIGHT.timetz()),
            run_id=f"{now}",
            started_at=datetime.now(UTC) + DAY,
            peak_mib=None,
            photographs={
                name: CommittedPhotograph(bytes=record.bytes, sha256=hash_file(folder / name))
                for name, record in list_photograph_files(folder).items()
            },
        )
    for building, found in zip(portfolio.buildings, plan.dates, strict=True):
        assert building.schedule is not None
        captured = [
            campaign.captured_to
            for campaign in simulation.held[building.id].campaigns.values()
            if campaign.captured_to is not None and campaign.run_id < f"{now}"
        ]
        dates = enumerate_dates(building.schedule)
        start = find_served(dates, max(captured), building.schedule.early_days) if captured else FIRST_NIGHT
        opened = next(one for one in dates if one > start)
        assert found.overdue_since == (opened if opened <= now else None), building
    report = PortfolioReport(started_at=now, finished_at=now, outcomes=(), left_out=(), not_done=(), dates=plan.dates)
    told = {name for log in plan.logs.values() for name in log.told_overdue}
    news = find_news(report, ("overdue",), told)
    overdue = {one.building_id: set(list_overdue_dates(one)) for one in plan.dates}
    assert {line.split()[1].rstrip(":") for line in news} == {name for name, one in overdue.items() if one - told}
    for building_id, log in plan.logs.items():
        simulation.told.update(overdue[building_id] - set(log.told_overdue))
        log.told_overdue = sorted({*log.told_overdue, *overdue[building_id]})
        write_building_log(lake, building_id, log)
