"""When a building is to be inspected: by its schedule, and by the cycle that the law asks for.

A date of the schedule is open until an inspection counts for it. An inspection counts for one date: photographs taken
at most ``early_days`` before a date count for that date, but for no date that is nearer to the one before it; else they
count for the date that has passed. The first open date is when the next inspection is due, or since when it is overdue.

A building that was never inspected has no photographs to count from. Its first open date is the first one after the
building was registered, so that it becomes overdue too; by law no deadline is known.
"""

from __future__ import annotations

from calendar import monthrange
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from zoneinfo import ZoneInfo

from cronsim import CronSim

from facadelake.registry import Schedule

_CLOCK_TOLERANCE = timedelta(days=1)  # of a camera whose offset from UTC is unknown


@dataclass(frozen=True, kw_only=True)
class InspectionDates:
    """Dates of a building: of its last inspection, of the next one, and since when one is overdue (None: it is not).

    ``next_date`` is the first date of the schedule after now that no inspection counts for. ``legal_deadline`` is the
    last day on which the law allows the next inspection, in the schedule's time zone; it has passed where
    ``legal_overdue``. ``remarks`` tell what is unknown or contradictory.
    """

    building_id: str
    last_inspected_at: datetime | None
    next_date: datetime | None
    overdue_since: datetime | None
    legal_deadline: date | None
    legal_overdue: bool
    remarks: tuple[str, ...] = ()

    @property
    def is_overdue(self) -> bool:
        """Whether an inspection is overdue by schedule or by law."""
        return self.overdue_since is not None or self.legal_overdue


@dataclass(frozen=True, kw_only=True)
class CapturedCampaign:
    """A campaign in the lake, and when its last photograph was taken."""

    campaign_id: str
    captured_to: datetime


def find_dates(
    building_id: str,
    schedule: Schedule | None,
    campaigns: Sequence[CapturedCampaign],
    *,
    registered_at: datetime,
    now: datetime,
) -> InspectionDates:
    """The dates of a building.

    Args:
        building_id: the building.
        schedule: its schedule; None: it has no dates.
        campaigns: its campaigns in the lake.
        registered_at: when the building was first seen in the portfolio.
        now: the present time.

    Returns:
        The dates. A campaign whose photographs are of the future counts for no date, and a remark says so.
    """
    remarks = [
        f"campaign {one.campaign_id}: its photographs say that they were taken on {one.captured_to:%Y-%m-%d}, after "
        f"today ({now:%Y-%m-%d}), so they count for no date; correct the clock of the camera and of this machine"
        for one in campaigns
        if one.captured_to > now + _CLOCK_TOLERANCE
    ]
    last = max((one.captured_to for one in campaigns if one.captured_to <= now + _CLOCK_TOLERANCE), default=None)
    if schedule is None:
        return InspectionDates(
            building_id=building_id,
            last_inspected_at=last,
            next_date=None,
            overdue_since=None,
            legal_deadline=None,
            legal_overdue=False,
            remarks=tuple(remarks),
        )
    zone = ZoneInfo(schedule.timezone)
    open_date = find_next_date(schedule, registered_at if last is None else find_served_date(schedule, last))
    deadline = None
    if schedule.cycle_months is not None:
        if last is None:
            remarks.append(
                f"never inspected: the law asks for an inspection every {schedule.cycle_months} months, and since when "
                "is not known"
            )
        else:
            deadline = add_months(last.astimezone(zone).date(), schedule.cycle_months)
    overdue = open_date <= now
    return InspectionDates(
        building_id=building_id,
        last_inspected_at=last,
        next_date=find_next_date(schedule, now) if overdue else open_date,
        overdue_since=open_date if overdue else None,
        legal_deadline=deadline,
        legal_overdue=deadline is not None and now.astimezone(zone).date() > deadline,
        remarks=tuple(remarks),
    )


def find_served_date(schedule: Schedule, captured_at: datetime) -> datetime:
    """The date of the schedule that photographs of this time count for."""
    after = find_next_date(schedule, captured_at)
    before = _find_date_before(schedule, after)
    zone = ZoneInfo(schedule.timezone)
    early = after.astimezone(zone) - timedelta(days=schedule.early_days)  # by the clock, whatever summer time does
    earliest = max(early.astimezone(UTC), before + (after - before) / 2)
    return after if captured_at >= earliest else before


def find_next_date(schedule: Schedule, time: datetime) -> datetime:
    """The first date of the schedule after ``time``, in UTC.

    A time that does not exist (summer time begins) is the first that does; one that there is twice is its first.
    """
    for found in CronSim(schedule.cron, time.astimezone(ZoneInfo(schedule.timezone))):
        in_utc = found.astimezone(UTC)
        if in_utc > time:  # in the hour that there is twice, CronSim begins with its first one
            return in_utc
    raise AssertionError("the portfolio admits no schedule without dates")


def _find_date_before(schedule: Schedule, date_of_schedule: datetime) -> datetime:
    for found in CronSim(schedule.cron, date_of_schedule.astimezone(ZoneInfo(schedule.timezone)), reverse=True):
        in_utc = found.astimezone(UTC)
        if in_utc < date_of_schedule:
            return in_utc
    raise AssertionError("the portfolio admits no schedule without dates")


def add_months(day: date, months: int) -> date:
    """The same day so many months later, or the last one of a month that is shorter."""
    years, month = divmod(day.month - 1 + months, 12)
    year = day.year + years
    return date(year, month + 1, min(day.day, monthrange(year, month + 1)[1]))
