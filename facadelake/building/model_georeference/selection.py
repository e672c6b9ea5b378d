"""Select the georeference to use, once the model's geometry is known, and check it.

A position with an accuracy of metres is refused unless the portfolio accepts its LoGeoRef level by name.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from facadelake.building.model_georeference.candidates import GeoreferenceCandidates
from facadelake.building.model_georeference.map_placement import (
    MIN_MAP_COORDINATE_M,
    GridFactors,
    ModelGeoreference,
    compute_grid_factors,
)
from facadelake.core.arrays import Float64x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import name_area_of_use

_log = logging.getLogger(__name__)
_MAX_SIGMA_M = 0.05  # photographs are georeferenced to centimetres; a less accurate model does not fit them
_NORTH_TOLERANCE_DEG = 0.1


def select_georeference(candidates: GeoreferenceCandidates, centre_ifc_m: Float64x3) -> ModelGeoreference:
    """Select the georeference of a model whose geometry has the centre ``centre_ifc_m`` (3,).

    Its remarks list the assumptions. Raises GeoreferenceError if there is none, if all put the centre outside the area
    of use of their CRS, if the shift to the map is in the geometry and in the conversion, or if the accuracy is metres
    and the portfolio does not accept the level.
    """
    on_map = _has_map_coordinates(candidates.as_map_coordinates, centre_ifc_m)
    possible = [candidate for candidate in candidates.candidates if on_map or candidate.level != "30"]
    if not possible:
        raise GeoreferenceError(
            f"the IFC is not georeferenced: it has no IfcMapConversion ({candidates.lower_levels}); georeference it in "
            "the authoring tool, or set crs.placement (east_m, north_m, height_m, rotation_deg) in the portfolio"
        )
    for candidate in possible:
        if candidate.level == possible[0].level:
            _check_double_shift(candidate, centre_ifc_m, on_map=on_map)
    selected = _select_in_area_of_use(possible, centre_ifc_m)
    _check_accuracy(selected, candidates.accept_level)
    grid = compute_grid_factors(selected.geo_from_ifc(centre_ifc_m[None])[0], selected.map_crs, selected.vertical_datum)
    notes = [
        selected.remarks,
        _describe_grid_scale(selected, grid),
        _describe_north_conflict(selected, candidates.true_north_deg, grid),
    ]
    remarks = "; ".join(filter(None, notes))
    if remarks:
        _log.info("georeference of the model: %s", remarks)
    return replace(selected, remarks=remarks)


def _select_in_area_of_use(candidates: Sequence[ModelGeoreference], centre_ifc_m: Float64x3) -> ModelGeoreference:
    """The first candidate that puts the centre of the geometry into the area of use of its CRS."""
    for candidate in candidates:
        if candidate.is_in_area_of_use(centre_ifc_m):
            return candidate
    horizontal = candidates[0].map_crs
    centre_map = candidates[0].placement.map_from_ifc(centre_ifc_m[None])[0].round(1).tolist()
    raise GeoreferenceError(
        f"the centre of the model is at east, north, height {centre_map} m, outside the area of use of {horizontal} "
        f"({name_area_of_use(horizontal)}); check the CRS and the units, and that the shift to the map is not in both "
        "the geometry and IfcMapConversion"
    )


def _check_double_shift(candidate: ModelGeoreference, centre_ifc_m: Float64x3, *, on_map: bool) -> None:
    """Raise if the geometry has map coordinates already and the placement adds as large a shift again."""
    placement = candidate.placement
    if not on_map or np.hypot(placement.east_m, placement.north_m) < MIN_MAP_COORDINATE_M:
        return
    if np.allclose(placement.map_from_ifc(centre_ifc_m[None])[0], centre_ifc_m, rtol=0, atol=MIN_MAP_COORDINATE_M):
        return  # pairs that rotate map coordinates by a small angle shift their distant origin by much
    raise GeoreferenceError(
        f"the model is shifted to the map twice: its geometry is at {centre_ifc_m.round(1).tolist()} m, which are "
        f"map coordinates of {candidate.map_crs}, and its placement adds east, north "
        f"{[round(placement.east_m, 1), round(placement.north_m, 1)]} m; export it with only one of the two shifts, "
        "or, if the geometry is right, set crs.placement in the portfolio to {east_m: 0, north_m: 0, height_m: 0}"
    )


def _check_accuracy(candidate: ModelGeoreference, accept_level: int | None) -> None:
    if candidate.sigma_m <= _MAX_SIGMA_M or (accept_level is not None and int(candidate.level) >= accept_level):
        return
    raise GeoreferenceError(
        f"the model's georeference is LoGeoRef {candidate.level}: {candidate.remarks}; its sigma is "
        f"{candidate.sigma_m:.2g} m, above the limit of {_MAX_SIGMA_M:g} m for registering defects on it; set "
        "crs.control (pairs of points of the model and of the map) or crs.placement in the portfolio, or accept the "
        f"level with crs.accept_level: {candidate.level} and georeference the campaign by the model, not by control "
        "points"
    )


def _describe_grid_scale(candidate: ModelGeoreference, grid: GridFactors) -> str:
    """Remark that coordinates in placements are lengths on the map; empty for other levels."""
    if candidate.level not in ("30", "40"):
        return ""
    return f"model lengths are taken as map lengths; a metre on the ground is {grid.combined_factor:.6f} m on the map"


def _describe_north_conflict(candidate: ModelGeoreference, north_deg: float | None, grid: GridFactors) -> str:
    """Remark that TrueNorth contradicts the rotation used; empty where it agrees with true or grid north."""
    if north_deg is None or candidate.level in ("20", "40"):
        return ""
    from_grid_deg = (-candidate.placement.rotation_deg - north_deg + 180.0) % 360.0 - 180.0
    from_true_deg = (from_grid_deg + grid.true_east_deg + 180.0) % 360.0 - 180.0
    if min(abs(from_grid_deg), abs(from_true_deg)) <= _NORTH_TOLERANCE_DEG:
        return ""
    return (
        f"TrueNorth ({north_deg:.2f} deg from the model's y axis) differs by {abs(from_true_deg):.2f} deg from true "
        "north and was not used"
    )


def _has_map_coordinates(as_map: ModelGeoreference, centre_ifc_m: Float64x3) -> bool:
    """Whether the geometry has map coordinates: far from zero, and inside the CRS's area of use."""
    return bool(np.hypot(*centre_ifc_m[:2]) > MIN_MAP_COORDINATE_M) and as_map.is_in_area_of_use(
        centre_ifc_m, margin_deg=0.0
    )
