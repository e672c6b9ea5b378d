"""Camera clocks: times that cannot be, that contradict the order of the file names, or that jump against GPS time."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median

# Clocks that lost their battery start in 1970, 1980 or 2000-01-01; digital drones are younger.
_FIRST_YEAR = 2001
# The names carry an order only if most times follow it (downloads and renamed files do not).
_IN_ORDER_SHARE = 0.8
# Receivers and cameras tick together to a second or so; zones shift whole campaigns, not single photographs.
_LARGEST_CLOCK_STEP_S = 60.0


@dataclass(frozen=True, kw_only=True)
class ClockReading:
    """A photograph's name, its body, the camera's time and the receiver's (None where unknown)."""

    photo_id: str
    body: str
    taken_at: datetime | None
    gps_time: datetime | None = None


def is_clock_set(taken_at: datetime | None) -> bool:
    """Whether the clock can have been set at all."""
    return taken_at is not None and taken_at.year >= _FIRST_YEAR


def check_clocks(ticks: Sequence[ClockReading]) -> list[str]:
    """What is odd about each photograph's time, in words; empty where nothing is."""
    warnings: list[list[str]] = [[] for _ in ticks]
    for i, tick in enumerate(ticks):
        if tick.taken_at is not None and not is_clock_set(tick.taken_at):
            warnings[i].append(
                f"taken at {tick.taken_at:%Y-%m-%d}: the camera's clock was not set; the time is not used"
            )
    for body in sorted({tick.body for tick in ticks}):
        members = [i for i, tick in enumerate(ticks) if tick.body == body and is_clock_set(tick.taken_at)]
        for i in _find_out_of_order(members, ticks):
            warnings[i].append(
                "its time does not fit its place in the order of file names: the clock was set, or files renamed"
            )
        for i, seconds in _find_gps_time_offsets(members, ticks):
            warnings[i].append(f"the camera's clock is {seconds:+.0f} s off GPS time, against the other photographs'")
    return ["; ".join(lines) for lines in warnings]


def _split_digits(photo_id: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in re.split(r"(\d+)", photo_id)]


def _find_out_of_order(members: list[int], ticks: Sequence[ClockReading]) -> list[int]:
    """Those outside the longest run of names whose times do not fall; folders are orders of their own."""
    out: list[int] = []
    for folder in sorted({ticks[i].photo_id.rpartition("/")[0] for i in members}):
        names = [i for i in members if ticks[i].photo_id.rpartition("/")[0] == folder]
        names.sort(key=lambda i: _split_digits(ticks[i].photo_id))
        kept = _find_longest_nondecreasing([_seconds_from_time(ticks[i].taken_at) for i in names])
        if len(kept) >= _IN_ORDER_SHARE * len(names):
            out += [i for k, i in enumerate(names) if k not in kept]
    return out


def _seconds_from_time(time: datetime | None) -> float:
    return time.timestamp() if time is not None else float("nan")


def _find_longest_nondecreasing(values: list[float]) -> set[int]:
    """Positions of a longest subsequence that does not fall (patience sorting)."""
    ends: list[float] = []
    end_at: list[int] = []
    before: list[int] = []
    for k, value in enumerate(values):
        place = bisect_right(ends, value)
        before.append(end_at[place - 1] if place else -1)
        ends[place : place + 1] = [value]
        end_at[place : place + 1] = [k]
    kept: set[int] = set()
    k = end_at[-1] if end_at else -1
    while k >= 0:
        kept.add(k)
        k = before[k]
    return kept


def _find_gps_time_offsets(members: list[int], ticks: Sequence[ClockReading]) -> list[tuple[int, float]]:
    both = [i for i in members if ticks[i].gps_time is not None]
    if len(both) < 3:
        return []
    offsets = {i: _seconds_from_time(ticks[i].taken_at) - _seconds_from_time(ticks[i].gps_time) for i in both}
    usual = median(offsets.values())
    return [(i, offset - usual) for i, offset in offsets.items() if abs(offset - usual) > _LARGEST_CLOCK_STEP_S]
