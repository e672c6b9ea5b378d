"""What an IFC without a map conversion says of its place: LoGeoRef 10 to 40 (Clemen and Goerne 2019).

10 an address, 20 IfcSite's latitude and longitude, 30 map coordinates in placements, 40 in WorldCoordinateSystem.
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
from facadelake.core.arrays import Float64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import GEO, transform

_MIN_SITE_SIGMA_M = 10.0  # authoring tools take the place from a map or an address, whatever digits they write
_ARC_SECOND_M = 31.0  # a second of arc on the meridian


@dataclass(frozen=True, kw_only=True)
class GeographicAnchor:
    """A point of the model on the globe, and its height in the model's vertical datum.

    ``sigma_m`` is 0 where a surveyor's word stands behind it.
    """

    lon_deg: float
    lat_deg: float
    height_m: float
    anchor_ifc_m: Float64Array
    sigma_m: float
    remark: str


def read_site_anchor(model: ifcopenshell.file) -> GeographicAnchor | None:
    """The place of an IfcSite with RefLatitude and RefLongitude, which are of its placement's origin; None without."""
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
        without = "" if site.RefElevation is not None else ", no RefElevation, so the site's zero is taken at height 0"
        return GeographicAnchor(
            lon_deg=lon,
            lat_deg=lat,
            height_m=elevation,
            anchor_ifc_m=anchor,
            sigma_m=float(sigma),
            remark=f"placed by IfcSite's latitude {lat:.6f} and longitude {lon:.6f}{without}",
        )
    return None


def read_geographic_operation(model: ifcopenshell.file) -> GeographicAnchor | None:
    """An IfcRigidOperation (IFC4.3) that counts in degrees, as a place; None where there is none.

    Raises GeoreferenceError where its CRS is not a geographic one that PROJ knows.
    """
    entity = find_operation_entity(model)
    if entity is None or not entity.is_a("IfcRigidOperation") or not has_angular_coordinates(entity):
        return None
    name = entity.TargetCRS.Name or ""
    try:
        crs = pyproj.CRS.from_user_input(name)
    except pyproj.exceptions.CRSError as error:
        raise GeoreferenceError(
            f"IfcRigidOperation leads to '{name}', which PROJ does not know; name a geographic CRS such as EPSG:4326, "
            "or give the registry's crs.map and crs.placement"
        ) from error
    if not crs.is_geographic:
        raise GeoreferenceError(
            f"IfcRigidOperation counts in degrees, but {name} is not a geographic CRS; correct one of them, or give "
            "the registry's crs.placement"
        )
    to_deg = float(np.degrees(ifcopenshell.util.unit.calculate_unit_scale(model, "PLANEANGLEUNIT")))
    pair = [entity.FirstCoordinate.wrappedValue * to_deg, entity.SecondCoordinate.wrappedValue * to_deg]
    lat_first = crs.axis_info[0].direction in ("north", "south")
    lon, lat = pair[::-1] if lat_first else pair
    lon, lat = transform(np.array([[lon, lat, 0.0]]), name, GEO)[0, :2]
    unit_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    order = "latitude first" if lat_first else "longitude first"
    return GeographicAnchor(
        lon_deg=float(lon),
        lat_deg=float(lat),
        height_m=float(entity.Height or 0.0) * unit_m,
        anchor_ifc_m=np.zeros(3),
        sigma_m=0.0,
        remark=f"placed by IfcRigidOperation in {name}, {order} as that CRS orders its axes",
    )


def place_on_globe(place: GeographicAnchor, map_crs: str, vertical_datum: str, north_deg: float | None) -> MapPlacement:
    """The model upright at ``place``, its true north at ``north_deg`` (see ``read_true_north_deg``)."""
    grid = compute_grid_factors(np.array([place.lon_deg, place.lat_deg, 0.0]), map_crs, vertical_datum)
    there = np.array([[grid.map_m[0], grid.map_m[1], place.height_m]])
    at_height = compute_grid_factors(geo_from_map(there, map_crs, vertical_datum)[0], map_crs, vertical_datum)
    exact = GridFactors(
        map_m=there[0], true_east_deg=at_height.true_east_deg, combined_factor=at_height.combined_factor
    )
    return place_upright(exact, anchor_ifc_m=place.anchor_ifc_m, x_axis_deg=-(north_deg or 0.0))


def read_true_north_deg(model: ifcopenshell.file) -> float | None:
    """Angle from the model's y axis anticlockwise to true north, -180 to 180; None where the IFC does not say."""
    for context in model.by_type("IfcGeometricRepresentationContext", include_subtypes=False):
        if context.ContextType == "Model" and context.TrueNorth is not None:
            x, y = context.TrueNorth.DirectionRatios[:2]
            if x or y:
                return round(float(np.degrees(np.arctan2(-x, y))), 9) + 0.0  # no minus zero
    return None


def read_world_matrix(model: ifcopenshell.file) -> Float64Array | None:
    """The model context's WorldCoordinateSystem (4, 4) in metres; None where it is the identity."""
    world = ifcopenshell.util.geolocation.get_wcs(model)
    if world is None or np.allclose(world, np.eye(4), rtol=0, atol=1e-6):
        return None
    metres: Float64Array = np.array(world, dtype=np.float64)
    metres[:3, 3] *= float(ifcopenshell.util.unit.calculate_unit_scale(model))
    return metres


def has_address(model: ifcopenshell.file) -> bool:
    """Whether a postal address is given (LoGeoRef 10), which places nothing but names the street."""
    buildings = [building.BuildingAddress for building in model.by_type("IfcBuilding")]
    return any(address is not None for address in buildings + [site.SiteAddress for site in model.by_type("IfcSite")])


def utm_from_lon_lat(lon_deg: float, lat_deg: float) -> str:
    """The UTM zone (WGS 84) of a place."""
    zone = min(int((lon_deg + 180) // 6) + 1, 60)
    return f"EPSG:{(32600 if lat_deg >= 0 else 32700) + zone}"


def _degrees_from_compound(parts: Sequence[int]) -> float:
    """IfcCompoundPlaneAngleMeasure: degrees, minutes, seconds and millionths of a second, all of one sign."""
    sign = -1.0 if any(part < 0 for part in parts) else 1.0
    return sign * sum(abs(part) / unit for part, unit in zip(parts, (1.0, 60.0, 3600.0, 3.6e9), strict=False))


def _estimate_rounding_m(parts: Sequence[int]) -> float:
    """What the angle seems to be rounded to, metres."""
    if len(parts) > 3 and parts[3]:
        return 0.0
    if len(parts) > 2 and parts[2]:
        return _ARC_SECOND_M
    return 60 * _ARC_SECOND_M
