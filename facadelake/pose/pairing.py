"""Which photographs are compared: by position prior and viewing direction, so that large sets stay affordable."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from facadelake.frames import Array
from facadelake.pose.settings import ReconstructionSettings

# Photographs whose optical axes differ by more than this hardly show the same side of anything.
WIDEST_ANGLE_DEG = 110.0
# Neighbours in the order of taking are always tried: a position prior may be wrong.
SEQUENCE = 2


def viewing_directions(yaw_deg: Array, pitch_deg: Array) -> Array:
    """Unit vectors (n, 3) in site of yaw (clockwise from north) and pitch (above the horizon); NaN if unknown."""
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    return np.column_stack([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])


def choose_pairs(
    xyz_m: Array, direction: Array, close_range: NDArray[np.bool_], settings: ReconstructionSettings
) -> list[tuple[int, int]]:
    """Pairs (i < j) of photographs to compare, sorted.

    ``xyz_m`` (n, 3): position priors, NaN where there is none; ``direction`` (n, 3): viewing directions, NaN where
    unknown; ``close_range`` (n,): the role. Photographs are in the order of taking. A photograph without a position is
    compared with every other one, for nothing says where it belongs.
    """
    n = len(xyz_m)
    if n <= settings.exhaustive_up_to:
        return list(combinations(range(n), 2))
    placed: NDArray[np.bool_] = ~np.isnan(xyz_m[:, :2].sum(axis=1))
    pairs = {(i, j) for i in range(n) for j in range(i + 1, min(n, i + 1 + SEQUENCE))}
    for i in range(n):
        if not placed[i]:
            pairs |= {(min(i, j), max(i, j)) for j in range(n) if j != i}
            continue
        cost = _cost(i, xyz_m, direction)
        cost[~placed] = np.inf
        # Close-range photographs crowd together; without some of the other role they would never join the block.
        other = np.where(close_range != close_range[i], cost, np.inf)
        nearest = [*_smallest(cost, settings.neighbours), *_smallest(other, settings.neighbours // 2)]
        pairs |= {(min(i, j), max(i, j)) for j in nearest}
    return sorted(pairs)


def _smallest(cost: Array, count: int) -> list[int]:
    return [int(j) for j in np.argsort(cost, kind="stable")[:count] if np.isfinite(cost[j])]


def _cost(i: int, xyz_m: Array, direction: Array) -> Array:
    """Distance (m) to each photograph, stretched by the angle between the views; inf where they cannot overlap."""
    offset = xyz_m - xyz_m[i]
    distance = np.sqrt(np.nansum(offset**2, axis=1))
    cosine = direction @ direction[i]
    known = np.isfinite(cosine)
    cost: Array = np.where(known, distance * (2.0 - np.where(known, cosine, 1.0)), distance)
    cost[known & (cosine < np.cos(np.radians(WIDEST_ANGLE_DEG)))] = np.inf
    cost[i] = np.inf
    return cost
