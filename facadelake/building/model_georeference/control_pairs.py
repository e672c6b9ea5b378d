"""A model placed by pairs: points of the model and where they lie on the map."""

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
from facadelake.core.arrays import Float64Array
from facadelake.core.errors import GeoreferenceError

_MAX_RESIDUAL_M = 0.1  # walls stand 2 to 3 cm off their model (DIN 18202); beyond this a pair is wrong
_MAX_SCALE_ERROR = 0.02  # a scale further than this from the map's is a wrong unit or a wrong pair
_MIN_SPREAD_M = 2.0


@dataclass(frozen=True, kw_only=True)
class ControlPair:
    """One point in the model's axes and on the map (east, north, height in its vertical datum), all in metres."""

    ifc_m: tuple[float, float, float]
    map_m: tuple[float, float, float]


def fit_placement(pairs: Sequence[ControlPair], map_crs: str, vertical_datum: str) -> tuple[MapPlacement, str]:
    """The upright placement that fits the pairs best (turn and shift; the scale is the map's own), and its residuals.

    Raises GeoreferenceError for fewer than two pairs, pairs within 2 m, or a residual beyond 0.1 m, and names the pair.
    """
    source = np.array([pair.ifc_m for pair in pairs], dtype=np.float64).reshape(-1, 3)
    target = np.array([pair.map_m for pair in pairs], dtype=np.float64).reshape(-1, 3)
    if len(pairs) < 2:
        raise GeoreferenceError(
            f"the registry's crs.control has {len(pairs)} pair; at least 2 are needed, and 3 or more to find a mistake"
        )
    apart = [float(np.max(np.linalg.norm(side[:, :2] - side[:, :2].mean(axis=0), axis=1))) for side in (source, target)]
    if min(apart) < _MIN_SPREAD_M / 2:
        raise GeoreferenceError(
            f"the pairs of the registry's crs.control lie within {2 * min(apart):.2f} m of one another in plan; they "
            f"must be more than {_MIN_SPREAD_M:g} m apart to turn the model: take corners at the building's ends"
        )
    factor = compute_grid_factors(
        geo_from_map(target.mean(axis=0)[None], map_crs, vertical_datum)[0], map_crs, vertical_datum
    ).combined_factor
    fitted = _solve_placement(source, target, factor)
    off = np.linalg.norm(fitted.map_from_ifc(source) - target, axis=1)
    if off.max() > _MAX_RESIDUAL_M:
        raise GeoreferenceError(_diagnose_misfit(source, target, factor, off))
    baseline = float(np.sqrt(((source[:, :2] - source[:, :2].mean(axis=0)) ** 2).sum()))
    spare = 3 * len(pairs) - 4
    sigma = float(np.sqrt((off**2).sum() / spare))
    return fitted, (
        f"placed by {len(pairs)} pairs of crs.control: residuals {sigma:.3f} m a coordinate, largest {off.max():.3f} m "
        f"at pair {int(off.argmax()) + 1}; turn good to {np.degrees(sigma / baseline):.3f} deg"
    )


def _solve_placement(source: Float64Array, target: Float64Array, factor: float) -> MapPlacement:
    """Least squares over turn and shift; source and target in metres."""
    scale = np.array([factor, factor, 1.0])
    middle, there = (source * scale).mean(axis=0), target.mean(axis=0)
    a, b = (source * scale - middle)[:, :2], (target - there)[:, :2]
    rotation = float(np.degrees(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())))
    east, north, height = there - rotation_from_angle(rotation) @ middle
    return MapPlacement(
        east_m=float(east),
        north_m=float(north),
        height_m=float(height),
        rotation_deg=rotation,
        scale=(factor, factor, 1.0),
    )


def _diagnose_misfit(source: Float64Array, target: Float64Array, factor: float, off: Float64Array) -> str:
    """Which pair, or which unit, makes the pairs disagree."""
    worst = f"largest residual {off.max():.3f} m, allowed {_MAX_RESIDUAL_M:g} m"
    ratio = np.sqrt(_sum_squared_distances(target) / _sum_squared_distances(source)) / factor
    if len(source) > 3:
        for index in np.argsort(-off):
            rest = np.arange(len(source)) != index
            without = _solve_placement(source[rest], target[rest], factor)
            if np.linalg.norm(without.map_from_ifc(source[rest]) - target[rest], axis=1).max() <= _MAX_RESIDUAL_M:
                own = float(np.linalg.norm(without.map_from_ifc(source[[index]]) - target[[index]]))
                return (
                    f"pair {index + 1} of the registry's crs.control is {own:.3f} m off what the others agree on "
                    f"({worst}); measure it again, or take it out"
                )
    if abs(ratio - 1) > _MAX_SCALE_ERROR:
        return (
            f"the pairs of the registry's crs.control are {ratio:.4g} times as far apart on the map as in the model "
            f"({worst}); ifc_m and map_m are both in metres: is one in millimetres or feet?"
        )
    return (
        f"the pairs of the registry's crs.control disagree ({worst}, at pair {int(off.argmax()) + 1}), and "
        f"{len(source)} are too few or too bad to tell which is wrong; measure them again, or add more"
    )


def _sum_squared_distances(points: Float64Array) -> float:
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    return float((flat**2).sum())
