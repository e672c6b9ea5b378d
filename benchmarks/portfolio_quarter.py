"""A quarter of a portfolio on a compressed clock: uploads in pieces, late photographs, an inspection every night.

Inspecting is marking as done; what is looked at is which campaigns are started when, and what is told. The dates of the
schedules, and what counts for them, are enumerated here without the code that is measured.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch
from zoneinfo import ZoneInfo

from facadelake.core.hashing import hash_file
from facadelake.registry import Building, Portfolio, Schedule
from facadelake.scheduling.building_log import write_building_log
from facadelake.scheduling.committed import CommittedBuilding, CommittedCampaign
from facadelake.scheduling.news import find_news, list_overdue_dates
from facadelake.scheduling.photograph_files import CommittedPhotograph, list_photograph_files
from facadelake.scheduling.plan import PortfolioPlan, WaitingCampaign, plan_portfolio
from facadelake.scheduling.report import PortfolioReport

FIRST_NIGHT = datetime(2026, 2, 1, 2, tzinfo=UTC)  # the quarter has the beginning of summer time in it
NIGHTS = 92
_DAY = timedelta(days=1)
_MONTHS = {"0 6 1 * *": range(1, 13), "0 6 1 2,4 *": (2, 4), "0 6 1 3 *": (3,), "30 2 29 3 *": (3,)}
# 02:30 is left out in Berlin on the day that summer time begins: it is 03:00.
_IN_GAP = datetime(2026, 3, 29, 2, 30, tzinfo=ZoneInfo("Europe/Berlin")).astimezone(UTC)
_AFTER_GAP = datetime(2026, 3, 29, 1, 0, tzinfo=UTC)
_MEMORY_MIB = 1e6


@dataclass(kw_only=True)
class Upload:
    """A campaign that arrives in ``pieces``, one a day, and in one more ``late_days`` after them (0: in none).

    ``is_killed``: the process of its first inspection is killed.
    """

    building: int
    first_day: int
    pieces: int
    late_days: int = 0
    is_killed: bool = False

    @property
    def key(self) -> tuple[str, str]:
        """Building and campaign; the campaign is named by its first day."""
        return f"b{self.building}", f"{FIRST_NIGHT.date() + self.first_day * _DAY}"

    @property
    def last_day(self) -> int:
        """The day of the last piece."""
        return self.first_day + self.pieces - 1

    def count_contents(self) -> int:
        """How often it is to be inspected during the quarter: once for each content that is whole.

        One whose first inspection is killed is inspected a night later, with what is late by then.
        """
        first = self.last_day + self.is_killed
        late = self.last_day + self.late_days
        return (first < NIGHTS) + (first < late < NIGHTS)


@dataclass(kw_only=True)
class Quarter:
    """What happened: inspections by campaign, messages by overdue date, and disagreements with the enumerated dates."""

    root: Path
    portfolio: Portfolio
    uploads: Sequence[Upload]
    inspected: Counter[tuple[str, str]] = field(default_factory=Counter)
    told: Counter[str] = field(default_factory=Counter)
    started_growing: int = 0
    untold: list[str] = field(default_factory=list)
    wrong_dates: list[str] = field(default_factory=list)
    _held: dict[str, CommittedBuilding] = field(default_factory=dict)
    _growing: set[tuple[str, str]] = field(default_factory=set)
    _killed: set[tuple[str, str]] = field(default_factory=set)

    def count_expected(self) -> Counter[tuple[str, str]]:
        """How often each campaign is to be inspected."""
        return Counter({one.key: one.count_contents() for one in self.uploads if one.count_contents()})

    def run(self) -> None:
        """Let the quarter pass."""
        self._held = {building.id: CommittedBuilding() for building in self.portfolio.buildings}
        with patch("facadelake.scheduling.plan.read_committed_buildings", lambda lake, ids: self._held):
            for day in range(NIGHTS):
                self._receive(day)
                self._inspect(FIRST_NIGHT + day * _DAY)

    def _receive(self, day: int) -> None:
        for one in self.uploads:
            piece = day - one.first_day
            is_late = one.late_days > 0 and day == one.last_day + one.late_days
            if not (0 <= piece < one.pieces or is_late):
                continue
            folder = self.root / one.key[0] / one.key[1]
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{piece}.jpg").write_bytes(bytes([piece]))
            (self._growing.add if day < one.last_day else self._growing.discard)(one.key)

    def _inspect(self, now: datetime) -> None:
        lake = self.root / "lake"
        plan = plan_portfolio(
            self.portfolio,
            lake,
            code_sha256="c",
            now=now,
            check_upload=lambda building, campaign: "grows" if (building.id, campaign) in self._growing else "",
            memory_mib=_MEMORY_MIB,
        )
        self._compare_dates(plan, now)
        for one in plan.waiting:
            self._carry_out(one, plan, now)
        self._tell(plan, now)
        for building_id, log in plan.logs.items():
            write_building_log(lake, building_id, log)

    def _carry_out(self, one: WaitingCampaign, plan: PortfolioPlan, now: datetime) -> None:
        key = (one.building_id, one.campaign_id)
        self.started_growing += key in self._growing
        if key not in self._killed and any(upload.key == key and upload.is_killed for upload in self.uploads):
            self._killed.add(key)
            plan.logs[one.building_id].record_failure(
                one.campaign_id, outcome="killed", fingerprint=one.fingerprint, problem="SIGKILL", peak_mib=1.0, at=now
            )
            return
        plan.logs[one.building_id].clear_failure(one.campaign_id)
        self.inspected[key] += 1
        folder = self.root / one.building_id / one.campaign_id
        self._held[one.building_id].campaigns[one.campaign_id] = CommittedCampaign(
            campaign_id=one.campaign_id,
            captured_to=datetime.combine(date.fromisoformat(one.campaign_id), FIRST_NIGHT.timetz()),
            run_id=f"{now}",
            started_at=datetime.now(UTC) + _DAY,  # later than the files, whose times are those of the machine
            peak_mib=None,
            photographs={
                name: CommittedPhotograph(bytes=record.bytes, sha256=hash_file(folder / name))
                for name, record in list_photograph_files(folder).items()
            },
        )

    def _compare_dates(self, plan: PortfolioPlan, now: datetime) -> None:
        for building, found in zip(self.portfolio.buildings, plan.dates, strict=True):
            assert building.schedule is not None
            campaigns = self._held[building.id].campaigns.values()
            captured = [one.captured_to for one in campaigns if one.captured_to is not None]
            dates = _enumerate_dates(building.schedule)
            start = _find_served(dates, max(captured), building.schedule.early_days) if captured else FIRST_NIGHT
            opened = next(one for one in dates if one > start)
            expected = opened if opened <= now else None
            if found.overdue_since != expected:
                self.wrong_dates.append(f"{now} {building.id}: {found.overdue_since} instead of {expected}")

    def _tell(self, plan: PortfolioPlan, now: datetime) -> None:
        report = PortfolioReport(
            started_at=now, finished_at=now, outcomes=(), left_out=(), not_done=(), dates=plan.dates
        )
        told = {name for log in plan.logs.values() for name in log.told_overdue}
        for line in find_news(report, ("overdue",), told):
            building_id = line.split()[1].rstrip(":")
            found = next(one for one in plan.dates if one.building_id == building_id)
            new = set(list_overdue_dates(found)) - told
            self.told.update(new)
            plan.logs[building_id].told_overdue = sorted({*plan.logs[building_id].told_overdue, *new})
        self.untold += [name for one in plan.dates for name in list_overdue_dates(one) if name not in self.told]


def make_portfolio(root: Path, buildings: int, seed: int) -> Portfolio:
    """Buildings of various schedules, time zones, days of early photographs and cycles by law."""
    return Portfolio(buildings=tuple(_make_building(root, number, seed) for number in range(buildings)))


def _make_building(root: Path, number: int, seed: int) -> Building:
    cron = sorted(_MONTHS)[(number + seed) % len(_MONTHS)]
    zone = ("UTC", "Europe/Berlin", "America/New_York")[(number * 7 + seed) % 3]
    return Building(
        id=f"b{number}",
        name="b",
        model=f"{root}/m.ifc",
        photographs=f"{root}/b{number}/{{campaign}}",
        schedule=Schedule(
            cron=cron,
            timezone="Europe/Berlin" if cron.startswith("30 2") else zone,
            early_days=(0, 10, 30)[number % 3],
            cycle_months=(None, 1, 12)[(number + seed) % 3],
        ),
    )


def _enumerate_dates(schedule: Schedule) -> list[datetime]:
    """All dates of four years."""
    minute, hour, day, *_ = schedule.cron.split()
    zone = ZoneInfo(schedule.timezone)
    found = [
        datetime(year, month, int(day), int(hour), int(minute), tzinfo=zone).astimezone(UTC)
        for year in (2024, 2025, 2026, 2027)
        for month in _MONTHS[schedule.cron]
    ]
    return sorted(_AFTER_GAP if one == _IN_GAP else one for one in found)


def _find_served(dates: Sequence[datetime], captured: datetime, early_days: int) -> datetime:
    """The last date whose time for photographs has begun."""
    windows = [(after, min(early_days * _DAY, (after - before) / 2)) for before, after in pairwise(dates)]
    return max(after for after, window in windows if after - window <= captured)
