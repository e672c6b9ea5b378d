"""The campaign of a folder's name: a date in it, or a name like those of the building's other campaigns."""

from __future__ import annotations

from datetime import date, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facadelake.core.errors import InputDataError
from facadelake.intake.campaign_name import find_period, name_campaign, name_campaign_by_dates


@pytest.mark.parametrize(
    ("folder", "campaign"),
    [
        ("2026-04", "2026-04"),
        ("2026-04-14", "2026-04-14"),
        ("2026", "2026"),
        ("2026_04", "2026-04"),
        ("2026-04-east", "2026-04-east"),
        ("20260414", "2026-04-14"),
        ("20260414_flight2", "2026-04-14_flight2"),
        ("2026-04 Schloss", "2026-04"),
        ("Schloss 2026-04", "2026-04"),
        ("DJI_202604141030_001_castle", "2026-04-14"),
        ("Befliegung 14.04.2026", "2026-04-14"),
        ("4.4.2026", "2026-04-04"),
        ("DCIM", None),
        ("100MEDIA", None),
        ("101_0414", None),
        ("New folder (2)", None),
        ("Hauptstrasse 2024", None),  # a number of a house, or a year
        ("04-05-2026", None),  # April or May
        ("IMG_12345678", None),
        ("20269999", None),
    ],
)
def test_names(folder: str, campaign: str | None) -> None:
    assert name_campaign(folder, []) == campaign


@pytest.mark.parametrize("folder", ["2026-13", "2026-02-30", "31.02.2026", "mill 2026_00"])
def test_dates_that_the_calendar_does_not_have(folder: str) -> None:
    with pytest.raises(InputDataError, match="of the calendar"):
        name_campaign(folder, [])


def test_a_name_like_those_of_other_campaigns() -> None:
    assert name_campaign("c3", ["c1", "c2"]) == "c3"
    assert name_campaign("100MEDIA", ["c1", "c2"]) is None
    assert name_campaign("100MEDIA", ["2026-04"]) is None


def test_a_campaign_is_named_by_its_first_photograph_as_the_others_are() -> None:
    times = [datetime(2026, 5, 1, 8), datetime(2026, 4, 30, 9)]
    assert name_campaign_by_dates(times, []) == "2026-04"
    assert name_campaign_by_dates(times, ["2025-04", "2025-10-01"]) == "2026-04"
    assert name_campaign_by_dates(times, ["2025-04-02", "2025-10-01"]) == "2026-04-30"


@given(st.dates(min_value=date(1990, 1, 1), max_value=date(2099, 12, 31)), st.sampled_from(["%Y-%m-%d", "%Y%m%d"]))
def test_every_day_is_found_and_within_its_period(day: date, form: str) -> None:
    period = find_period(f"mill {day.strftime(form)} x")
    assert period is not None and period.text == day.isoformat() and period.first == period.last == day
    assert period.is_within(datetime(day.year, day.month, day.day, 23, 59))
