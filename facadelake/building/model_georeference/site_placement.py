"""Georeference of an IFC without a map conversion: LoGeoRef 10 to 40 (Clemen and Goerne 2019).

Level 10 is an address, 20 latitude and longitude of IfcSite, 30 map coordinates in placements, 40 map coordinates in
WorldCoordinateSystem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.placement
import ifcopenshell.util.unit
import numpy as np
import pyproj

from facadelake.building.model_georeference.ifc_statements import (
    find_operation_entity,
    has_angular_coordinates,
    read_number,
    require_number,
)
from facadelake.building.model_georeference.length_units import measure_unit, read_project_unit
from facadelake.building.model_georeference.map_placement import (
    GridFactors,
    MapPlacement,
    compute_grid_factors,
    geo_from_map,
    place_upright,
)
from facadelake.core.arrays import Float64Array, Float64x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import transform
from facadelake.core.proj.crs import GEO, check_area_of_use

_MIN_SITE_SIGMA_M = 10.0  # authoring tools take the position from a map or an address, however many digits they write
_SAME_NORTH_DEG = 0.01  # 1 cm over a facade of 50 m
_SAME_PLACE_M = 1e-6
_ARC_SECOND_M = 31.0  # a second of arc on the meridian


@dataclass(frozen=True, kw_only=True)
class GeographicAnchor:
    """A point of the model on the globe, and its height in the model's vertical datum.

    ``anchor_ifc_m`` (3,): the point in the model's axes. ``sigma_m``: standard deviation of the position, 0 for a
    surveyed point. ``remark`` names the source.
    """

    lon_deg: float
    lat_deg: float
    height_m: float
    anchor_ifc_m: Float64x3
    sigma_m: float
    remark: str


def read_site_anchor(model: ifcopenshell.file) -> tuple[GeographicAnchor | None, str]:
    """Read RefLatitude and RefLongitude of IfcSite, which refer to its placement's origin.

    Returns the position, None if not given, and a conflict: what makes it unusable, empty if nothing.
    """
    unit_m = read_project_unit(model).metres
    anchors: list[GeographicAnchor] = []
    for site in model.by_type("IfcSite"):
        if not site.RefLatitude or not site.RefLongitude:
            continue
        try:
            lat, lon = _degrees_from_compound(site.RefLatitude), _degrees_from_compound(site.RefLongitude)
        except GeoreferenceError as error:
            return None, str(error)
        if (lat, lon) == (0.0, 0.0):
            continue
        if abs(lat) > 90 or abs(lon) > 180:
            exchanged = "; the two may be exchanged" if abs(lon) <= 90 and abs(lat) <= 180 else ""
            return None, f"IfcSite has latitude {lat:.6f} and longitude {lon:.6f}, which is no place{exchanged}"
        anchors.append(_anchor_site(site, lon, lat, unit_m))
    if not anchors:
        return None, ""
    places = sorted({(anchor.lat_deg, anchor.lon_deg) for anchor in anchors})
    if len(places) > 1:
        listed = ", ".join(f"{lat:.6f} {lon:.6f}" for lat, lon in places[:4])
        return anchors[0], f"the IFC's sites have different latitudes and longitudes ({listed})"
    return anchors[0], ""


def _anchor_site(site: ifcopenshell.entity_instance, lon_deg: float, lat_deg: float, unit_m: float) -> GeographicAnchor:
    anchor = np.zeros(3)
    if site.ObjectPlacement is not None:
        anchor = ifcopenshell.util.placement.get_local_placement(site.ObjectPlacement)[:3, 3] * unit_m
    sigma = max(
        _MIN_SITE_SIGMA_M,
        _estimate_rounding_m(site.RefLatitude) / np.sqrt(12),
        _estimate_rounding_m(site.RefLongitude) / np.sqrt(12),
    )
    elevation = read_number(site, "RefElevation")
    no_elevation = "" if elevation is not None else " (no RefElevation, height 0 is assumed)"
    return GeographicAnchor(
        lon_deg=lon_deg,
        lat_deg=lat_deg,
        height_m=(elevation or 0.0) * unit_m,
        anchor_ifc_m=anchor,
        sigma_m=float(sigma),
        remark=f"placed by latitude {lat_deg:.6f} and longitude {lon_deg:.6f} of IfcSite{no_elevation}",
    )


def read_geographic_operation(model: ifcopenshell.file) -> GeographicAnchor | None:
    """Read an IfcRigidOperation (IFC4.3) with coordinates in degrees; None if there is none.

    Raises GeoreferenceError if its target is not a geographic CRS that PROJ knows, or its coordinates lie outside the
    area of use of that CRS.
    """
    entity = find_operation_entity(model)
    if entity is None or not entity.is_a("IfcRigidOperation") or not has_angular_coordinates(entity):
        return None
    name = getattr(entity.TargetCRS, "Name", None) or ""
    try:
        crs = pyproj.CRS.from_user_input(name)
    except pyproj.exceptions.CRSError as error:
        raise GeoreferenceError(
            f"the target CRS of IfcRigidOperation is '{name}', which PROJ does not know; use a geographic CRS such as "
            "EPSG:4326, or set crs.map and crs.placement in the portfolio"
        ) from error
    if not crs.is_geographic:
        raise GeoreferenceError(
            f"IfcRigidOperation has coordinates in degrees, but {name} is not a geographic CRS; correct one of them, "
            "or set crs.placement in the portfolio"
        )
    unit_deg = _read_angle_unit_deg(model)
    coordinates = [require_number(entity, key) * unit_deg for key in ("FirstCoordinate", "SecondCoordinate")]
    lat_first = crs.axis_info[0].direction in ("north", "south")
    lon, lat = coordinates[::-1] if lat_first else coordinates
    order = "latitude first" if lat_first else "longitude first"
    try:
        check_area_of_use(np.array([[lon, lat]]), name)
    except GeoreferenceError as error:
        raise GeoreferenceError(
            f"IfcRigidOperation gives {coordinates[0]:.6f} and {coordinates[1]:.6f} degrees, {order} by the axis order "
            f"of {name}: {error}; correct it, or set crs.placement in the portfolio"
        ) from error
    lon, lat = transform(np.array([[lon, lat, 0.0]]), name, GEO)[0, :2]
    return GeographicAnchor(
        lon_deg=float(lon),
        lat_deg=float(lat),
        height_m=(read_number(entity, "Height") or 0.0) * _read_height_unit_m(model, entity),
        anchor_ifc_m=np.zeros(3),
        sigma_m=0.0,
        remark=f"placed by IfcRigidOperation in {name}, {order} by the axis order of that CRS",
    )


def _read_angle_unit_deg(model: ifcopenshell.file) -> float:
    """Degrees per unit of plane angle of the project; the radian, as the standard defines, if none is stated."""
    units = {}
    for project in model.by_type("IfcProject"):
        for unit in project.UnitsInContext.Units if getattr(project, "UnitsInContext", None) else ():
            if getattr(unit, "UnitType", None) == "PLANEANGLEUNIT":
                try:
                    units[round(float(ifcopenshell.util.unit.get_named_unit_scale(unit)), 12)] = unit.Name
                except (AttributeError, TypeError, ValueError, KeyError, RuntimeError) as error:
                    raise GeoreferenceError(
                        f"the ConversionFactor of the unit of plane angle cannot be read ({error}); correct it"
                    ) from error
    if len(units) > 1:
        raise GeoreferenceError(
            f"the IFC states several units of plane angle ({', '.join(units.values())}), so the degrees of "
            "IfcRigidOperation are unknown; keep one in IfcUnitAssignment, or set crs.placement in the portfolio"
        )
    return float(np.degrees(next(iter(units), 1.0)))


def _read_height_unit_m(model: ifcopenshell.file, entity: ifcopenshell.entity_instance) -> float:
    """Metres per unit of Height: the unit of length of the project, for a geographic CRS has no MapUnit in metres."""
    unit = getattr(entity.TargetCRS, "MapUnit", None)
    if unit is not None and getattr(unit, "UnitType", None) == "LENGTHUNIT":
        return measure_unit(unit).metres
    return read_project_unit(model).metres


def place_on_globe(
    anchor: GeographicAnchor, map_crs: str, vertical_datum: str, north_deg: float | None
) -> MapPlacement:
    """Place the model upright, in metres on the ground, with its anchor at the anchor's position.

    Args:
        anchor: the point of the model and its position.
        map_crs: projected CRS of the placement.
        vertical_datum: "ellipsoidal" or a vertical CRS, of the anchor's height and of the placement.
        north_deg: direction of true north in the model (see ``read_true_norths_deg``); None: its y axis.
    """
    ground = compute_grid_factors(np.array([anchor.lon_deg, anchor.lat_deg, 0.0]), map_crs, vertical_datum)
    map_m = np.array([[ground.map_m[0], ground.map_m[1], anchor.height_m]])
    at_height = compute_grid_factors(geo_from_map(map_m, map_crs, vertical_datum)[0], map_crs, vertical_datum)
    grid = GridFactors(map_m=map_m[0], true_east_deg=at_height.true_east_deg, combined_factor=at_height.combined_factor)
    return place_upright(grid, anchor_ifc_m=anchor.anchor_ifc_m, x_axis_deg=-(north_deg or 0.0))


def read_true_norths_deg(model: ifcopenshell.file) -> tuple[float, ...]:
    """Read the angles from the model's y axis anticlockwise to true north, -180 to 180, that its contexts state."""
    found = []
    for context in model.by_type("IfcGeometricRepresentationContext", include_subtypes=False):
        if context.ContextType == "Model" and context.TrueNorth is not None:
            x, y = context.TrueNorth.DirectionRatios[:2]
            if x or y:
                found.append(round(float(np.degrees(np.arctan2(-x, y))), 9) + 0.0)  # -0.0 becomes 0.0
    distinct: list[float] = []
    for angle in found:
        if all(abs((angle - one + 180) % 360 - 180) > _SAME_NORTH_DEG for one in distinct):
            distinct.append(angle)
    return tuple(distinct)


