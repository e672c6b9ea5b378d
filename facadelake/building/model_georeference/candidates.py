"""Find every georeference that an IFC or the portfolio states, graded by LoGeoRef level (Clemen and Goerne 2019).

Every assumption is recorded in ``remarks``; ``docs/georeference-levels.md`` lists the levels for users.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import ifcopenshell
import numpy as np
import pyproj
from pyproj.exceptions import CRSError

from facadelake.building.model_georeference.control_pairs import ControlPair, fit_placement
from facadelake.building.model_georeference.ifc_crs import IfcCrs, read_crs, resolve_crs
from facadelake.building.model_georeference.length_units import LengthUnit
from facadelake.building.model_georeference.map_conversion import list_placements, read_coordinate_operation
from facadelake.building.model_georeference.map_placement import (
    MIN_MAP_COORDINATE_M,
    REGISTRY_LEVEL,
    MapPlacement,
    ModelGeoreference,
    compute_grid_factors,
)
from facadelake.building.model_georeference.site_placement import (
    GeographicAnchor,
    has_address,
    place_on_globe,
    read_geographic_operation,
    read_site_anchor,
    read_true_norths_deg,
    read_world_matrices,
    utm_from_lon_lat,
)
from facadelake.core.arrays import Float64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.crs import AREA_MARGIN_DEG, is_in_area_of_use
from facadelake.core.proj.operations import require_best

_BUILDING_LENGTH_M = 50.0  # length over which an angle is converted to metres


@dataclass(frozen=True, kw_only=True)
class GeoreferenceCandidates:
    """All possible georeferences of a model, the preferred one first.

    ``as_map_coordinates`` interprets the model's coordinates as map coordinates. ``accept_level`` is the lowest
    LoGeoRef level that the portfolio accepts although its accuracy is metres, ``accepted_operation_accuracy_m`` the
    accuracy of a coordinate operation accepted where a better one lacks its grid. ``true_north_deg``: see
    ``read_true_norths_deg``. ``site`` is IfcSite's latitude and longitude, None if not given. ``conflicts`` are
    statements of the IFC that contradict one another, by the level that would use them. ``remarks`` apply to all.
    """

    candidates: tuple[ModelGeoreference, ...]
    as_map_coordinates: ModelGeoreference
    accept_level: int | None
    accepted_operation_accuracy_m: float | None
    true_north_deg: float | None
    site: GeographicAnchor | None
    lower_levels: str
    conflicts: Mapping[str, str]
    remarks: tuple[str, ...]


def find_georeferences(
    model: ifcopenshell.file,
    *,
    map_crs: str | None,
    vertical_datum: str | None,
    placement: MapPlacement | None = None,
    control: Sequence[ControlPair] = (),
    accept_level: int | None = None,
    map_unit: LengthUnit | None = None,
    accepted_operation_accuracy_m: float | None = None,
) -> GeoreferenceCandidates:
    """Find the possible georeferences of a model; the portfolio's statements take precedence over the IFC's.

    Args:
        model: the IFC.
        map_crs: projected CRS of the portfolio; None takes the IFC's.
        vertical_datum: "ellipsoidal" or a vertical CRS of the portfolio; None takes the IFC's.
        placement: placement of the model on the map by the portfolio.
        control: pairs of points of the model and of the map by the portfolio; used before ``placement``.
        accept_level: lowest LoGeoRef level that is accepted although its accuracy is metres.
        map_unit: unit of the IFC's map coordinates by the portfolio; None takes MapUnit.
        accepted_operation_accuracy_m: accuracy of a coordinate operation that is accepted where a better one lacks its
            grid.

    Returns:
        The candidates, the preferred one first; ``select_georeference`` checks them against the geometry.

    Raises:
        GeoreferenceError: the CRS or the vertical datum is neither in the IFC nor given, a statement is invalid, two
            statements of the IFC differ, or PROJ lacks a grid.
    """
    by_registry = bool(control) or placement is not None
    site, site_conflict = read_site_anchor(model)
    geographic = None if by_registry else read_geographic_operation(model)
    lower_levels = _describe_lower_levels(model, site)
    stated = _read_stated_crs(model, is_replaced=by_registry and map_crs is not None and vertical_datum is not None)
    if geographic is None and not by_registry:
        _require_projected_target(model, stated)
    if map_crs is None and geographic is not None:
        map_crs = utm_from_lon_lat(geographic.lon_deg, geographic.lat_deg)
    if map_crs is None and stated.name is None and site is not None and accept_level is not None:
        map_crs = utm_from_lon_lat(site.lon_deg, site.lat_deg)
    if map_crs is None and stated.name is None:
        raise GeoreferenceError(
            f"the IFC names no projected CRS ({lower_levels}); "
            "add IfcProjectedCRS to it, or set crs.map in the portfolio, such as EPSG:25832"
        )
    # The CRS of an operation in degrees is geographic: it is the operation's, not the map's.
    crs = resolve_crs(map_crs, vertical_datum, replace(stated, name=None) if geographic is not None else stated)
    as_map = ModelGeoreference(
        placement=MapPlacement(east_m=0.0, north_m=0.0, height_m=0.0),
        map_crs=crs.horizontal,
        vertical_datum=crs.vertical,
        level="30",
        remarks=f"the model's coordinates (placements and geometry) are taken as coordinates of {crs.horizontal}",
    )
    worlds = read_world_matrices(model)
    norths = read_true_norths_deg(model)
    north = norths[0] if norths else None
    if control:
        fitted, residuals = fit_placement(control, crs.horizontal, crs.vertical)
        found = [replace(as_map, placement=fitted, level=REGISTRY_LEVEL, remarks=residuals)]
    elif placement:
        found = [replace(as_map, placement=placement, level=REGISTRY_LEVEL, remarks="")]
    elif geographic is not None:
        found = [_georeference_from_globe(geographic, as_map, north, "50")]
    else:
        if len(worlds) > 1:
            raise GeoreferenceError(
                "the IFC's contexts have different WorldCoordinateSystems (translations "
                f"{[np.round(world[:3, 3], 3).tolist() for world in worlds]} m); export it with one, or set "
                "crs.placement in the portfolio"
            )
        world = worlds[0] if worlds else None
        found = _read_ifc_candidates(model, as_map, site, north, world, map_unit)
    if worlds:
        found = [candidate if candidate.level == "40" else _note_unused_world(candidate) for candidate in found]
    if found and found[0].is_in_area_of_use(np.zeros(3)):
        # Raises if PROJ lacks a grid, before the elements are meshed.
        require_best(found[0].find_operation(np.zeros(3)), accepted_operation_accuracy_m)
    return GeoreferenceCandidates(
        candidates=tuple(found),
        as_map_coordinates=as_map,
        accept_level=accept_level,
        accepted_operation_accuracy_m=accepted_operation_accuracy_m,
        true_north_deg=north,
        site=site,
        lower_levels=lower_levels,
        conflicts=_list_conflicts(norths, site_conflict, geographic),
        remarks=crs.remarks,
    )


def _read_stated_crs(model: ifcopenshell.file, *, is_replaced: bool) -> IfcCrs:
    """The IFC's CRS; contradictions in it do not matter where the portfolio replaces all of it."""
    try:
        return read_crs(model)
    except GeoreferenceError:
        if not is_replaced:
            raise
        return IfcCrs(name=None, vertical=None, description="", other={})


