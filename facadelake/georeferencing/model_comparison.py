"""Comparison of an adjusted block with the building model: distances of its tie points, and doming."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.point_to_plane import RaySurface, match_points_to_surface

_GATE_M = 0.5
_MIN_POINTS_FOR_DOMING = 200


@dataclass(frozen=True, kw_only=True)
class ModelComparison:
    """The block against the model.

    ``residual_m``: median distance of tie points from the faces they were seen on. ``doming_m`` and ``doming_sigma_m``:
    sagitta of a curvature common to all walls (NaN where too few points lie on walls).
    """

    residual_m: float
    doming_m: float
    doming_sigma_m: float


def compare_with_model(adjusted: AdjustedBlock, surface: RaySurface) -> ModelComparison | None:
    """Compare the block with the model; None where its tie points do not meet the model.

    Doming (James and Robson 2014): ``distance = a + b u + c (u^2 - mean)`` along each wall's horizontal u, with one
    curvature c for all walls; the sagitta is c times the square of half the longest wall. It is independent of the
    model only where the model was not the control.
    """
    state = adjusted.solution.state
    terms = match_points_to_surface(adjusted.tie_points, state, surface, gate_m=_GATE_M, model_sigma_m=1.0)
    if not len(terms.point):
        return None
    xyz = state.xyz_site_m[terms.point]
    distance = np.einsum("ij,ij->i", terms.normal_site, xyz) - terms.distance_m
    bends, distances, longest = [], [], 0.0
    for wall in range(len(terms.wall_sigma_m)):
        on_wall = terms.wall == wall
        normal = terms.normal_site[on_wall].mean(axis=0)
        if np.hypot(normal[0], normal[1]) < 0.5:
            continue  # floors and roofs have no horizontal run
        along = np.array([-normal[1], normal[0], 0.0]) / np.hypot(normal[0], normal[1])
        u = xyz[on_wall] @ along
        u = u - u.mean()
        plane = np.column_stack([np.ones(len(u)), u])
        bend = u**2 - (u**2).mean()
        # Offset and tilt of the wall are removed from both sides.
        removed = np.linalg.lstsq(plane, np.column_stack([bend, distance[on_wall]]), rcond=None)[0]
        bends.append(bend - plane @ removed[:, 0])
        distances.append(distance[on_wall] - plane @ removed[:, 1])
        longest = max(longest, float(np.ptp(u)))
    doming, sigma = np.nan, np.nan
    if bends and sum(map(len, bends)) >= _MIN_POINTS_FOR_DOMING:
        x, y = np.concatenate(bends), np.concatenate(distances)
        inlier = np.abs(y) < 3 * 1.4826 * np.median(np.abs(y))
        x, y = x[inlier], y[inlier]
        curvature = float(x @ y / (x @ x))
        curvature_sigma = float(np.std(y - curvature * x) / np.sqrt(x @ x))
        half = (longest / 2) ** 2
        doming, sigma = curvature * half, curvature_sigma * half * float(np.sqrt(adjusted.tie_variance_factor))
    return ModelComparison(residual_m=float(np.median(np.abs(distance))), doming_m=doming, doming_sigma_m=sigma)
