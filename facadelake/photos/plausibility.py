"""Check the position priors of a campaign against one another and against the building."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx2, Int64Array
from facadelake.core.proj.operations import METRES_PER_DEGREE
from facadelake.photos.coordinate_mistakes import list_corrections
from facadelake.photos.position_prior import PositionPrior
from facadelake.photos.position_sigma import PositionSigma
from schemas.vocabulary import PositionSource

# Photographs are never farther than this from the building, or from the other photographs.
FAR_M = 5000.0
# Beyond the speed of drones between two photographs, horizontally and vertically; GNSS noise is added.
MAX_HORIZONTAL_M_S, MAX_VERTICAL_M_S = 30.0, 15.0
# Typical speed of a camera during an inspection.
TYPICAL_M_S = 3.0
# Times of EXIF are whole seconds.
_CLOCK_STEP_S = 1.0
_NOISE_SIGMAS = 3.0
# This many photographs at different seconds with identical coordinates mean a frozen receiver or truncated digits.
_FROZEN_PHOTOGRAPHS = 3
# The Dead Sea's shore is at -430 m; drones climb to 6000 m above sea level.
MIN_HEIGHT_M, MAX_HEIGHT_M = -500.0, 9000.0
# Number of earlier photographs that may precede one in a chain: more consecutive outliers than this are not removed.
_MAX_OUTLIERS_IN_SEQUENCE = 50


@dataclass(frozen=True, kw_only=True)
class TimedPrior:
    """The position prior of a photograph with its flight and time (s since 1970; NaN where unknown)."""

    prior: PositionPrior
    flight: int
    time_s: float


def _discard(prior: PositionPrior, reason: str) -> PositionPrior:
    """The prior without a position; the reason is also a warning."""
    return PositionPrior(source=PositionSource.NONE, reason=reason, warnings=(*prior.warnings, reason))


def _add_warning(prior: PositionPrior, warning: str) -> PositionPrior:
    return replace(prior, warnings=(*prior.warnings, warning))


def check_priors(
    timed: Sequence[TimedPrior], distance_to_model_m: Callable[[Float64Nx2], Float64N] | None = None
) -> list[PositionPrior]:
    """The priors after all checks: unchanged, with a warning and larger sigma, or NONE with the reason.

    ``distance_to_model_m`` returns the horizontal distance (n,) in metres of positions (n, 2: lon_deg, lat_deg) to the
    building; None where it is unknown.
    """
    priors = [_check_height_range(one.prior) for one in timed]
    priors = _check_distances(priors, distance_to_model_m)
    times_s = np.array([one.time_s for one in timed])
    for flight in sorted({one.flight for one in timed}):
        members = [i for i, one in enumerate(timed) if one.flight == flight and math.isfinite(one.time_s)]
        members.sort(key=lambda i: timed[i].time_s)
        _discard_jumps(priors, members, times_s)
        _widen_frozen_runs(priors, members, times_s)
    return priors


def _has_position(prior: PositionPrior) -> bool:
    return prior.source is not PositionSource.NONE


def _check_height_range(prior: PositionPrior) -> PositionPrior:
    if math.isnan(prior.height_m) or MIN_HEIGHT_M <= prior.height_m <= MAX_HEIGHT_M:
        return prior
    warning = f"height {prior.height_m:.0f} m is out of range ({MIN_HEIGHT_M:.0f} to {MAX_HEIGHT_M:.0f} m); not used"
    return replace(_add_warning(prior, warning), height_m=math.nan)


def east_north_from_lon_lat(lon_lat_deg: Float64Array, reference: Float64Array) -> Float64Array:
    """East and north (n, 2) in metres of positions near ``reference`` (lon, lat), by a spherical approximation."""
    east = (lon_lat_deg[:, 0] - reference[0] + 180) % 360 - 180
    out: Float64Array = METRES_PER_DEGREE * np.column_stack(
        [east * math.cos(math.radians(reference[1])), lon_lat_deg[:, 1] - reference[1]]
    )
    return out


def _check_distances(
    priors: list[PositionPrior], distance_to_model_m: Callable[[Float64Nx2], Float64N] | None
) -> list[PositionPrior]:
    """Discard positions far from the building or, without a building, from most of the other photographs."""
    index = [i for i, prior in enumerate(priors) if _has_position(prior)]
    if not index:
        return priors
    places = np.array([_get_lon_lat(priors[i]) for i in index])
    centre = np.median(places, axis=0)

    def distance_to_centre(lon_lat_deg: Float64Nx2) -> Float64N:
        distance: Float64N = np.hypot(*east_north_from_lon_lat(lon_lat_deg, centre).T)
        return distance

    distance = distance_to_model_m or distance_to_centre
    reference = "the building" if distance_to_model_m else "the other photographs"
    metres = distance(places)
    far = metres > FAR_M
    if not far.any() or (distance_to_model_m is None and len(index) < 3):
        return priors
    out = list(priors)
    most_are_far = far.mean() > 0.5
    for k in np.flatnonzero(far):
        suggestion = _suggest_correction(places[k], distance)
        message = f"the position is {metres[k] / 1000:.0f} km from {reference}{suggestion}"
        prior = priors[index[k]]
        # A minority is discarded. Where most are far, the model's georeference may be wrong: the pose stage decides.
        out[index[k]] = _add_warning(prior, message) if most_are_far else _discard(prior, message)
    return out


def _suggest_correction(place: Float64Array, distance: Callable[[Float64Nx2], Float64N]) -> str:
    """The error of writing that explains a position: the one whose correction brings it near; empty where none does."""
    possible = list_corrections((float(place[0]), float(place[1])))
    metres = distance(np.array(list(possible.values())))
    best = int(np.argmin(metres))
    if metres[best] > FAR_M:
        return ""
    return f"; with {list(possible)[best]} it would be {metres[best]:.0f} m away: correct the metadata"


def _discard_jumps(priors: list[PositionPrior], members: list[int], times_s: Float64Array) -> None:
    """Discard positions and heights that cannot be reached at the speed of a drone from those before and after."""
    members = [i for i in members if _has_position(priors[i])]
    if len(members) < 3:
        return
    times = times_s[members]
    places = np.array([_get_lon_lat(priors[i]) for i in members])
    sigma_m = np.array([[priors[i].sigma.horizontal_m, priors[i].sigma.vertical_m] for i in members])
    metres = east_north_from_lon_lat(places, np.median(places, axis=0))
    for i in _find_off_chain(metres, times, _NOISE_SIGMAS * sigma_m[:, 0], MAX_HORIZONTAL_M_S):
        k = _choose_neighbour(i, len(members))
        apart, seconds = float(np.hypot(*(metres[i] - metres[k]))), abs(times[i] - times[k])
        when = f"{seconds:.0f} s {'before' if k < i else 'later'}"
        reason = (
            f"the position is {apart:.0f} m from that of the photograph {when}, "
            f"faster than {MAX_HORIZONTAL_M_S:.0f} m/s; the positions before and after are consistent"
        )
        priors[members[i]] = _discard(priors[members[i]], reason)
    heights = np.array([[priors[i].height_m] for i in members])
    known = np.isfinite(heights[:, 0])
    numbers = np.flatnonzero(known)
    for j in _find_off_chain(heights[known], times[known], _NOISE_SIGMAS * sigma_m[known, 1], MAX_VERTICAL_M_S):
        i = members[numbers[j]]
        warning = f"height {priors[i].height_m:.1f} m is inconsistent with those before and after; not used"
        priors[i] = replace(_add_warning(priors[i], warning), height_m=math.nan)


def _choose_neighbour(i: int, count: int) -> int:
    return i - 1 if i > 0 else min(1, count - 1)


def _find_off_chain(
    points_m: Float64Array, times_s: Float64Array, noise_m: Float64Array, fastest_m_s: float
) -> Int64Array:
    """The points outside the longest chain in order of time in which each point can be reached from the one before.

    The longest chain does not depend on a start point, so that one outlier, even the first, is found alone. Where the
    chain holds no more than half of the points there is no majority, and no point is returned.

    Args:
        points_m: coordinates (n, k) in metres, in order of time.
        times_s: times (n,) in seconds, ascending.
        noise_m: noise (n,) of each point in metres.
        fastest_m_s: largest speed.

    Returns:
        Indices of the outliers.
    """
    count = len(points_m)
    length = np.ones(count, dtype=np.int64)
    previous = np.full(count, -1, dtype=np.int64)
    for i in range(1, count):
        candidates = np.arange(max(0, i - _MAX_OUTLIERS_IN_SEQUENCE), i)
        apart = np.linalg.norm(points_m[candidates] - points_m[i], axis=1)
        elapsed_s = times_s[i] - times_s[candidates] + _CLOCK_STEP_S
        within = fastest_m_s * elapsed_s + np.hypot(noise_m[candidates], noise_m[i])
        reachable = candidates[apart <= within]
        if len(reachable):
            previous[i] = reachable[len(reachable) - 1 - int(np.argmax(length[reachable][::-1]))]
            length[i] = length[previous[i]] + 1
    on_chain = np.zeros(count, dtype=np.bool_)
    i = int(np.argmax(length)) if count else -1
    while i >= 0:
        on_chain[i] = True
        i = int(previous[i])
    if on_chain.sum() <= count / 2:
        return np.array([], dtype=np.int64)
    return np.flatnonzero(~on_chain)


def _widen_frozen_runs(priors: list[PositionPrior], members: list[int], times_s: Float64Array) -> None:
    """Runs of identical positions: sigma becomes the distance that was flown meanwhile."""
    members = [i for i in members if _has_position(priors[i])]
    runs = [list(run) for _, run in groupby(members, key=lambda i: _get_lon_lat(priors[i]))]
    for number, run in enumerate(runs):
        if len({times_s[i] for i in run}) < _FROZEN_PHOTOGRAPHS:
            continue
        if len({_get_lon_lat(prior) for prior in priors if _has_position(prior)}) == 1:
            reason = f"all {len(run)} photographs have the same position: it was not measured, or is truncated"
            for i in run:
                priors[i] = _discard(priors[i], reason)
            continue
        # The camera was between the positions before and after; without these, as far away as it can have moved.
        ends = [runs[k][0] for k in (number - 1, number + 1) if 0 <= k < len(runs)]
        places = np.array([_get_lon_lat(priors[i]) for i in [run[0], *ends]])
        reach_m = float(np.hypot(*east_north_from_lon_lat(places, places[0]).T).max())
        reach_m = reach_m or TYPICAL_M_S * float(times_s[run[-1]] - times_s[run[0]])
        frozen_height = len({priors[i].height_m for i in run}) == 1
        for i in run:
            sigma = priors[i].sigma
            vertical_m = max(sigma.vertical_m, reach_m) if frozen_height else sigma.vertical_m
            enlarged = PositionSigma(horizontal_m=max(sigma.horizontal_m, reach_m), vertical_m=vertical_m)
            priors[i] = replace(
                _add_warning(priors[i], f"{len(run)} consecutive photographs have the same position"), sigma=enlarged
            )


def _get_lon_lat(prior: PositionPrior) -> tuple[float, float]:
    return prior.lon_deg, prior.lat_deg