def _list_conflicts(
    norths_deg: Sequence[float], site_conflict: str, geographic: GeographicAnchor | None
) -> dict[str, str]:
    """Contradictions in the IFC by the level that would use the statements."""
    conflicts = {}
    if len(norths_deg) > 1:
        listed = ", ".join(f"{angle:.3f}" for angle in norths_deg)
        text = f"the IFC's contexts state different TrueNorth ({listed} deg from the y axis)"
        conflicts = dict.fromkeys(("20", "40", *(("50",) if geographic is not None else ())), text)
    if site_conflict:
        conflicts["20"] = site_conflict
    return conflicts


def _read_ifc_candidates(
    model: ifcopenshell.file,
    as_map: ModelGeoreference,
    site: GeographicAnchor | None,
    north_deg: float | None,
    world: Float64Array | None,
    map_unit: LengthUnit | None,
) -> list[ModelGeoreference]:
    """Candidates that the IFC itself states, the highest level first.

    Args:
        model: the IFC.
        as_map: its coordinates taken as map coordinates.
        site: position of IfcSite.
        north_deg: true north, see ``read_true_norths_deg``.
        world: WorldCoordinateSystem (4, 4) in metres; None if it is the identity.
        map_unit: the portfolio's unit of map coordinates.
    """
    operation = read_coordinate_operation(model)
    if operation is not None:
        if world is not None:  # readers disagree on its direction
            raise GeoreferenceError(
                "the IFC's WorldCoordinateSystem is shifted or rotated (translation "
                f"{np.round(world[:3, 3], 3).tolist()} m), and the IFC has a map conversion too; programs combine the "
                "two in different ways: export with the identity as world coordinate system, or set crs.placement in "
                "the portfolio"
            )
        return [
            replace(
                as_map,
                placement=stated.placement,
                level="50",
                remarks=stated.remarks,
                sigma_m=stated.sigma_m,
                reading=stated.reading,
                contradicts=stated.contradicts,
                height_unit_m=stated.unit_m,
            )
            for stated in list_placements(model, operation, as_map.map_crs, map_unit)
        ]
    found = [as_map]
    if world is not None and np.hypot(*world[:2, 3]) > MIN_MAP_COORDINATE_M:
        found.insert(0, _georeference_from_world(world, as_map, north_deg))
    if site is not None and is_in_area_of_use(as_map.map_crs, site.lon_deg, site.lat_deg, AREA_MARGIN_DEG):
        found.append(_georeference_from_globe(site, as_map, north_deg, "20"))
    return found


