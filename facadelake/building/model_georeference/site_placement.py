"""Georeference of an IFC without a map conversion: LoGeoRef 10 to 40 (Clemen and Goerne 2019).

Level 10 is an address, 20 latitude and longitude of IfcSite, 30 map coordinates in placements, 40 map coordinates in
WorldCoordinateSystem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import ifcopenshell
import ifcopenshell.util.geolocation
import ifcopenshell.util.placement
import ifcopenshell.util.unit
import numpy as np
import pyproj

from facadelake.building.model_georeference.map_conversion import find_operation_entity, has_angular_coordinates
from facadelake.building.model_georeference.map_placement import (
    GridFactors,
    MapPlacement,
    compute_grid_factors,
    geo_from_map,
    place_upright,
)
from facadelake.core.arrays import Float64Array, Float64x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import GEO, transform

_MIN_SITE_SIGMA_M = 10.0  # authoring tools take the position from a map or an address, however many digits they write
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


def read_site_anchor(model: ifcopenshell.file) -> GeographicAnchor | None:
    """Read RefLatitude and RefLongitude of IfcSite, which refer to its placement's origin; None if not given."""
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    for site in model.by_type("IfcSite"):
        if not site.RefLatitude or not site.RefLongitude:
            continue
        lat, lon = _degrees_from_compound(site.RefLatitude), _degrees_from_compound(site.RefLongitude)
        if (lat, lon) == (0.0, 0.0) or abs(lat) > 90 or abs(lon) > 180:
            continue
        anchor = np.zeros(3)
        if site.ObjectPlacement is not None:
            anchor = ifcopenshell.util.placement.get_local_placement(site.ObjectPlacement)[:3, 3] * unit_m
        elevation = float(site.RefElevation or 0.0) * unit_m
        sigma = max(
            _MIN_SITE_SIGMA_M,
            _estimate_rounding_m(site.RefLatitude) / np.sqrt(12),
            _estimate_rounding_m(site.RefLongitude) / np.sqrt(12),
        )
        no_elevation = "" if site.RefElevation is not None else " (no RefElevation, height 0 is assumed)"
        return GeographicAnchor(
            lon_deg=lon,
            lat_deg=lat,
            height_m=elevation,
            anchor_ifc_m=anchor,
            sigma_m=float(sigma),
            remark=f"placed by latitude {lat:.6f} and longitude {lon:.6f} of IfcSite{no_elevation}",
        )
    return None


def read_geographic_operation(model: ifcopenshell.file) -> GeographicAnchor | None:
    """Read an IfcRigidOperation (IFC4.3) with coordinates in degrees; None if there is none.

    Raises GeoreferenceError if its target is not a geographic CRS that PROJ knows.
    """
    entity = find_operation_entity(model)
    if entity is None or not entity.is_a("IfcRigidOperation") or not has_angular_coordinates(entity):
        return None
    name = entity.TargetCRS.Name or ""
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
    unit_deg = float(np.degrees(ifcopenshell.util.unit.calculate_unit_scale(model, "PLANEANGLEUNIT")))
    coordinates = [entity.FirstCoordinate.wrappedValue * unit_deg, entity.SecondCoordinate.wrappedValue * unit_deg]
    lat_first = crs.axis_info[0].direction in ("north", "south")
    lon, lat = coordinates[::-1] if lat_first else coordinates
    lon, lat = transform(np.array([[lon, lat, 0.0]]), name, GEO)[0, :2]
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    order = "latitude first" if lat_first else "longitude first"
    return GeographicAnchor(
        lon_deg=float(lon),
        lat_deg=float(lat),
        height_m=float(entity.Height or 0.0) * unit_m,
        anchor_ifc_m=np.zeros(3),
        sigma_m=0.0,
        remark=f"placed by IfcRigidOperation in {name}, {order} by the axis order of that CRS",
    )


def place_on_globe(
    anchor: GeographicAnchor, map_crs: str, vertical_datum: str, north_deg: float | None
) -> MapPlacement:
    """Place the model upright, in metres on the ground, with its anchor at the anchor's position.

    Args:
        anchor: the point of the model and its position.
        map_crs: projected CRS of the placement.
        vertical_datum: "ellipsoidal" or a vertical CRS, of the anchor's height and of the placement.
        north_deg: direction of true north in the model (see ``read_true_north_deg``); None: its y axis.
    """
    ground = compute_grid_factors(np.array([anchor.lon_deg, anchor.lat_deg, 0.0]), map_crs, vertical_datum)
    map_m = np.array([[ground.map_m[0], ground.map_m[1], anchor.height_m]])
    at_height = compute_grid_factors(geo_from_map(map_m, map_crs, vertical_datum)[0], map_crs, vertical_datum)
    grid = GridFactors(map_m=map_m[0], true_east_deg=at_height.true_east_deg, combined_factor=at_height.combined_factor)
    return place_upright(grid, anchor_ifc_m=anchor.anchor_ifc_m, x_axis_deg=-(north_deg or 0.0))


def read_true_north_deg(model: ifcopenshell.file) -> float | None:
    """Read the angle from the model's y axis anticlockwise to true north, -180 to 180; None if not given."""
    for context in model.by_type("IfcGeometricRepresentationContext", include_subtypes=False):
        if context.ContextType == "Model" and context.TrueNorth is not None:
            x, y = context.TrueNorth.DirectionRatios[:2]
            if x or y:
                return round(float(np.degrees(np.arctan2(-x, y))), 9) + 0.0  # -0.0 becomes 0.0
    return None


def read_world_matrix(model: ifcopenshell.file) -> Float64Array | None:
    """Read WorldCoordinateSystem of the model's context as a matrix (4, 4) in metres; None if it is the identity."""
    world = ifcopenshell.util.geolocation.get_wcs(model)
    if world is None or np.allclose(world, np.eye(4), rtol=0, atol=1e-6):
        return None
    metres: Float64Array = np.array(world, dtype=np.float64)
    metres[:3, 3] *= float(ifcopenshell.util.unit.calculate_unit_scale(model))
    return metres


def has_address(model: ifcopenshell.file) -> bool:
    """Whether the building or the site has a postal address (LoGeoRef 10)."""
    buildings = [building.BuildingAddress for building in model.by_type("IfcBuilding")]
    return any(address is not None for address in buildings + [site.SiteAddress for site in model.by_type("IfcSite")])


def utm_from_lon_lat(lon_deg: float, lat_deg: float) -> str:
    """EPSG code of the UTM zone (WGS 84) of a point."""
    zone = min(int((lon_deg + 180) // 6) + 1, 60)
    return f"EPSG:{(32600 if lat_deg >= 0 else 32700) + zone}"


def _degrees_from_compound(parts: Sequence[int]) -> float:
    """Degrees from IfcCompoundPlaneAngleMeasure: degrees, minutes, seconds, millionths of a second, all of one sign."""
    sign = -1.0 if any(part < 0 for part in parts) else 1.0
    return sign * sum(abs(part) / unit for part, unit in zip(parts, (1.0, 60.0, 3600.0, 3.6e9), strict=False))


def _estimate_rounding_m(parts: Sequence[int]) -> float:
    """Rounding step of an angle of degrees, minutes, seconds, millionths of a second, on the ground in metres."""
    if len(parts) > 3 and parts[3]:
        return 0.0
    if len(parts) > 2 and parts[2]:
        return _ARC_SECOND_M
    return 60 * _ARC_SECOND_M
