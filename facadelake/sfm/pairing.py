"""Pairs of photographs to match, by position, viewing direction and order: their number grows linearly with the set."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64N, Float64Nx3
from facadelake.sfm.settings import ReconstructionSettings

# Photographs whose optical axes differ by more than this hardly show the same surface.
MAX_VIEW_ANGLE_DEG = 110.0
# Neighbours in the order of taking are always matched: a position prior may be wrong. More where there is none.
SEQUENCE_NEIGHBOURS = 2
SEQUENCE_NEIGHBOURS_NO_POSITION = 5
# Possible distances of the facade: from 2 m of a close-range photograph to 32 m of a wide view.
_DEPTHS_M = np.array([2.0, 4.0, 8.0, 16.0, 32.0])
# Half the diagonal view of a common drone camera, for photographs without a focal length.
_HALF_VIEW_DEG = 38.0
# A hovering drone may take two photographs at one place; three positions equal to the millimetre were truncated.
_MIN_IDENTICAL_POSITIONS = 3
_IDENTICAL_POSITION_M = 0.001


def direction_from_yaw_pitch(yaw_deg: Float64N, pitch_deg: Float64N) -> Float64Nx3:
    """Viewing directions (n, 3), unit vectors in site; NaN where yaw or pitch is.

    Yaw is clockwise from north, pitch above the horizon.
    """
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    return np.column_stack([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])


def choose_pairs(
    xyz_m: Float64Nx3,
    direction: Float64Nx3,
    close_range: BoolArray,
    settings: ReconstructionSettings,
    *,
    half_view_deg: Float64N | None = None,
) -> list[tuple[int, int]]:
    """Pairs (i < j) of photographs to match, sorted; their number grows with that of the photographs, not its square.

    Photographs that ``find_uncertain_positions`` selects need partners by appearance in addition.

    Args:
        xyz_m: position priors (n, 3) in site, in the order of taking; NaN where there is none.
        direction: viewing directions (n, 3), unit vectors in site; NaN where unknown.
        close_range: whether each photograph (n,) has the role closerange.
        settings: how many partners each photograph gets.
        half_view_deg: half the diagonal angle of view (n,); None or NaN where unknown.

    Returns:
        Every pair up to ``settings.exhaustive_up_to`` photographs; above it each photograph with its predecessors and
        successors, its nearest neighbours, and the nearest of the other role that see the same place.
    """
    n = len(xyz_m)
    if n <= settings.exhaustive_up_to:
        return list(combinations(range(n), 2))
    half_view = np.full(n, _HALF_VIEW_DEG) if half_view_deg is None else half_view_deg
    half_view = np.where(np.isfinite(half_view), half_view, _HALF_VIEW_DEG)
    has_position = _has_position(xyz_m)
    pairs: set[tuple[int, int]] = set()
    for i in range(n):
        span = SEQUENCE_NEIGHBOURS if has_position[i] else SEQUENCE_NEIGHBOURS_NO_POSITION
        pairs |= _pair_with(i, (j for j in range(i - span, i + span + 1) if j != i and 0 <= j < n))
        if not has_position[i]:
            continue
        cost = _compute_cost(i, xyz_m, direction)
        cost[~has_position] = np.inf
        pairs |= _pair_with(i, _select_smallest(cost, settings.neighbours))
        # Close-range photographs are close together; those of the other role that see the same place connect them.
        shared = _estimate_shared_view(i, xyz_m, direction, half_view)
        cost_other_role = np.where(close_range != close_range[i], cost / np.maximum(shared, 0.05), np.inf)
        pairs |= _pair_with(i, _select_smallest(cost_other_role, settings.neighbours // 2))
    return sorted(pairs)


def find_uncertain_positions(xyz_m: Float64Nx3, sigma_m: Float64Nx3, settings: ReconstructionSettings) -> BoolArray:
    """Photographs (n,) whose position does not identify their neighbours: they need partners by appearance.

    These have no position; or a horizontal sigma of more than half the distance within which their neighbours by
    position lie, so that true neighbours may lie beyond; or a position that several photographs share. None where every
    pair is matched anyway.

    Args:
        xyz_m: position priors (n, 3) in site; NaN where there is none.
        sigma_m: their sigmas (n, 3) in east, north and up.
        settings: how many neighbours each photograph gets.
    """
    n = len(xyz_m)
    if n <= settings.exhaustive_up_to:
        return np.zeros(n, dtype=bool)
    has_position = _has_position(xyz_m)
    uncertain = np.array(~has_position)
    for i in np.flatnonzero(has_position):
        distance = np.linalg.norm(xyz_m[:, :2] - xyz_m[i, :2], axis=1)
        neighbour_radius = np.sort(distance[has_position])[: settings.neighbours + 1][-1]
        identical = np.count_nonzero(np.linalg.norm(xyz_m - xyz_m[i], axis=1) < _IDENTICAL_POSITION_M)
        uncertain[i] = (
            bool(2 * np.nanmax(sigma_m[i, :2], initial=0.0) > neighbour_radius) or identical >= _MIN_IDENTICAL_POSITIONS
        )
    return uncertain


def _has_position(xyz_m: Float64Nx3) -> BoolArray:
    """Whether each photograph (n,) has a position prior."""
    return np.asarray(np.isfinite(xyz_m).all(axis=1))


def _pair_with(i: int, others: Iterable[int]) -> set[tuple[int, int]]:
    """Ordered pairs of photograph ``i`` with the others."""
    return {(min(i, j), max(i, j)) for j in others}


def _select_smallest(cost: Float64N, count: int) -> list[int]:
    """Indices of the ``count`` smallest finite costs."""
    return [int(j) for j in np.argsort(cost, kind="stable")[:count] if np.isfinite(cost[j])]


def _compute_cost(i: int, xyz_m: Float64Nx3, direction: Float64Nx3) -> Float64N:
    """Distance (m) to each photograph, increased by the angle between the views; inf where they cannot overlap."""
    distance = np.linalg.norm(xyz_m - xyz_m[i], axis=1)
    cosine = direction @ direction[i]
    known = np.isfinite(cosine)
    cost: Float64N = np.where(known, distance * (2.0 - np.where(known, cosine, 1.0)), distance)
    cost[known & (cosine < np.cos(np.radians(MAX_VIEW_ANGLE_DEG)))] = np.inf
    cost[i] = np.inf
    return cost


def _estimate_shared_view(i: int, xyz_m: Float64Nx3, direction: Float64Nx3, half_view_deg: Float64N) -> Float64N:
    """Share (n,) of the depths ahead of one photograph at which the other sees the same point; 0.5 if unknown.

    The larger of the two directions counts: a wide view contains what a close one shows, not the reverse.
    """
    cosine_half_view = np.cos(np.radians(half_view_deg))
    ahead_of_i = xyz_m[i] + _DEPTHS_M[:, None] * direction[i]
    to_i = ahead_of_i[None, :, :] - xyz_m[:, None, :]  # (n, depths, 3), from each other photograph
    seen_by_others = np.einsum("ndk,nk->nd", to_i, direction) > cosine_half_view[:, None] * np.linalg.norm(to_i, axis=2)
    to_others = _DEPTHS_M[None, :, None] * direction[:, None, :] + (xyz_m - xyz_m[i])[:, None, :]
    seen_by_i = to_others @ direction[i] > cosine_half_view[i] * np.linalg.norm(to_others, axis=2)
    share: Float64N = np.maximum(seen_by_others.mean(axis=1), seen_by_i.mean(axis=1))
    share[~np.isfinite(direction @ direction[i])] = 0.5
    return share
