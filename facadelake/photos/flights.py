"""Flights: photographs whose position priors share one GNSS offset.

GPS and barometer have errors of metres that are nearly constant for one camera body over some minutes; the adjustment
estimates one offset per flight. A flight ends where this is no longer valid: at another body, at a gap of more than ten
minutes (a landing; satellites and air pressure change), or at a new take-off, which resets RelativeAltitude, so that
AbsoluteAltitude - RelativeAltitude has a step. One flight too many costs little; one too few bends the block.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from statistics import median

LONGEST_GAP_S = 600.0
# With a barometer the height of the take-off is constant to centimetres; where RTK and barometer are combined it drifts
# slowly by a metre or two. A new take-off shifts it by the change of air pressure, at another place by more.
TAKE_OFF_STEP_M = 3.0
# A step must persist for this number of photographs on either side; a single outlier is no take-off.
_STEP_PHOTOGRAPHS = 3


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """Body, lens, time, flight id of the maker (or empty) and take-off height of one photograph.

    ``take_off_height_m`` is AbsoluteAltitude - RelativeAltitude, NaN where either is missing.
    """

    photo_id: str
    body: str
    taken_at: datetime | None
    lens: str = ""
    flight_id: str = ""
    take_off_height_m: float = math.nan


def assign_flights(exposures: Sequence[Exposure]) -> list[int]:
    """The flight number of each photograph, from 1 in the order of the flights' first photographs.

    Photographs without a time cannot be ordered: those of one body form one flight.
    """
    groups: list[list[int]] = []
    for body in sorted({(exposure.body, exposure.flight_id) for exposure in exposures}):
        members = [i for i, e in enumerate(exposures) if (e.body, e.flight_id) == body]
        timed = sorted(
            (i for i in members if exposures[i].taken_at is not None), key=lambda i: _get_sort_key(exposures[i])
        )
        groups += _split_at_gaps(timed, exposures)
        untimed = [i for i in members if exposures[i].taken_at is None]
        groups += [untimed] if untimed else []
    groups.sort(key=lambda group: min(_get_sort_key(exposures[i]) for i in group))
    flights = [0] * len(exposures)
    for number, group in enumerate(groups, start=1):
        for i in group:
            flights[i] = number
    return flights


def _get_sort_key(exposure: Exposure) -> tuple[float, str]:
    return (exposure.taken_at.timestamp() if exposure.taken_at else math.inf, exposure.photo_id)


def _split_at_gaps(timed: list[int], exposures: Sequence[Exposure]) -> list[list[int]]:
    """The photographs of one body in order of time, split at gaps and at new take-offs."""
    groups: list[list[int]] = []
    heights = _unify_lens_heights([exposures[i] for i in timed])
    for k, i in enumerate(timed):
        gap_s = _get_sort_key(exposures[i])[0] - _get_sort_key(exposures[timed[k - 1]])[0] if k else math.inf
        if gap_s > LONGEST_GAP_S or _is_new_take_off(heights, k):
            groups.append([])
        groups[-1].append(i)
    return groups


def _unify_lens_heights(exposures: Sequence[Exposure]) -> list[float]:
    """Take-off heights with the constant differences between the lenses of one body removed.

    Lenses that fire in turns may state different heights; each change of lens would look like a new take-off.
    """
    heights = [exposure.take_off_height_m for exposure in exposures]
    lenses = Counter(e.lens for e, height in zip(exposures, heights, strict=True) if math.isfinite(height))
    if len(lenses) < 2:
        return heights
    main = lenses.most_common(1)[0][0]
    rows_of_main = [k for k, e in enumerate(exposures) if e.lens == main and math.isfinite(heights[k])]
    for lens in lenses.keys() - {main}:
        rows = [k for k, e in enumerate(exposures) if e.lens == lens and math.isfinite(heights[k])]
        difference = median(heights[k] - heights[_find_nearest(rows_of_main, k)] for k in rows)
        for k in rows:
            heights[k] -= difference
    return heights


def _find_nearest(rows: list[int], k: int) -> int:
    """The element of the sorted ``rows`` nearest to ``k``."""
    place = bisect_left(rows, k)
    return min(rows[max(0, place - 1) : place + 1], key=lambda row: abs(row - k))


def _is_new_take_off(heights: list[float], k: int) -> bool:
    before = [height for height in heights[max(0, k - _STEP_PHOTOGRAPHS) : k] if math.isfinite(height)]
    after = [height for height in heights[k : k + _STEP_PHOTOGRAPHS] if math.isfinite(height)]
    if len(before) < 2 or len(after) < 2:
        return False
    # The step is between these two photographs, and the medians confirm it.
    is_step = abs(heights[k] - heights[k - 1]) > TAKE_OFF_STEP_M
    return is_step and abs(median(after) - median(before)) > TAKE_OFF_STEP_M