def read_world_matrices(model: ifcopenshell.file) -> list[Float64Array]:
    """Read the distinct WorldCoordinateSystems of the model's contexts as matrices (4, 4) in metres.

    Identities are omitted where no other is stated. Raises GeoreferenceError for one that is no placement.
    """
    unit_m = read_project_unit(model).metres
    found: list[Float64Array] = []
    contexts = model.by_type("IfcGeometricRepresentationContext", include_subtypes=False)
    for context in [one for one in contexts if one.ContextType == "Model"] or contexts:
        if context.WorldCoordinateSystem is None:
            continue
        try:
            matrix = ifcopenshell.util.placement.get_axis2placement(context.WorldCoordinateSystem)
            world = np.array(matrix, dtype=np.float64)
        except (AttributeError, TypeError, ValueError, IndexError, RuntimeError) as error:
            raise GeoreferenceError(
                f"the IFC's WorldCoordinateSystem cannot be read ({error}); export it again, or set crs.placement in "
                "the portfolio"
            ) from error
        if not np.isfinite(world).all():
            raise GeoreferenceError(
                "the IFC's WorldCoordinateSystem has an axis without a direction; export it again, or set "
                "crs.placement in the portfolio"
            )
        world[:3, 3] *= unit_m
        if all(not np.allclose(world, one, rtol=0, atol=_SAME_PLACE_M) for one in found):
            found.append(world)
    is_identity = len(found) == 1 and np.allclose(found[0], np.eye(4), rtol=0, atol=_SAME_PLACE_M)
    return [] if is_identity else found


