"""Select the georeference to use, once the model's geometry is known, and check it.

A position with an accuracy of metres is refused unless the portfolio accepts its LoGeoRef level by name.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pyproj

from facadelake.building.model_georeference.candidates import GeoreferenceCandidates
from facadelake.building.model_georeference.map_placement import (
    MIN_MAP_COORDINATE_M,
    REGISTRY_LEVEL,
    GridFactors,
    MapPlacement,
    ModelGeoreference,
    compute_grid_factors,
    describe_map_axes,
)
from facadelake.building.model_georeference.site_placement import GeographicAnchor
from facadelake.core.arrays import Float64Array, Float64x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.crs import is_in_area_of_use, name_area_of_use
from facadelake.core.proj.operations import describe_poor_operation, require_best
from facadelake.registry import UNITS_M

_log = logging.getLogger(__name__)
GROUND_HEIGHTS_M = (-500.0, 9000.0)  # the shore of the Dead Sea is at -430 m, Mount Everest at 8,849 m
_MAX_GROUND_SCALE_ERROR = 0.005  # grid scale factors and heights change lengths by up to 0.2 %
_MIN_SCALE_ERROR_M = 0.01
_SITE_TOLERANCE_M = 500.0  # IfcSite's position is of the plot, and often rounded to a second
_GRS80 = pyproj.Geod(ellps="GRS80")
_UNIT_NAMES = ", ".join(UNITS_M)
_HEIGHT_UNITS_M = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "feet": 0.3048}
_MISTAKES: dict[str, Callable[[Float64x3], Float64x3]] = {
    "with east and north exchanged": lambda xyz: xyz[[1, 0, 2]],
    "in millimetres": lambda xyz: xyz * [0.001, 0.001, 1.0],
    "in feet": lambda xyz: xyz * [0.3048, 0.3048, 1.0],
    "in metres, not feet,": lambda xyz: xyz / [0.3048, 0.3048, 1.0],
    "with the other sign": lambda xyz: xyz * [-1.0, -1.0, 1.0],
    "exchanged and with the other sign": lambda xyz: -xyz[[1, 0, 2]],
    "without the number of the zone before its east": lambda xyz: xyz - [np.floor(xyz[0] / 1e6) * 1e6, 0.0, 0.0],
}
_MAX_SIGMA_M = 0.05  # photographs are georeferenced to centimetres; a less accurate model does not fit them
_NORTH_TOLERANCE_DEG = 0.1


def select_georeference(candidates: GeoreferenceCandidates, extent_ifc_m: Float64Array) -> ModelGeoreference:
    """Select the georeference of a model whose geometry has the lowest and highest corner ``extent_ifc_m`` (2, 3).

    Its remarks list the assumptions. Raises GeoreferenceError if there is none, if all put the centre outside the area
    of use of their CRS or at a height where no building stands, if two statements of the IFC differ, if the shift to
    the map is in the geometry and in the conversion, or if the accuracy is metres and the portfolio does not accept the
    level.
    """
    centre = extent_ifc_m.mean(axis=0)
    on_map = _has_map_coordinates(candidates.as_map_coordinates, centre)
    possible = [candidate for candidate in candidates.candidates if on_map or candidate.level != "30"]
    if not possible:
        unusable = f"; {candidates.conflicts['20']}" if "20" in candidates.conflicts else ""
        raise GeoreferenceError(
            f"the IFC is not georeferenced: it has no IfcMapConversion ({candidates.lower_levels}{unusable}); "
            "georeference it in the authoring tool, or set crs.placement (east_m, north_m, height_m, rotation_deg) in "
            "the portfolio"
        )
    for candidate in possible:
        if candidate.level == possible[0].level:
            _check_double_shift(candidate, centre, on_map=on_map)
    selected = _select_in_area_of_use(possible, centre)
    if selected.level in candidates.conflicts:
        raise GeoreferenceError(
            f"{candidates.conflicts[selected.level]}, and the model is placed by it (LoGeoRef {selected.level}); "
            "correct the IFC, or set crs.placement in the portfolio"
        )
    axes = describe_map_axes(selected)
    require_possible_heights(selected, extent_ifc_m)
    _check_accuracy(selected, candidates.accept_level)
    operation = selected.find_operation(centre)
    require_best(operation, candidates.accepted_operation_accuracy_m)
    geo = selected.geo_from_ifc(centre[None])[0]
    grid = compute_grid_factors(geo, selected.map_crs, selected.vertical_datum)
    _require_possible_scale(selected, grid)
    notes = [
        selected.remarks,
        axes,
        describe_poor_operation(operation),
        *candidates.remarks,
        _describe_margin(selected, geo),
        _describe_height_unit(selected),
        _describe_grid_scale(selected, grid, float(np.ptp(extent_ifc_m[:, :2], axis=0).max())),
        _describe_north_conflict(selected, candidates.true_north_deg, grid),
        *(text for text in dict.fromkeys(candidates.conflicts.values())),
        _describe_site_conflict(selected, candidates.site),
    ]
    remarks = "; ".join(filter(None, notes))
    if remarks:
        _log.info("georeference of the model: %s", remarks)
    return replace(selected, remarks=remarks)


def _select_in_area_of_use(candidates: Sequence[ModelGeoreference], centre_ifc_m: Float64x3) -> ModelGeoreference:
    """The first candidate that puts the centre of the geometry into the area of use of its CRS.

    Raises GeoreferenceError if there is none, if another of its level puts it elsewhere in that area, or if the only
    one contradicts a statement.
    """
    inside = [candidate for candidate in candidates if candidate.is_in_area_of_use(centre_ifc_m)]
    if not inside:
        raise GeoreferenceError(_describe_outside(candidates[0], centre_ifc_m))
    first, map_m = inside[0], inside[0].placement.map_from_ifc(centre_ifc_m[None])[0]
    if first.contradicts:
        raise GeoreferenceError(
            f"read in {first.contradicts}, the model lies outside the area of use of {first.map_crs} "
            f"({name_area_of_use(first.map_crs)}), read in {first.reading}, it lies in it; correct MapUnit in the IFC, "
            f"or set crs.map_unit in the portfolio ({_UNIT_NAMES})"
        )
    for other in inside[1:]:
        other_m = other.placement.map_from_ifc(centre_ifc_m[None])[0]
        if other.level == first.level and np.linalg.norm(map_m - other_m) > _MAX_SIGMA_M:
            raise GeoreferenceError(
                f"read in {first.reading}, the centre of the model is at east, north, height {map_m.round(1).tolist()} "
                f"m, read in {other.reading}, at {other_m.round(1).tolist()} m, and both lie in or near the area "
                f"of use of {first.map_crs}; correct MapUnit in the IFC, or set crs.map_unit in the portfolio "
                f"({_UNIT_NAMES})"
            )
    # Near the area is enough, as all of Bavaria is to EPSG:25832, unless a mistake explains it.
    is_near = not first.is_in_area_of_use(centre_ifc_m, margin_deg=0.0)
    if is_near and first.level != REGISTRY_LEVEL and _name_mistake(first, centre_ifc_m):
        raise GeoreferenceError(_describe_outside(first, centre_ifc_m))
    return first


def _name_mistake(candidate: ModelGeoreference, centre_ifc_m: Float64x3) -> str:
    """The mistake without which the model would lie in the area of use, of those that are usual; empty if none."""
    shift = candidate.placement if not _is_at_zero(candidate.placement) else None
    for mistake, change in _MISTAKES.items():
        if shift is not None:
            east, north, _ = change(np.array([shift.east_m, shift.north_m, shift.height_m]))
            changed = replace(candidate, placement=replace(shift, east_m=float(east), north_m=float(north)))
            fits = changed.is_in_area_of_use(centre_ifc_m, margin_deg=0.0)
        else:
            fits = candidate.is_in_area_of_use(change(centre_ifc_m), margin_deg=0.0)
        if fits:
            return mistake
    return ""


def _describe_outside(candidate: ModelGeoreference, centre_ifc_m: Float64x3) -> str:
    """Error message of a model outside the area of use, with the mistake that would explain it."""
    horizontal = candidate.map_crs
    centre_map = candidate.placement.map_from_ifc(centre_ifc_m[None])[0]
    mistake = _name_mistake(candidate, centre_ifc_m)
    found = f"; {mistake} it would lie in it" if mistake else ""
    return (
        f"the centre of the model is at east, north, height {centre_map.round(1).tolist()} m, outside the area of use "
        f"of {horizontal} ({name_area_of_use(horizontal)}){found}; check the CRS and the units, and that the shift to "
        "the map is not in both the geometry and IfcMapConversion"
    )


def _is_at_zero(placement: MapPlacement) -> bool:
    return bool(np.hypot(placement.east_m, placement.north_m) < MIN_MAP_COORDINATE_M)


def require_possible_heights(candidate: ModelGeoreference, extent_ifc_m: Float64Array) -> None:
    """Refuse a placement that puts the building at a height where none stands."""
    bottom_m = float(candidate.placement.map_from_ifc(extent_ifc_m[:1])[0, 2])
    lowest_m, highest_m = GROUND_HEIGHTS_M
    if lowest_m <= bottom_m <= highest_m:
        return
    shift_m = candidate.placement.height_m
    suspects = [
        f"{name} ({shift_m * unit_m:,.2f} m)"
        for name, unit_m in _HEIGHT_UNITS_M.items()
        if lowest_m <= bottom_m - shift_m + shift_m * unit_m <= highest_m and abs(shift_m) > highest_m / 2
    ]
    guess = f"; in {suspects[0]} it would be possible" if suspects else ""
    raise GeoreferenceError(
        f"the model's lowest point is at height {bottom_m:,.1f} m (its origin at {shift_m:,.1f} m), where no building "
        f"stands (limits {lowest_m:,.0f} to {highest_m:,.0f} m){guess}; correct OrthogonalHeight, the elevation or its "
        "unit in the model, or set crs.placement in the portfolio"
    )


def _require_possible_scale(candidate: ModelGeoreference, grid: GridFactors) -> None:
    """Refuse a map scale with which the building would have another size on the ground."""
    scale = np.sqrt(candidate.placement.scale[0] * candidate.placement.scale[1])
    ratio = float(scale / grid.combined_factor)
    if abs(ratio - 1) <= _MAX_GROUND_SCALE_ERROR or candidate.level == "30":
        return
    raise GeoreferenceError(
        f"the model's scale is {scale:.6f} map metres per metre, but a metre on the ground is "
        f"{grid.combined_factor:.6f} m on the map of {candidate.map_crs} here: the building would be "
        f"{ratio:.4f} times its size (limit {_MAX_GROUND_SCALE_ERROR:.1%}); correct Scale in the IFC or crs.map, or "
        "set crs.control in the portfolio, which keeps the size"
    )


def _describe_margin(candidate: ModelGeoreference, geo: Float64x3) -> str:
    """Remark that the building lies outside the area of use, within the margin."""
    if is_in_area_of_use(candidate.map_crs, float(geo[0]), float(geo[1]), 0.0):
        return ""
    return (
        f"the building, at lon {geo[0]:.4f}, lat {geo[1]:.4f}, lies outside the area of use of {candidate.map_crs} "
        f"({name_area_of_use(candidate.map_crs)}), but near it"
    )


def _describe_height_unit(candidate: ModelGeoreference) -> str:
    """Remark that the height was read in another unit than that of its vertical CRS."""
    if not candidate.reading or not candidate.vertical_datum.startswith("EPSG:") or not candidate.height_unit_m:
        return ""
    axis = pyproj.CRS.from_user_input(candidate.vertical_datum).axis_info[0]
    crs_m = float(axis.unit_conversion_factor)
    height = candidate.placement.height_m / candidate.height_unit_m
    if abs(height * (crs_m - candidate.height_unit_m)) <= _MAX_SIGMA_M:
        return ""
    return (
        f"the height {height:g} was read in {candidate.reading}, as {candidate.placement.height_m:.2f} m; in the unit "
        f"of {candidate.vertical_datum} ({axis.unit_name}) it would be {height * crs_m:.2f} m"
    )


def _describe_site_conflict(candidate: ModelGeoreference, site: GeographicAnchor | None) -> str:
    """Remark that IfcSite's latitude and longitude are elsewhere.

    Raises GeoreferenceError if the model would lie there with latitude and longitude exchanged.
    """
    if site is None or candidate.level == "20":
        return ""
    lon, lat, _ = candidate.geo_from_ifc(site.anchor_ifc_m[None])[0]
    distance_m = _GRS80.inv(lon, lat, site.lon_deg, site.lat_deg)[2]
    if distance_m <= max(_SITE_TOLERANCE_M, 3 * site.sigma_m):
        return ""
    position = f"latitude {site.lat_deg:.6f} and longitude {site.lon_deg:.6f} of IfcSite"
    if abs(lon) <= 90 and _GRS80.inv(lat, lon, site.lon_deg, site.lat_deg)[2] < distance_m / 100:
        raise GeoreferenceError(
            f"the model is placed at latitude {lat:.6f} and longitude {lon:.6f}, {distance_m / 1000:,.0f} km from "
            f"{position}, and would lie there with the two exchanged; correct the IFC's coordinate operation, or set "
            "crs.placement in the portfolio"
        )
    return f"{position} lie {distance_m / 1000:,.1f} km away and were not used"


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


def _describe_grid_scale(candidate: ModelGeoreference, grid: GridFactors, size_m: float) -> str:
    """Remark that model lengths are not lengths on the ground; empty where that makes less than a centimetre."""
    ground = f"a metre on the ground is {grid.combined_factor:.6f} m on the map"
    if candidate.level in ("30", "40"):
        return f"model lengths are taken as map lengths; {ground}"
    scale = float(np.sqrt(candidate.placement.scale[0] * candidate.placement.scale[1]))
    error_m = abs(scale / grid.combined_factor - 1) * size_m
    if error_m < _MIN_SCALE_ERROR_M:
        return ""
    return f"the model's scale is {scale:.6f}, {ground}: {error_m:.3f} m over the building's {size_m:.0f} m"


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
