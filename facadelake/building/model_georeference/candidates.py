"""Where an IFC stands on the map, by whatever way it says so, graded by LoGeoRef (Clemen and Goerne 2019).

Nothing is guessed in silence: what had to be assumed is said in ``remarks``, and a place that is good to metres alone
is refused unless the registry accepts its level by name. docs/georeference-levels.md tells a user what to do.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import ifcopenshell
import numpy as np
import pyproj

from facadelake.building.model_georeference.control_pairs import ControlPair, fit_placement
from facadelake.building.model_georeference.crs import ELLIPSOIDAL, parse_vertical_datum, split_crs
from facadelake.building.model_georeference.map_conversion import list_placements, read_coordinate_operation, read_crs
from facadelake.building.model_georeference.map_placement import (
    GridFactors,
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
    read_true_north_deg,
    read_world_matrix,
    utm_from_lon_lat,
)
from facadelake.core.arrays import Float64Array
from facadelake.core.errors import GeoreferenceError

__all__ = [
    "ELLIPSOIDAL",
    "Georeference",
    "MapPlacement",
    "GeoreferenceCandidates",
    "select_georeference",
    "find_georeferences",
    "_select_in_area_of_use",
]

_log = logging.getLogger(__name__)
_BORDER_DEG = 1.0  # how far outside a CRS's area of use a building may stand
_FAR_M = 10_000.0  # coordinates beyond this are a map's, and a building's own are not
_GOOD_M = 0.05  # one sigma: a place worse than this does not carry photographs placed to centimetres
_NORTH_APART_DEG = 0.1
_ARM_M = 50.0  # a building's length over which a turn is told in metres
REGISTRY = "registry"


@dataclass(frozen=True, kw_only=True)
class GeoreferenceCandidates:
    """Every reading of the model's georeference, the one to be preferred first.

    ``accept_level`` is the lowest LoGeoRef that the registry accepts though it is good to metres alone.
    ``as_map_coordinates`` takes the model's coordinates for the map's. ``lower_levels`` says in words what the IFC has.
    """

    candidates: tuple[ModelGeoreference, ...]
    as_map_coordinates: ModelGeoreference
    accept_level: int | None
    true_north_deg: float | None
    lower_levels: str


def find_georeferences(
    model: ifcopenshell.file,
    *,
    map_crs: str | None,
    vertical_datum: str | None,
    placement: MapPlacement | None = None,
    control: Sequence[ControlPair] = (),
    accept_level: int | None = None,
) -> GeoreferenceCandidates:
    """Readings of the model's georeference, the standard's first; what the caller gives goes before what the IFC says.

    Raises GeoreferenceError where the CRS or the vertical datum is neither in the IFC nor given, where what is stated
    cannot be, or where PROJ lacks a grid.
    """
    site, in_degrees = read_site_anchor(model), read_geographic_operation(model)
    there_is = _describe_lower_levels(model, site)
    stated, stated_vertical = read_crs(model)
    if map_crs is None and in_degrees is not None:
        map_crs = utm_from_lon_lat(in_degrees.lon_deg, in_degrees.lat_deg)
    if map_crs is None and stated is None and site is not None and accept_level is not None:
        map_crs = utm_from_lon_lat(site.lon_deg, site.lat_deg)
    if map_crs is None and stated is None:
        raise GeoreferenceError(
            f"the IFC names no projected CRS ({there_is}); "
            "write IfcProjectedCRS into it, or give the registry's crs.map, such as EPSG:25832"
        )
    horizontal, by_crs = split_crs(map_crs or stated or "")
    vertical = vertical_datum and parse_vertical_datum(vertical_datum)
    vertical = vertical or by_crs or (stated_vertical and parse_vertical_datum(stated_vertical))
    if not vertical:
        raise GeoreferenceError(
            f"neither the IFC nor the registry says what the model's heights refer to (CRS {horizontal}); give the "
            "registry's crs.vertical: 'ellipsoidal', or a vertical CRS such as EPSG:5783 (DHHN92)"
        )
    as_it_is = ModelGeoreference(
        placement=MapPlacement(east_m=0.0, north_m=0.0, height_m=0.0),
        map_crs=horizontal,
        vertical_datum=vertical,
        level="30",
        remarks=f"the model's coordinates, placements and geometry together, are taken as coordinates of {horizontal}",
    )
    north = read_true_north_deg(model)
    if control:
        fitted, said = fit_placement(control, horizontal, vertical)
        found = [replace(as_it_is, placement=fitted, level=REGISTRY, remarks=said)]
    elif placement:
        found = [replace(as_it_is, placement=placement, level=REGISTRY, remarks="")]
    elif in_degrees is not None:
        found = [_georeference_from_globe(in_degrees, as_it_is, north, "50")]
    else:
        found = _read_ifc_candidates(model, as_it_is, site, north)
    if read_world_matrix(model) is not None:
        found = [reading if reading.level == "40" else _note_unused_world(reading) for reading in found]
    _in_use(found[0] if found else as_it_is, np.zeros(3))  # raises where a grid is missing, before the long meshing
    return GeoreferenceCandidates(
        candidates=tuple(found),
        as_map_coordinates=as_it_is,
        accept_level=accept_level,
        true_north_deg=north,
        lower_levels=there_is,
    )


def select_georeference(readings: GeoreferenceCandidates, centre_ifc_m: Float64Array) -> ModelGeoreference:
    """The reading to go by, ``centre_ifc_m`` (3,) being the middle of the geometry; its remarks tell what was assumed.

    Raises GeoreferenceError where there is none, where it puts the middle outside its CRS, where the shift is in the
    geometry and in the conversion too, or where the place is good to metres alone and the registry does not accept it.
    """
    on_the_map = _has_map_coordinates(readings.as_map_coordinates, centre_ifc_m)
    possible = [reading for reading in readings.candidates if on_the_map or reading.level != "30"]
    if not possible:
        raise GeoreferenceError(
            f"the IFC is not georeferenced: it has no IfcMapConversion ({readings.lower_levels}); "
            "georeference it in the authoring tool, or give the registry's crs.placement "
            "(east_m, north_m, height_m, rotation_deg)"
        )
    for reading in possible:
        if reading.level == possible[0].level:
            _check_double_shift(reading, centre_ifc_m, on_the_map=on_the_map)
    best = _select_in_area_of_use(possible, centre_ifc_m)
    _check_accuracy(best, readings.accept_level)
    grid = compute_grid_factors(best.geo_from_ifc(centre_ifc_m[None])[0], best.map_crs, best.vertical_datum)
    notes = [
        best.remarks,
        _describe_grid_scale(best, grid),
        _describe_north_conflict(best, readings.true_north_deg, grid),
    ]
    said = "; ".join(filter(None, notes))
    if said:
        _log.info("georeference of the model: %s", said)
    return replace(best, remarks=said)


def _select_in_area_of_use(readings: Sequence[ModelGeoreference], centre_ifc_m: Float64Array) -> ModelGeoreference:
    """The first reading that puts ``centre_ifc_m`` (3,), the middle of the geometry, where its CRS is in use.

    Raises GeoreferenceError where none does.
    """
    for reading in readings:
        if _in_use(reading, centre_ifc_m):
            return reading
    horizontal = readings[0].map_crs
    place = readings[0].placement.map_from_ifc(centre_ifc_m[None])[0].round(1).tolist()
    raise GeoreferenceError(
        f"the model's middle comes to lie at east, north, height {place} m, outside the area where {horizontal} is in "
        f"use ({_name_area_of_use(horizontal)}); is the CRS the right one, are units mixed, or is the shift in the "
        "geometry and in IfcMapConversion too?"
    )


def _read_ifc_candidates(
    model: ifcopenshell.file, as_it_is: ModelGeoreference, site: GeographicAnchor | None, north_deg: float | None
) -> list[ModelGeoreference]:
    """Readings of what the IFC itself states, the best level first."""
    world = read_world_matrix(model)
    operation = read_coordinate_operation(model)
    if operation is not None:
        if world is not None:  # readers disagree on its direction
            raise GeoreferenceError(
                f"the IFC's WorldCoordinateSystem is shifted or turned (by {np.round(world[:3, 3], 3).tolist()}), and "
                "it has a map conversion too; programs read the two in different ways: export with the world "
                "coordinate system at zero, or give the registry's crs.placement"
            )
        return [
            replace(as_it_is, placement=place, level="50", remarks=said)
            for place, said in list_placements(model, operation, as_it_is.map_crs)
        ]
    found = [as_it_is]
    if world is not None and np.hypot(*world[:2, 3]) > _FAR_M:
        found.insert(0, _georeference_from_world(world, as_it_is, north_deg))
    if site is not None and _holds(as_it_is.map_crs, site.lon_deg, site.lat_deg, _BORDER_DEG):
        found.append(_georeference_from_globe(site, as_it_is, north_deg, "20"))
    return found


def _note_unused_world(reading: ModelGeoreference) -> ModelGeoreference:
    unused = "the IFC's WorldCoordinateSystem is shifted or turned and was not used"
    return replace(reading, remarks="; ".join(filter(None, [reading.remarks, unused])))


def _georeference_from_world(
    world: Float64Array, as_it_is: ModelGeoreference, north_deg: float | None
) -> ModelGeoreference:
    """LoGeoRef 40: the map's coordinates in WorldCoordinateSystem, turned by it or else by TrueNorth."""
    if abs(world[2, 2] - 1) > 1e-9:
        raise GeoreferenceError(
            "the IFC's WorldCoordinateSystem is tilted against the vertical, so the model would lean; export with the "
            "world coordinate system upright, or give the registry's crs.placement"
        )
    turn = float(np.degrees(np.arctan2(world[1, 0], world[0, 0])))
    said, sigma = f"placed by WorldCoordinateSystem, taken as map coordinates of {as_it_is.map_crs}", 0.0
    if turn == 0.0 and north_deg:
        turn = -north_deg
        if _in_use(as_it_is, world[:3, 3]):
            geo = as_it_is.geo_from_ifc(world[None, :3, 3])[0]
            apart = abs(compute_grid_factors(geo, as_it_is.map_crs, as_it_is.vertical_datum).true_east_deg)
            sigma = float(np.radians(apart) * _ARM_M)
            said += (
                f" and turned by TrueNorth as the grid's north; true north is {apart:.2f} deg from it here, "
                f"{sigma:.2f} m over {_ARM_M:g} m"
            )
    return replace(
        as_it_is,
        placement=MapPlacement(
            east_m=float(world[0, 3]), north_m=float(world[1, 3]), height_m=float(world[2, 3]), rotation_deg=turn
        ),
        level="40",
        remarks=said,
        sigma_m=sigma,
    )


