"""Position priors looked at together: what one photograph cannot show to be wrong, its neighbours and the model can."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.photos.position_prior import METRES_PER_DEGREE, PositionPrior, PositionSigma
from schemas.vocabulary import PositionSource

# Further from the building, or from the other photographs, no photograph of it is taken.
FAR_M = 5000.0
# Faster than drones fly between two photographs, along the ground and up or down; GPS noise is allowed for besides.
FASTEST_ACROSS_M_S, FASTEST_UP_M_S = 30.0, 15.0
# How fast cameras move while a building is inspected.
USUAL_M_S = 3.0
# EXIF's clock counts whole seconds.
_CLOCK_STEP_S = 1.0
_NOISE_SIGMAS = 3.0
# This many shots at different seconds with one position, digit for digit, are a frozen receiver or cut-off digits.
_FROZEN_SHOTS = 3
# The Dead Sea's shore is at -430 m; drones climb to 6000 m above sea level.
LOWEST_M, HIGHEST_M = -500.0, 9000.0
# How far back a photograph may follow another in a chain: jumps of more than this many in a row are no jump.
_LONGEST_JUMP = 50


@dataclass(frozen=True, kw_only=True)
class TimedPrior:
    """A photograph's prior, the flight it is of, and when it was taken (s since 1970; NaN where unknown)."""

    prior: PositionPrior
    flight: int
    time_s: float


def _discard(prior: PositionPrior, reason: str) -> PositionPrior:
    return PositionPrior(source=PositionSource.NONE, reason=reason, warnings=(*prior.warnings, reason))


def _add_warning(prior: PositionPrior, warning: str) -> PositionPrior:
    return replace(prior, warnings=(*prior.warnings, warning))


def check_priors(
    located: Sequence[TimedPrior], distance_to_model_m: Callable[[Float64Array], Float64Array] | None = None
) -> list[PositionPrior]:
    """The priors after all checks: kept, warned about and widened, or NONE with the reason.

    ``distance_to_model_m`` gives the horizontal distance (n,) of places (n, 2: lon_deg, lat_deg) to the building.
    """
    priors = [_check_height_range(one.prior) for one in located]
    priors = _check_distances(priors, distance_to_model_m)
    times_s = np.array([one.time_s for one in located])
    for flight in sorted({one.flight for one in located}):
        members = [i for i, one in enumerate(located) if one.flight == flight and math.isfinite(one.time_s)]
        members.sort(key=lambda i: located[i].time_s)
        _mark_jumps(priors, members, times_s)
        _mark_frozen(priors, members, times_s)
    return priors


def _has_position(prior: PositionPrior) -> bool:
    return prior.source is not PositionSource.NONE


def _check_height_range(prior: PositionPrior) -> PositionPrior:
    if math.isnan(prior.height_m) or LOWEST_M <= prior.height_m <= HIGHEST_M:
        return prior
    warning = (
        f"height {prior.height_m:.0f} m is no height of a photograph ({LOWEST_M:.0f} to {HIGHEST_M:.0f} m); left out"
    )
    return replace(_add_warning(prior, warning), height_m=math.nan)


def _east_north_from_lon_lat(lon_lat_deg: Float64Array, reference: Float64Array) -> Float64Array:
    """East and north (n, 2) of places near ``reference`` (lon, lat): rough, and enough to tell near from far."""
    east = (lon_lat_deg[:, 0] - reference[0] + 180) % 360 - 180
    out: Float64Array = METRES_PER_DEGREE * np.column_stack(
        [east * math.cos(math.radians(reference[1])), lon_lat_deg[:, 1] - reference[1]]
    )
    return out


def _check_distances(
    priors: list[PositionPrior], distance_to_model_m: Callable[[Float64Array], Float64Array] | None
) -> list[PositionPrior]:
    """What lies far from the building (or, where that is unknown, from most photographs) is a mistake of writing."""
    index = [i for i, prior in enumerate(priors) if _has_position(prior)]
    if not index:
        return priors
    places = np.array([_get_lon_lat(priors[i]) for i in index])
    middle = np.median(places, axis=0)

    def from_middle(lon_lat_deg: Float64Array) -> Float64Array:
        distance: Float64Array = np.hypot(*_east_north_from_lon_lat(lon_lat_deg, middle).T)
        return distance

    distance = distance_to_model_m or from_middle
    what = "the building" if distance_to_model_m else "the other photographs"
    metres = distance(places)
    far = metres > FAR_M
    if not far.any() or (distance_to_model_m is None and len(index) < 3):
        return priors
    out = list(priors)
    most_are_far = far.mean() > 0.5
    for k in np.flatnonzero(far):
        said = f"the position lies {metres[k] / 1000:.0f} km from {what}{_suggest_correction(places[k], distance)}"
        prior = priors[index[k]]
        # A few among many are dropped; if most are so, the mistake may be the model's place: the pose stage decides.
        out[index[k]] = _add_warning(prior, said) if most_are_far else _discard(prior, said)
    return out


def _suggest_correction(place: Float64Array, distance: Callable[[Float64Array], Float64Array]) -> str:
    """Which slip of writing explains the place: the one that brings it near."""
    lon, lat = place
    slips = {
        "latitude and longitude swapped back": (lat, lon),
        "the longitude's sign (E/W) changed": (-lon, lat),
        "the latitude's sign (N/S) changed": (lon, -lat),
        "both signs changed": (-lon, -lat),
        "latitude and longitude swapped back and the longitude's sign changed": (-lat, lon),
    }
    possible = {name: there for name, there in slips.items() if abs(there[1]) <= 90}
    metres = distance(np.array(list(possible.values())))
    best = int(np.argmin(metres))
    if metres[best] > FAR_M:
        return ""
    return f"; with {list(possible)[best]} it would lie {metres[best]:.0f} m from there: correct the metadata"


