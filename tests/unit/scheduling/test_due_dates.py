"""Dates of inspections: schedules at the change of summer time, leap days, early photographs, the law's cycle."""

from datetime import UTC, date, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facadelake.registry.settings import Schedule
from facadelake.scheduling.due_dates import (
    CapturedCampaign,
    InspectionDates,
    add_months,
    find_dates,
    find_next_date,
    find_served_date,
)

HALF_YEARLY = Schedule(cron="0 6 1 4,10 *", timezone="Europe/Berlin")


def at(text: str) -> datetime:
    """A time in UTC."""
    return datetime.fromisoformat(text).replace(tzinfo=UTC)


def dates(schedule: Schedule | None, captured: list[str], now: str, registered: str = "2024-01-01") -> InspectionDates:
    campaigns = [CapturedCampaign(campaign_id=text[:7], captured_to=at(text)) for text in captured]
    return find_dates("wall", schedule, campaigns, registered_at=at(registered), now=at(now))


@pytest.mark.parametrize(
    ("cron", "zone", "time", "expected"),
    [
        # 2026-03-29 02:00 is 03:00 in Berlin; 2026-10-25 03:00 is 02:00. By the law's tables, not by a library.
        ("30 2 * * *", "Europe/Berlin", "2026-03-28T12:00", "2026-03-29T01:00"),  # 02:30 is not there: 03:00 CEST
        ("15,45 2 29 3 *", "Europe/Berlin", "2026-03-29T01:00", "2027-03-29T00:15"),  # both are 03:00, once
        ("30 2 * * *", "Europe/Berlin", "2026-10-24T12:00", "2026-10-25T00:30"),  # the first of two
        ("30 2 * * *", "Europe/Berlin", "2026-10-25T00:30", "2026-10-26T01:30"),  # and not the second
        ("30 2 * * *", "Europe/Berlin", "2026-10-25T01:10", "2026-10-26T01:30"),  # asked in the repeated hour
        ("0 6 1 4,10 *", "Europe/Berlin", "2026-01-01T00:00", "2026-04-01T04:00"),
        ("0 6 1 4,10 *", "America/New_York", "2026-01-01T00:00", "2026-04-01T10:00"),
        ("0 6 1 1 *", "America/New_York", "2026-01-01T10:59", "2026-01-01T11:00"),
        ("0 6 1 1 *", "Asia/Kolkata", "2025-12-01T00:00", "2026-01-01T00:30"),
        ("0 0 31 12 *", "Pacific/Apia", "2011-12-29T00:00", "2011-12-30T10:00"),  # 30 December 2011 was left out there
        ("15 2 4 10 *", "Australia/Lord_Howe", "2026-10-01T00:00", "2026-10-03T15:30"),  # half an hour of summer time
        ("0 6 29 2 *", "UTC", "2026-01-01T00:00", "2028-02-29T06:00"),
    ],
)
def test_the_next_date_of_a_schedule(cron: str, zone: str, time: str, expected: str) -> None:
    assert find_next_date(Schedule(cron=cron, timezone=zone), at(time)) == at(expected)


@pytest.mark.parametrize(
    ("captured", "served"),
    [
        ("2026-03-01T12:00", "2025-10-01T04:00"),  # 31 days before: of the date that has passed
        ("2026-03-02T03:59", "2025-10-01T04:00"),  # 30 days before 06:00 summer time is 06:00 winter time
        ("2026-03-02T05:00", "2026-04-01T04:00"),
        ("2026-04-01T04:00", "2026-04-01T04:00"),
        ("2026-08-30T12:00", "2026-04-01T04:00"),  # late
    ],
)
def test_photographs_count_for_one_date(captured: str, served: str) -> None:
    assert find_served_date(HALF_YEARLY, at(captured)) == at(served)


def test_early_photographs_of_a_monthly_schedule_count_for_the_nearer_date() -> None:
    """With the default of 30 days every inspection would else count for two dates, and every other date for none."""
    monthly = Schedule(cron="0 6 1 * *")
    assert find_served_date(monthly, at("2026-01-02T12:00")) == at("2026-01-01T06:00")
    assert find_served_date(monthly, at("2026-01-20T12:00")) == at("2026-02-01T06:00")
    assert dates(monthly, ["2026-01-02T12:00"], "2026-02-02").overdue_since == at("2026-02-01T06:00")