def _georeference_from_globe(
    place: GeographicAnchor, as_it_is: ModelGeoreference, north_deg: float | None, level: str
) -> ModelGeoreference:
    turned_by = "the model's y axis taken as north" if north_deg is None else f"turned by TrueNorth {north_deg:.2f} deg"
    sure = f"; good to about {place.sigma_m:.0f} m, one sigma, as a whole" if place.sigma_m else ""
    return replace(
        as_it_is,
        placement=place_on_globe(place, as_it_is.map_crs, as_it_is.vertical_datum, north_deg),
        level=level,
        remarks=f"{place.remark}, {turned_by}{sure}",
        sigma_m=place.sigma_m,
    )


def _check_double_shift(reading: ModelGeoreference, centre_ifc_m: Float64Array, *, on_the_map: bool) -> None:
    """Raises where the geometry already has map coordinates and the placement shifts it as far once more."""
    place = reading.placement
    if not on_the_map or np.hypot(place.east_m, place.north_m) < _FAR_M:
        return
    if np.allclose(place.map_from_ifc(centre_ifc_m[None])[0], centre_ifc_m, rtol=0, atol=_FAR_M):
        return  # pairs that turn map coordinates a little shift their far zero by much
    raise GeoreferenceError(
        f"the model is shifted to the map twice: its geometry lies at {centre_ifc_m.round(1).tolist()} m, which are "
        f"map coordinates of {reading.map_crs}, and its placement adds east, north "
        f"{[round(place.east_m, 1), round(place.north_m, 1)]} m; export it with the shift in one of the two, or, if "
        "the geometry is right, give the registry's crs.placement {east_m: 0, north_m: 0, height_m: 0}"
    )


