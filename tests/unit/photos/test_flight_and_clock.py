"""The photographs of a flight, and times that are wrong."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from facadelake.photos.clock import ClockReading, check_clocks
from facadelake.photos.flights import Exposure, assign_flights

START = datetime(2026, 4, 14, 10, 0, tzinfo=UTC)


def shots(*seconds: float, heights: list[float] | None = None, body: str = "A", first: int = 0) -> list[Exposure]:
    """Photographs of one body."""
    return [
        Exposure(
            photo_id=f"{body}{first + k:03d}.jpg",
            body=body,
            taken_at=START + timedelta(seconds=second),
            take_off_height_m=heights[k] if heights else math.nan,
        )
        for k, second in enumerate(seconds)
    ]


def test_a_gap_of_more_than_ten_minutes_ends_a_flight() -> None:
    assert assign_flights(shots(0, 5, 600, 1200, 1801, 1900)) == [1, 1, 1, 1, 2, 2]


def test_flights_are_numbered_in_time_whatever_the_order_of_files() -> None:
    assert assign_flights([*shots(9000, 9005), *shots(0, 5, first=2)]) == [2, 2, 1, 1]


def test_two_bodies_in_the_air_at_once_are_two_flights() -> None:
    assert assign_flights([*shots(0, 10, 20), *shots(5, 15, body="B")]) == [1, 1, 1, 2, 2]


def test_the_makers_own_flight_id_parts_flights_without_a_gap() -> None:
    first, second = shots(0, 10), shots(60, 70, first=2)
    named = [Exposure(photo_id=s.photo_id, body=s.body, taken_at=s.taken_at, flight_id="x") for s in second]
    assert assign_flights([*first, *named]) == [1, 1, 2, 2]


@pytest.mark.parametrize(
    ("heights", "flights"),
    [
        ([180.0, 180.0, 180.1, 174.0, 174.0, 174.1], [1, 1, 1, 2, 2, 2]),  # a battery changed within minutes
        ([180.0, 180.0, 180.1, 168.0, 180.0, 180.1], [1] * 6),  # one bad height
        ([180.0, 181.0, 182.0, 183.0, 184.0, 185.0], [1] * 6),  # a barometer's drift against RTK
        ([180.0, 180.0, 180.1, 178.5, 178.5, 178.6], [1] * 6),  # less than a new take-off
        ([math.nan] * 6, [1] * 6),
    ],
)
def test_a_new_take_off_height_that_holds_ends_a_flight(heights: list[float], flights: list[int]) -> None:
    assert assign_flights(shots(0, 10, 20, 90, 100, 110, heights=heights)) == flights


def test_lenses_that_fire_in_turns_and_state_other_heights_are_one_flight() -> None:
    """A wide and a thermal camera of one body, whose take-off heights differ by 6 m: it became one flight a pair."""
    wide = shots(*range(0, 180, 10), heights=[180.0] * 18)
    thermal = [
        replace(exposure, photo_id=f"t{k}", lens="thermal", take_off_height_m=174.0) for k, exposure in enumerate(wide)
    ]
    assert assign_flights([*wide, *thermal]) == [1] * 36
    landed = [*[180.0] * 9, *[170.0] * 9]  # a new take-off of both
    wide = [replace(e, take_off_height_m=h) for e, h in zip(wide, landed, strict=True)]
    thermal = [replace(e, take_off_height_m=h - 6) for e, h in zip(thermal, landed, strict=True)]
    assert assign_flights([*wide, *thermal]) == ([1] * 9 + [2] * 9) * 2


def test_photographs_without_a_time_are_one_flight_of_their_body() -> None:
    untimed = [Exposure(photo_id=f"u{k}.jpg", body="A", taken_at=None) for k in range(3)]
    assert assign_flights([*untimed, *shots(0, 10)]) == [2, 2, 2, 1, 1]
    assert assign_flights([]) == []


def ticks(*seconds: float | None, gps_off: dict[int, float] | None = None) -> list[ClockReading]:
    """Photographs DJI_0008.JPG and on, without leading zeros; the receiver's clock differs by ``gps_off``."""
    out = []
    for k, second in enumerate(seconds):
        taken = None if second is None else START + timedelta(seconds=second)
        gps = taken - timedelta(seconds=7200 + gps_off.get(k, 0.0)) if taken and gps_off is not None else None
        out.append(ClockReading(photo_id=f"day/DJI_{8 + k}.JPG", body="A", taken_at=taken, gps_time=gps))
    return out


def marked(*args: float | None, **kwargs: dict[int, float]) -> list[int]:
    """Numbers of the photographs with a warning."""
    return [k for k, warning in enumerate(check_clocks(ticks(*args, **kwargs))) if warning]


def test_file_names_in_order_of_time_are_fine() -> None:
    assert marked(0, 2, 2, 4, 6, 90, 4000, 4001) == []  # 8, 9, 10: by number, not by letters


@pytest.mark.parametrize("wrong_s", [-86400.0, 3600.0])
def test_one_time_out_of_the_order_of_names_is_marked_alone(wrong_s: float) -> None:
    assert marked(0, 2, 4, wrong_s, 8, 10, 12, 14) == [3]


def test_names_without_any_order_in_time_give_no_warning() -> None:
    assert marked(50, 10, 40, 20, 30, 0) == []


def test_a_clock_that_was_not_set() -> None:
    assert marked(0, 2, -46 * 365.25 * 86400, 6, None, 10) == [2]


def test_a_clock_that_jumps_against_gps_time_is_marked_and_a_zone_is_not() -> None:
    assert marked(0, 2, 4, 6, 8, gps_off={}) == []
    assert marked(0, 2, 4, 6, 8, gps_off={3: 75.0}) == [3]
    (warning,) = {text for text in check_clocks(ticks(0, 2, 4, 6, 8, gps_off={3: 75.0})) if text}
    assert warning == "the camera's clock differs from GPS time by +75 s relative to the other photographs"
