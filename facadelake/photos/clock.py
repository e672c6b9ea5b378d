"""Camera clocks: times that are impossible, contradict the order of the file names, or jump against GPS time."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median

# Clocks without battery start at 1970, 1980 or 2000-01-01; camera drones are younger.
_FIRST_YEAR = 2001
# File names are in order of time only if most times agree (downloaded and renamed files are not).
_IN_ORDER_SHARE = 0.8
# Receiver and camera agree to about a second; a time zone shifts whole campaigns, not single photographs.
_LARGEST_CLOCK_STEP_S = 60.0


@dataclass(frozen=True, kw_only=True)
class ClockReading:
    """A photograph, its camera body, the time of the camera and of the GNSS receiver (None where unknown)."""

    photo_id: str
    body: str
    taken_at: datetime | None
    gps_time: datetime | None = None


def is_clock_set(taken_at: datetime | None) -> bool:
    """Whether a time is known and late enough for a clock that was set."""
    return taken_at is not None and taken_at.year >= _FIRST_YEAR


def check_clocks(readings: Sequence[ClockReading]) -> list[str]:
    """Warnings about the time of each photograph; empty where there are none."""
    warnings: list[list[str]] = [[] for _ in readings]
    for i, reading in enumerate(readings):
        if reading.taken_at is not None and not is_clock_set(reading.taken_at):
            warnings[i].append(
                f"taken at {reading.taken_at:%Y-%m-%d}: the camera's clock was not set; the time is not used"
            )
    for body in sorted({reading.body for reading in readings}):
        members = [i for i, reading in enumerate(readings) if reading.body == body and is_clock_set(reading.taken_at)]
        for i in _find_out_of_order(members, readings):
            warnings[i].append(
                "the time contradicts the order of the file names: the clock was changed, or files were renamed"
            )
        for i, seconds in _find_gps_time_offsets(members, readings):
            warnings[i].append(
                f"the camera's clock differs from GPS time by {seconds:+.0f} s relative to the other photographs"
            )
    return ["; ".join(lines) for lines in warnings]


def _split_digits(photo_id: str) -> list[tuple[int, str]]:
    """Sort key of natural order: digits compare as numbers."""
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in re.split(r"(\d+)", photo_id)]


def _find_out_of_order(members: list[int], readings: Sequence[ClockReading]) -> list[int]:
    """Members outside the longest non-decreasing sequence of times by file name; each folder by itself."""
    out: list[int] = []
    for folder in sorted({readings[i].photo_id.rpartition("/")[0] for i in members}):
        names = [i for i in members if readings[i].photo_id.rpartition("/")[0] == folder]
        names.sort(key=lambda i: _split_digits(readings[i].photo_id))
        kept = _find_longest_nondecreasing([seconds_from_time(readings[i].taken_at) for i in names])
        if len(kept) >= _IN_ORDER_SHARE * len(names):
            out += [i for k, i in enumerate(names) if k not in kept]
    return out


def seconds_from_time(time: datetime | None) -> float:
    """Seconds since 1970; NaN where the time is unknown."""
    return time.timestamp() if time is not None else float("nan")


def _find_longest_nondecreasing(values: list[float]) -> set[int]:
    """Positions of a longest non-decreasing subsequence, by patience sorting."""
    tails: list[float] = []
    tail_at: list[int] = []
    previous: list[int] = []
    for k, value in enumerate(values):
        pile = bisect_right(tails, value)
        previous.append(tail_at[pile - 1] if pile else -1)
        tails[pile : pile + 1] = [value]
        tail_at[pile : pile + 1] = [k]
    kept: set[int] = set()
    k = tail_at[-1] if tail_at else -1
    while k >= 0:
        kept.add(k)
        k = previous[k]
    return kept


def _find_gps_time_offsets(members: list[int], readings: Sequence[ClockReading]) -> list[tuple[int, float]]:
    """Members whose clock differs from GPS time by another amount than the median, with the difference in seconds."""
    both = [i for i in members if readings[i].gps_time is not None]
    if len(both) < 3:
        return []
    offsets = {i: seconds_from_time(readings[i].taken_at) - seconds_from_time(readings[i].gps_time) for i in both}
    typical = median(offsets.values())
    return [(i, offset - typical) for i, offset in offsets.items() if abs(offset - typical) > _LARGEST_CLOCK_STEP_S]
