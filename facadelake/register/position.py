"""Where a defect is: its sightings' rays, with the model's surface as what is known beforehand."""

from __future__ import annotations

import numpy as np

from facadelake.frames import Array

_ROUNDS = 12
_HUBER = 1.5  # residuals beyond this many sigmas (or median spreads) stop pulling harder


def robust_mean(xyz_site_m: Array, weights: Array) -> Array:
    """Weighted mean (3,) of points (n, 3) whose outliers pull no more than a bounded amount (Huber's weights)."""
    mean: Array = np.average(xyz_site_m, axis=0, weights=weights)
    if len(xyz_site_m) < 3:
        return mean  # of one or two points nobody can say which is the outlier
    for _ in range(_ROUNDS):
        gaps = np.linalg.norm(xyz_site_m - mean, axis=1)
        spread = max(float(np.median(gaps)), 1e-4)
        pull = np.minimum(1.0, _HUBER * spread / np.maximum(gaps, 1e-12))
        mean = np.average(xyz_site_m, axis=0, weights=weights * pull)
    return mean


def position_of(
    xyz_site_m: Array, ray_site: Array, sigma_m: Array, weights: Array, normal_site: Array, relief_m: float
) -> Array:
    """The place (3,) nearest to all rays, where the surface holds it to ``relief_m`` along its normal.

    Rays run through the hits ``xyz_site_m`` (n, 3) along unit ``ray_site`` (n, 3), each good to ``sigma_m`` (n,)
    across. The surface is the plane of ``normal_site`` (3,) through the robust mean of the hits by ``weights`` (n,).
    One ray, or rays side by side, leave the place on the surface; rays that cross lift it off by the building's
    relief, which the model does not know.
    """
    on_surface = robust_mean(xyz_site_m, weights)
    if len(xyz_site_m) == 1:
        return on_surface
    across = np.eye(3)[None] - ray_site[:, :, None] * ray_site[:, None, :]
    place = on_surface
    for _ in range(_ROUNDS):
        gaps = np.linalg.norm(np.einsum("nij,nj->ni", across, place - xyz_site_m), axis=1) / sigma_m
        off = abs(float((place - on_surface) @ normal_site)) / relief_m
        weight = np.minimum(1.0, _HUBER / np.maximum(gaps, 1e-12)) / sigma_m**2
        held = min(1.0, _HUBER / max(off, 1e-12)) / relief_m**2 * np.outer(normal_site, normal_site)
        system = (weight[:, None, None] * across).sum(axis=0) + held
        right = (weight[:, None] * np.einsum("nij,nj->ni", across, xyz_site_m)).sum(axis=0) + held @ on_surface
        place = np.linalg.solve(system, right)
    return place