def _check_accuracy(reading: ModelGeoreference, accept_level: int | None) -> None:
    if reading.sigma_m <= _GOOD_M or (accept_level is not None and int(reading.level) >= accept_level):
        return
    raise GeoreferenceError(
        f"the model's place is LoGeoRef {reading.level}: {reading.remarks}; that is {reading.sigma_m:.2g} m, and "
        f"{_GOOD_M:g} m are needed to carry defects onto it; give the registry's crs.control (pairs of points of the "
        f"model and of the map) or crs.placement, or accept the level with crs.accept_level: {reading.level} and place "
        "the campaign by the model, not by control points"
    )


def _describe_grid_scale(reading: ModelGeoreference, grid: GridFactors) -> str:
    """That coordinates in placements are lengths on the map, which the grid stretches; empty for other levels."""
    if reading.level not in ("30", "40"):
        return ""
    return f"a metre of the model is a metre on the map, where a metre on the ground is {grid.combined_factor:.6f} m"


def _describe_north_conflict(reading: ModelGeoreference, north_deg: float | None, grid: GridFactors) -> str:
    """A conflict between TrueNorth and the turn that is used; empty where they agree with true or grid north."""
    if north_deg is None or reading.level in ("20", "40"):
        return ""
    by_grid = (-reading.placement.rotation_deg - north_deg + 180.0) % 360.0 - 180.0
    by_true = (by_grid + grid.true_east_deg + 180.0) % 360.0 - 180.0
    if min(abs(by_grid), abs(by_true)) <= _NORTH_APART_DEG:
        return ""
    return f"TrueNorth ({north_deg:.2f} deg from the model's y axis) is {abs(by_true):.2f} deg off and was not used"


