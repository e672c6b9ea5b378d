"""Which photographs are compared: by position, viewing direction and order, so that large sets stay affordable."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.sfm.settings import ReconstructionSettings

# Photographs whose optical axes differ by more than this hardly show the same side of anything.
MAX_VIEW_ANGLE_DEG = 110.0
# Neighbours in the order of taking are always tried: a position prior may be wrong; more of them where there is none.
SEQUENCE_NEIGHBOURS = 2
SEQUENCE_NEIGHBOURS_NO_POSITION = 5
# How far ahead the facade may be: from a close-range photograph's two metres to a wide view's thirty.
_DEPTHS_M = np.array([2.0, 4.0, 8.0, 16.0, 32.0])
# Half the diagonal view of a common drone camera, for photographs that do not tell their focal length.
_HALF_VIEW_DEG = 38.0
# A hovering drone may take two photographs at one place; three positions alike to the millimetre were cut off.
_MIN_IDENTICAL_POSITIONS = 3
_IDENTICAL_POSITION_M = 0.001


def direction_from_yaw_pitch(yaw_deg: Float64Array, pitch_deg: Float64Array) -> Float64Array:
    """Unit vectors (n, 3) in site of yaw (clockwise from north) and pitch (above the horizon); NaN if unknown."""
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    return np.column_stack([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])


def choose_pairs(
    xyz_m: Float64Array,
    direction: Float64Array,
    close_range: BoolArray,
    settings: ReconstructionSettings,
    *,
    half_view_deg: Float64Array | None = None,
) -> list[tuple[int, int]]:
    """Pairs (i < j) of photographs to compare, sorted; their number grows with that of the photographs, not its square.

    ``xyz_m`` (n, 3): position priors, NaN where there is none; ``direction`` (n, 3): viewing directions, NaN where
    unknown; ``close_range`` (n,): the role; ``half_view_deg`` (n,): half the diagonal angle of view, NaN where unknown.
    Photographs are in the order of taking. Those that ``find_uncertain_positions`` names want partners by their looks besides.
    """
    n = len(xyz_m)
    if n <= settings.exhaustive_up_to:
        return list(combinations(range(n), 2))
    half_view = np.full(n, _HALF_VIEW_DEG) if half_view_deg is None else half_view_deg
    half_view = np.where(np.isfinite(half_view), half_view, _HALF_VIEW_DEG)
    placed = _has_position(xyz_m)
    pairs: set[tuple[int, int]] = set()
    for i in range(n):
        reach = SEQUENCE_NEIGHBOURS if placed[i] else SEQUENCE_NEIGHBOURS_NO_POSITION
        pairs |= _pair_with(i, (j for j in range(i - reach, i + reach + 1) if j != i and 0 <= j < n))
        if not placed[i]:
            continue
        cost = _compute_cost(i, xyz_m, direction)
        cost[~placed] = np.inf
        pairs |= _pair_with(i, _select_smallest(cost, settings.neighbours))
        # Close-range photographs crowd together; they join the block by others of which the view holds the same place.
        shared = _estimate_shared_view(i, xyz_m, direction, half_view)
        other = np.where(close_range != close_range[i], cost / np.maximum(shared, 0.05), np.inf)
        pairs |= _pair_with(i, _select_smallest(other, settings.neighbours // 2))
    return sorted(pairs)


def find_uncertain_positions(xyz_m: Float64Array, sigma_m: Float64Array, settings: ReconstructionSettings) -> BoolArray:
    """Which photographs (n,) their position does not tell from others: partners must be sought by their looks.

    No position; one whose horizontal sigma (``sigma_m`` (n, 3)) is more than half the distance within which its
    neighbours by position lie, so that true neighbours may lie beyond; or one that several photographs state alike.
    None where every pair is compared anyway.
    """
    n = len(xyz_m)
    if n <= settings.exhaustive_up_to:
        return np.zeros(n, dtype=bool)
    placed = _has_position(xyz_m)
    poor = np.array(~placed)
    for i in np.flatnonzero(placed):
        distance = np.linalg.norm(xyz_m[:, :2] - xyz_m[i, :2], axis=1)
        within = np.sort(distance[placed])[: settings.neighbours + 1][-1]
        alike = np.count_nonzero(np.linalg.norm(xyz_m - xyz_m[i], axis=1) < _IDENTICAL_POSITION_M)
        poor[i] = bool(2 * np.nanmax(sigma_m[i, :2], initial=0.0) > within) or alike >= _MIN_IDENTICAL_POSITIONS
    return poor


def _has_position(xyz_m: Float64Array) -> BoolArray:
    return np.asarray(np.isfinite(xyz_m).all(axis=1))


def _pair_with(i: int, others: Iterable[int]) -> set[tuple[int, int]]:
    return {(min(i, j), max(i, j)) for j in others}


def _select_smallest(cost: Float64Array, count: int) -> list[int]:
    return [int(j) for j in np.argsort(cost, kind="stable")[:count] if np.isfinite(cost[j])]


def _compute_cost(i: int, xyz_m: Float64Array, direction: Float64Array) -> Float64Array:
    """Distance (m) to each photograph, stretched by the angle between the views; inf where they cannot overlap."""
    distance = np.linalg.norm(xyz_m - xyz_m[i], axis=1)
    cosine = direction @ direction[i]
    known = np.isfinite(cosine)
    cost: Float64Array = np.where(known, distance * (2.0 - np.where(known, cosine, 1.0)), distance)
    cost[known & (cosine < np.cos(np.radians(MAX_VIEW_ANGLE_DEG)))] = np.inf
    cost[i] = np.inf
    return cost


def _estimate_shared_view(
    i: int, xyz_m: Float64Array, direction: Float64Array, half_view_deg: Float64Array
) -> Float64Array:
    """Share (n,) of the depths at which what lies ahead of one photograph is in the other's view; 0.5 if unknown.

    Of the two ways the better: a wide view holds what a close one looks at, not the reverse.
    """
    seen = np.cos(np.radians(half_view_deg))
    ahead_of_i = xyz_m[i] + _DEPTHS_M[:, None] * direction[i]
    to_i = ahead_of_i[None, :, :] - xyz_m[:, None, :]  # (n, depths, 3), from each other photograph
    by_others = np.einsum("ndk,nk->nd", to_i, direction) > seen[:, None] * np.linalg.norm(to_i, axis=2)
    to_others = _DEPTHS_M[None, :, None] * direction[:, None, :] + (xyz_m - xyz_m[i])[:, None, :]
    by_i = to_others @ direction[i] > seen[i] * np.linalg.norm(to_others, axis=2)
    share: Float64Array = np.maximum(by_others.mean(axis=1), by_i.mean(axis=1))
    share[~np.isfinite(direction @ direction[i])] = 0.5
    return share