def has_address(model: ifcopenshell.file) -> bool:
    """Whether the building or the site has a postal address (LoGeoRef 10)."""
    buildings = [building.BuildingAddress for building in model.by_type("IfcBuilding")]
    return any(address is not None for address in buildings + [site.SiteAddress for site in model.by_type("IfcSite")])


def utm_from_lon_lat(lon_deg: float, lat_deg: float) -> str:
    """EPSG code of the UTM zone (WGS 84) of a point."""
    zone = min(int((lon_deg + 180) // 6) + 1, 60)
    return f"EPSG:{(32600 if lat_deg >= 0 else 32700) + zone}"


def _degrees_from_compound(parts: Sequence[int]) -> float:
    """Degrees from IfcCompoundPlaneAngleMeasure: degrees, minutes, seconds, millionths of a second, all of one sign.

    Some exporters give the sign to the degrees alone. Raises GeoreferenceError for parts that are no angle.
    """
    first, rest = parts[0], [abs(part) for part in parts[1:]]
    later_sign = any(part < 0 for part in parts[1:]) and first > 0
    if later_sign or any(part >= limit for part, limit in zip(rest, (60, 60, 1_000_000), strict=False)):
        raise GeoreferenceError(
            f"IfcSite has the angle {tuple(parts)}, which is not degrees, minutes, seconds and millionths of one sign"
        )
    sign = -1.0 if any(part < 0 for part in parts) else 1.0
    return sign * sum(abs(part) / unit for part, unit in zip(parts, (1.0, 60.0, 3600.0, 3.6e9), strict=False))


def _estimate_rounding_m(parts: Sequence[int]) -> float:
    """Rounding step of an angle of degrees, minutes, seconds, millionths of a second, on the ground in metres."""
    if len(parts) > 3 and parts[3]:
        return 0.0
    if len(parts) > 2 and parts[2]:
        return _ARC_SECOND_M
    return 60 * _ARC_SECOND_M