def _mark_jumps(priors: list[PositionPrior], members: list[int], times_s: Float64Array) -> None:
    """Photographs whose place or height no drone could have come from and gone to in the time there was."""
    members = [i for i in members if _has_position(priors[i])]
    if len(members) < 3:
        return
    times = times_s[members]
    places = np.array([_get_lon_lat(priors[i]) for i in members])
    sigma_m = np.array([[priors[i].sigma.horizontal_m, priors[i].sigma.vertical_m] for i in members])
    metres = _east_north_from_lon_lat(places, np.median(places, axis=0))
    for i in _find_off_chain(metres, times, _NOISE_SIGMAS * sigma_m[:, 0], FASTEST_ACROSS_M_S):
        k = _choose_neighbour(i, len(members))
        apart, seconds = float(np.hypot(*(metres[i] - metres[k]))), abs(times[i] - times[k])
        when = f"{seconds:.0f} s {'before' if k < i else 'later'}"
        reason = (
            f"the position lies {apart:.0f} m from that of the photograph {when}, "
            f"faster than {FASTEST_ACROSS_M_S:.0f} m/s; its neighbours agree without it"
        )
        priors[members[i]] = _discard(priors[members[i]], reason)
    heights = np.array([[priors[i].height_m] for i in members])
    known = np.isfinite(heights[:, 0])
    numbers = np.flatnonzero(known)
    for j in _find_off_chain(heights[known], times[known], _NOISE_SIGMAS * sigma_m[known, 1], FASTEST_UP_M_S):
        i = members[numbers[j]]
        warning = f"height {priors[i].height_m:.1f} m does not go with its neighbours' in time; left out"
        priors[i] = replace(_add_warning(priors[i], warning), height_m=math.nan)


def _choose_neighbour(i: int, count: int) -> int:
    return i - 1 if i > 0 else min(1, count - 1)


def _find_off_chain(
    points_m: Float64Array, times_s: Float64Array, noise_m: Float64Array, fastest_m_s: float
) -> Int64Array:
    """Those outside the longest chain in time order whose neighbours could all be reached from one another.

    The longest chain does not depend on a start, so that one bad point (even the first) condemns itself alone. Where
    the chain holds no more than half of the points there is no majority to judge by, and none is marked.
    """
    count = len(points_m)
    length = np.ones(count, dtype=np.int64)
    came_from = np.full(count, -1, dtype=np.int64)
    for i in range(1, count):
        back = np.arange(max(0, i - _LONGEST_JUMP), i)
        apart = np.linalg.norm(points_m[back] - points_m[i], axis=1)
        within = fastest_m_s * (times_s[i] - times_s[back] + _CLOCK_STEP_S) + np.hypot(noise_m[back], noise_m[i])
        reached = back[apart <= within]
        if len(reached):
            came_from[i] = reached[len(reached) - 1 - int(np.argmax(length[reached][::-1]))]
            length[i] = length[came_from[i]] + 1
    on_chain = np.zeros(count, dtype=np.bool_)
    i = int(np.argmax(length)) if count else -1
    while i >= 0:
        on_chain[i] = True
        i = int(came_from[i])
    if on_chain.sum() <= count / 2:
        return np.array([], dtype=np.int64)
    return np.flatnonzero(~on_chain)


def _mark_frozen(priors: list[PositionPrior], members: list[int], times_s: Float64Array) -> None:
    """Runs of one and the same position: as uncertain as the way that was flown meanwhile."""
    members = [i for i in members if _has_position(priors[i])]
    runs = [list(run) for _, run in groupby(members, key=lambda i: _get_lon_lat(priors[i]))]
    for number, run in enumerate(runs):
        if len({times_s[i] for i in run}) < _FROZEN_SHOTS:
            continue
        if len({_get_lon_lat(prior) for prior in priors if _has_position(prior)}) == 1:
            reason = f"all {len(run)} photographs have the same position: no receiver's, or cut-off digits"
            for i in run:
                priors[i] = _discard(priors[i], reason)
            continue
        # The camera was somewhere between the places before and after; where there are none, as far as it could get.
        ends = [runs[k][0] for k in (number - 1, number + 1) if 0 <= k < len(runs)]
        places = np.array([_get_lon_lat(priors[i]) for i in [run[0], *ends]])
        reach_m = float(np.hypot(*_east_north_from_lon_lat(places, places[0]).T).max())
        reach_m = reach_m or USUAL_M_S * float(times_s[run[-1]] - times_s[run[0]])
        frozen_height = len({priors[i].height_m for i in run}) == 1
        for i in run:
            sigma = priors[i].sigma
            up_m = max(sigma.vertical_m, reach_m) if frozen_height else sigma.vertical_m
            wide = PositionSigma(horizontal_m=max(sigma.horizontal_m, reach_m), vertical_m=up_m)
            priors[i] = replace(
                _add_warning(priors[i], f"{len(run)} photographs in a row have this very position"), sigma=wide
            )


def _get_lon_lat(prior: PositionPrior) -> tuple[float, float]:
    return prior.lon_deg, prior.lat_deg
