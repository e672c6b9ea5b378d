"""Fit a model's placement to pairs of points of the model and of the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.building.model_georeference.map_placement import (
    MapPlacement,
    compute_grid_factors,
    geo_from_map,
    rotation_from_angle,
)
from facadelake.core.arrays import Float64N, Float64Nx3
from facadelake.core.errors import GeoreferenceError

_MAX_RESIDUAL_M = 0.1  # walls deviate by 2 to 3 cm from their model (DIN 18202); above this a pair is wrong
_MAX_SCALE_ERROR = 0.02  # a scale that deviates more from the map's is a wrong unit or a wrong pair
_MIN_SPREAD_M = 2.0


@dataclass(frozen=True, kw_only=True)
class ControlPair:
    """One point in the model's axes and on the map (east, north, height in the vertical datum), all in metres."""

    ifc_m: tuple[float, float, float]
    map_m: tuple[float, float, float]


def fit_placement(pairs: Sequence[ControlPair], map_crs: str, vertical_datum: str) -> tuple[MapPlacement, str]:
    """Fit rotation about the vertical and translation to the pairs by least squares; the scale is the map's.

    Returns the placement and a remark with the residuals. Raises GeoreferenceError for fewer than two pairs, pairs
    within 2 m of one another, or a residual above 0.1 m, naming the pair.
    """
    source = np.array([pair.ifc_m for pair in pairs], dtype=np.float64).reshape(-1, 3)
    target = np.array([pair.map_m for pair in pairs], dtype=np.float64).reshape(-1, 3)
    if len(pairs) < 2:
        raise GeoreferenceError(
            f"crs.control in the portfolio has {len(pairs)} pair; at least 2 are needed, and 3 or more to detect a "
            "mistake"
        )
    radii = [float(np.max(np.linalg.norm(side[:, :2] - side[:, :2].mean(axis=0), axis=1))) for side in (source, target)]
    if min(radii) < _MIN_SPREAD_M / 2:
        raise GeoreferenceError(
            f"the pairs of crs.control in the portfolio lie within {2 * min(radii):.2f} m of one another in plan; they "
            f"must be more than {_MIN_SPREAD_M:g} m apart to determine the rotation: use corners at the building's ends"
        )
    factor = compute_grid_factors(
        geo_from_map(target.mean(axis=0)[None], map_crs, vertical_datum)[0], map_crs, vertical_datum
    ).combined_factor
    fitted = _solve_placement(source, target, factor)
    residuals = np.linalg.norm(fitted.map_from_ifc(source) - target, axis=1)
    if residuals.max() > _MAX_RESIDUAL_M:
        raise GeoreferenceError(_diagnose_misfit(source, target, factor, residuals))
    baseline = float(np.sqrt(((source[:, :2] - source[:, :2].mean(axis=0)) ** 2).sum()))
    redundancy = 3 * len(pairs) - 4
    sigma = float(np.sqrt((residuals**2).sum() / redundancy))
    return fitted, (
        f"placed by {len(pairs)} pairs of crs.control: residual sigma {sigma:.3f} m per coordinate, largest residual "
        f"{residuals.max():.3f} m at pair {int(residuals.argmax()) + 1}; rotation sigma "
        f"{np.degrees(sigma / baseline):.3f} deg"
    )


def _solve_placement(source: Float64Nx3, target: Float64Nx3, factor: float) -> MapPlacement:
    """Least squares over rotation and translation; source and target in metres."""
    scale = np.array([factor, factor, 1.0])
    source_centre, target_centre = (source * scale).mean(axis=0), target.mean(axis=0)
    a, b = (source * scale - source_centre)[:, :2], (target - target_centre)[:, :2]
    rotation = float(np.degrees(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())))
    east, north, height = target_centre - rotation_from_angle(rotation) @ source_centre
    return MapPlacement(
        east_m=float(east),
        north_m=float(north),
        height_m=float(height),
        rotation_deg=rotation,
        scale=(factor, factor, 1.0),
    )


def _diagnose_misfit(source: Float64Nx3, target: Float64Nx3, factor: float, residuals: Float64N) -> str:
    """Error message that names the pair, or the unit, that causes the residuals (n,)."""
    worst = f"largest residual {residuals.max():.3f} m, limit {_MAX_RESIDUAL_M:g} m"
    ratio = np.sqrt(_sum_squared_distances(target) / _sum_squared_distances(source)) / factor
    if len(source) > 3:
        for index in np.argsort(-residuals):
            rest = np.arange(len(source)) != index
            without = _solve_placement(source[rest], target[rest], factor)
            if np.linalg.norm(without.map_from_ifc(source[rest]) - target[rest], axis=1).max() <= _MAX_RESIDUAL_M:
                deviation = float(np.linalg.norm(without.map_from_ifc(source[[index]]) - target[[index]]))
                return (
                    f"pair {index + 1} of crs.control in the portfolio deviates by {deviation:.3f} m from the "
                    f"placement by the other pairs ({worst}); measure it again, or remove it"
                )
    if abs(ratio - 1) > _MAX_SCALE_ERROR:
        return (
            f"the pairs of crs.control in the portfolio are {ratio:.4g} times as far apart on the map as in the model "
            f"({worst}); ifc_m and map_m are both in metres: check that neither is in millimetres or feet"
        )
    return (
        f"the pairs of crs.control in the portfolio do not agree ({worst}, at pair {int(residuals.argmax()) + 1}), and "
        f"the wrong one cannot be identified among {len(source)}; measure them again, or add more"
    )


def _sum_squared_distances(points: Float64Nx3) -> float:
    """Sum of squared horizontal distances of points (n, 3) from their centroid."""
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    return float((flat**2).sum())