def test_what_is_due_and_overdue() -> None:
    found = dates(HALF_YEARLY, ["2025-10-20T12:00", "2026-03-20T12:00"], "2026-05-01")
    assert (found.next_date, found.overdue_since, found.is_overdue) == (at("2026-10-01T04:00"), None, False)
    late = dates(HALF_YEARLY, ["2025-04-02T12:00"], "2026-05-01")
    assert (late.next_date, late.overdue_since) == (at("2026-10-01T04:00"), at("2025-10-01T04:00"))
    assert dates(HALF_YEARLY, ["2025-10-20T12:00"], "2026-04-01T03:59").overdue_since is None
    assert dates(HALF_YEARLY, ["2025-10-20T12:00"], "2026-04-01T04:00").overdue_since == at("2026-04-01T04:00")


def test_a_building_that_was_never_inspected_becomes_overdue_too() -> None:
    before = dates(HALF_YEARLY, [], "2026-03-01", registered="2026-02-01")
    assert (before.last_inspected_at, before.next_date, before.overdue_since) == (None, at("2026-04-01T04:00"), None)
    after = dates(HALF_YEARLY, [], "2026-06-01", registered="2026-02-01")
    assert (after.next_date, after.overdue_since) == (at("2026-10-01T04:00"), at("2026-04-01T04:00"))
    by_law = dates(HALF_YEARLY.model_copy(update={"cycle_months": 60}), [], "2026-06-01")
    assert by_law.legal_deadline is None
    assert by_law.remarks == (
        "never inspected: the law asks for an inspection every 60 months, and since when is not known",
    )


@pytest.mark.parametrize(
    ("day", "months", "expected"),
    [
        (date(2024, 2, 29), 12, date(2025, 2, 28)),
        (date(2024, 2, 29), 48, date(2028, 2, 29)),
        (date(2025, 1, 31), 1, date(2025, 2, 28)),
        (date(2025, 12, 15), 1, date(2026, 1, 15)),
        (date(2025, 11, 30), 3, date(2026, 2, 28)),
        (date(2026, 4, 14), 240, date(2046, 4, 14)),
    ],
)
def test_months_of_the_law(day: date, months: int, expected: date) -> None:
    assert add_months(day, months) == expected


def test_the_law_counts_days_in_the_time_zone_of_the_building() -> None:
    schedule = Schedule(cron="0 6 1 1 *", timezone="America/New_York", cycle_months=12)
    captured = ["2025-04-15T02:00"]  # the evening of the 14th in New York
    assert dates(schedule, captured, "2026-04-15T03:59").legal_deadline == date(2026, 4, 14)
    assert not dates(schedule, captured, "2026-04-15T03:59").legal_overdue  # still the 14th there
    assert dates(schedule, captured, "2026-04-15T04:00").legal_overdue
    assert not dates(schedule, captured, "2026-01-02").legal_overdue  # though the date of the schedule has passed
    assert dates(schedule, captured, "2026-01-02").overdue_since == at("2026-01-01T11:00")


def test_photographs_of_the_future_count_for_no_date() -> None:
    found = dates(HALF_YEARLY, ["2025-04-02T12:00", "2099-01-01T00:00"], "2026-05-01")
    assert found.last_inspected_at == at("2025-04-02T12:00")
    assert found.overdue_since == at("2025-10-01T04:00")
    assert "2099-01-01, after today (2026-05-01), so they count for no date" in found.remarks[0]


def test_a_building_without_a_schedule_has_no_dates() -> None:
    found = dates(None, ["2025-04-02T12:00"], "2026-05-01")
    assert (found.next_date, found.is_overdue, found.last_inspected_at) == (None, False, at("2025-04-02T12:00"))


CRONS = st.sampled_from(["30 2 * * *", "0 6 1 4,10 *", "0 0 1 * *", "15 * * * *", "30 1 * * SUN", "59 23 L * *"])
ZONES = st.sampled_from(["UTC", "Europe/Berlin", "America/New_York", "Australia/Lord_Howe", "Asia/Kathmandu"])
TIMES = st.datetimes(datetime(2020, 1, 1), datetime(2035, 1, 1), timezones=st.just(UTC))


@given(cron=CRONS, zone=ZONES, time=TIMES, early=st.integers(0, 366))
def test_dates_advance_and_each_time_has_one(cron: str, zone: str, time: datetime, early: int) -> None:
    schedule = Schedule(cron=cron, timezone=zone, early_days=early)
    after = find_next_date(schedule, time)
    served = find_served_date(schedule, time)
    assert after > time
    assert find_next_date(schedule, after) > after
    assert served == after or (served <= time and find_next_date(schedule, served) == after)
    assert find_served_date(schedule, after) == after  # photographs of the date itself
