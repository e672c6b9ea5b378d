"""Flights: photographs whose position priors share one receiver's state, and so one common error.

What a flight is for: GPS and barometer are off by metres, but for one body over some minutes by nearly the same
metres; the adjustment estimates that offset once a flight. So a flight ends where that sameness does: another body, a
gap of more than ten minutes (a landing; satellites and pressure change), or a new take-off, which gives
RelativeAltitude a new zero: AbsoluteAltitude - RelativeAltitude steps. A flight too many costs little, one too few
bends the block.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median

LONGEST_GAP_S = 600.0
# Barometric flights hold the take-off's height to centimetres; fused ones (RTK against barometer) drift by a metre or
# two, slowly. A new take-off from the same spot resets it by what the pressure has changed, from another by more.
TAKE_OFF_STEP_M = 3.0
# A step must hold for these many photographs on either side; one bad height is no take-off.
_STEP_PHOTOGRAPHS = 3


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """One photograph: the body that took it, when, the maker's own flight id (or empty), and the take-off's height.

    ``take_off_height_m`` is AbsoluteAltitude - RelativeAltitude, NaN where either is missing.
    """

    photo_id: str
    body: str
    taken_at: datetime | None
    flight_id: str = ""
    take_off_height_m: float = math.nan


def assign_flights(shots: Sequence[Exposure]) -> list[int]:
    """The flight of each photograph, numbered from 1 in the order of their first photographs.

    Photographs without a time cannot be put in order: those of one body are one flight.
    """
    groups: list[list[int]] = []
    for body in sorted({(shot.body, shot.flight_id) for shot in shots}):
        members = [i for i, shot in enumerate(shots) if (shot.body, shot.flight_id) == body]
        timed = sorted((i for i in members if shots[i].taken_at is not None), key=lambda i: _get_sort_key(shots[i]))
        groups += _split_at_gaps(timed, shots)
        untimed = [i for i in members if shots[i].taken_at is None]
        groups += [untimed] if untimed else []
    groups.sort(key=lambda group: min(_get_sort_key(shots[i]) for i in group))
    flights = [0] * len(shots)
    for number, group in enumerate(groups, start=1):
        for i in group:
            flights[i] = number
    return flights


def _get_sort_key(shot: Exposure) -> tuple[float, str]:
    return (shot.taken_at.timestamp() if shot.taken_at else math.inf, shot.photo_id)


def _split_at_gaps(timed: list[int], shots: Sequence[Exposure]) -> list[list[int]]:
    """One body's photographs in time order, cut at gaps and at new take-offs."""
    groups: list[list[int]] = []
    heights = [shots[i].take_off_height_m for i in timed]
    for k, i in enumerate(timed):
        gap_s = _get_sort_key(shots[i])[0] - _get_sort_key(shots[timed[k - 1]])[0] if k else math.inf
        if gap_s > LONGEST_GAP_S or _is_new_take_off(heights, k):
            groups.append([])
        groups[-1].append(i)
    return groups


def _is_new_take_off(heights: list[float], k: int) -> bool:
    before = [height for height in heights[max(0, k - _STEP_PHOTOGRAPHS) : k] if math.isfinite(height)]
    after = [height for height in heights[k : k + _STEP_PHOTOGRAPHS] if math.isfinite(height)]
    if len(before) < 2 or len(after) < 2:
        return False
    # The step is between these two photographs, and the medians hold it.
    here = abs(heights[k] - heights[k - 1]) > TAKE_OFF_STEP_M
    return here and abs(median(after) - median(before)) > TAKE_OFF_STEP_M