def _require_projected_target(model: ifcopenshell.file, stated: IfcCrs) -> None:
    """Raise if the map conversion's own CRS is geographic: its values are degrees, whatever the portfolio's CRS."""
    try:
        crs = pyproj.CRS.from_user_input(stated.name) if stated.name else None
    except CRSError:
        return
    operation = read_coordinate_operation(model) if crs is not None and crs.is_geographic else None
    if crs is not None and operation is not None:
        raise GeoreferenceError(
            f"{operation.kind} has the target CRS '{stated.name}' ({crs.name}), whose coordinates are degrees, not a "
            f"projected CRS (east {operation.east:g}, north {operation.north:g}); export it with a projected CRS, or "
            "set crs.map and crs.placement (or crs.control) in the portfolio"
        )


def _note_unused_world(candidate: ModelGeoreference) -> ModelGeoreference:
    unused = "the IFC's WorldCoordinateSystem is shifted or rotated and was not used"
    return replace(candidate, remarks="; ".join(filter(None, [candidate.remarks, unused])))


def _georeference_from_world(
    world: Float64Array, as_map: ModelGeoreference, north_deg: float | None
) -> ModelGeoreference:
    """LoGeoRef 40: map coordinates in WorldCoordinateSystem (4, 4), rotated by it or else by TrueNorth."""
    if abs(world[2, 2] - 1) > 1e-9:
        raise GeoreferenceError(
            "the IFC's WorldCoordinateSystem is tilted, so the model would not be upright; export with an upright "
            "world coordinate system, or set crs.placement in the portfolio"
        )
    rotation_deg = float(np.degrees(np.arctan2(world[1, 0], world[0, 0])))
    remarks, sigma = f"placed by WorldCoordinateSystem, taken as map coordinates of {as_map.map_crs}", 0.0
    if rotation_deg == 0.0 and north_deg:
        rotation_deg = -north_deg
        if as_map.is_in_area_of_use(world[:3, 3]):
            geo = as_map.geo_from_ifc(world[None, :3, 3])[0]
            convergence_deg = abs(compute_grid_factors(geo, as_map.map_crs, as_map.vertical_datum).true_east_deg)
            sigma = float(np.radians(convergence_deg) * _BUILDING_LENGTH_M)
            remarks += (
                f" and rotated by TrueNorth, taken as grid north; true north differs by {convergence_deg:.2f} deg "
                f"here, {sigma:.2f} m over {_BUILDING_LENGTH_M:g} m"
            )
    return replace(
        as_map,
        placement=MapPlacement(
            east_m=float(world[0, 3]),
            north_m=float(world[1, 3]),
            height_m=float(world[2, 3]),
            rotation_deg=rotation_deg,
        ),
        level="40",
        remarks=remarks,
        sigma_m=sigma,
    )


def _georeference_from_globe(
    anchor: GeographicAnchor, as_map: ModelGeoreference, north_deg: float | None, level: str
) -> ModelGeoreference:
    north = "the model's y axis taken as north" if north_deg is None else f"rotated by TrueNorth {north_deg:.2f} deg"
    accuracy = f"; position accuracy about {anchor.sigma_m:.0f} m, one sigma" if anchor.sigma_m else ""
    return replace(
        as_map,
        placement=place_on_globe(anchor, as_map.map_crs, as_map.vertical_datum, north_deg),
        level=level,
        remarks=f"{anchor.remark}, {north}{accuracy}",
        sigma_m=anchor.sigma_m,
    )


def _describe_lower_levels(model: ifcopenshell.file, site: GeographicAnchor | None) -> str:
    """The model's georeference of level 20 or 10, for an error message."""
    if site is not None:
        return (
            f"it has only IfcSite latitude and longitude, LoGeoRef 20, accuracy about {site.sigma_m:.0f} m; "
            "crs.accept_level: 20 would accept them"
        )
    address = "; its address, LoGeoRef 10, is not a position" if has_address(model) else ""
    return f"it has no IfcSite latitude and longitude either{address}"