def _has_map_coordinates(as_it_is: ModelGeoreference, centre_ifc_m: Float64Array) -> bool:
    """Whether the geometry's own coordinates are the map's: far from zero, and inside the CRS's area of use."""
    return bool(np.hypot(*centre_ifc_m[:2]) > _FAR_M) and _in_use(as_it_is, centre_ifc_m, border_deg=0.0)


def _in_use(georeference: ModelGeoreference, centre_ifc_m: Float64Array, *, border_deg: float = _BORDER_DEG) -> bool:
    try:
        lon, lat, _ = georeference.geo_from_ifc(centre_ifc_m[None])[0]
    except GeoreferenceError as error:
        if "domain" in str(error):
            return False
        raise
    return _holds(georeference.map_crs, float(lon), float(lat), border_deg)


def _holds(map_crs: str, lon: float, lat: float, b: float) -> bool:
    """Whether a place lies in the CRS's area of use, or up to ``b`` degrees beside it."""
    area = pyproj.CRS.from_user_input(map_crs).area_of_use
    if area is None:
        return True
    crosses = area.west > area.east  # the date line runs through the area
    in_lon = (lon >= area.west - b or lon <= area.east + b) if crosses else area.west - b <= lon <= area.east + b
    return bool(in_lon and area.south - b <= lat <= area.north + b)


def _name_area_of_use(crs: str) -> str:
    area = pyproj.CRS.from_user_input(crs).area_of_use
    return area.name.split(":")[0] if area else "area unknown"


def _describe_lower_levels(model: ifcopenshell.file, site: GeographicAnchor | None) -> str:
    """Lower levels of georeference the model has, for the message: none of them is exact enough."""
    if site is not None:
        return (
            f"it has IfcSite latitude and longitude alone, LoGeoRef 20, good to some {site.sigma_m:.0f} m: "
            "crs.accept_level: 20 would take them"
        )
    address = "; its address, LoGeoRef 10, is no place" if has_address(model) else ""
    return f"it has no IfcSite latitude and longitude either{address}"
