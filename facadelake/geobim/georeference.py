"""Where an IFC stands on the map: IfcMapConversion, IfcProjectedCRS, their IFC2x3 property sets, or the registry.

Source: ISO 16739-1 (IFC 4 and 4.3), buildingSMART "User guide for geo-referencing in IFC" (the IFC2x3 sets),
LoGeoRef (Clemen and Goerne 2019). Nothing is guessed in silence: what had to be assumed is said in ``remarks``.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import ifcopenshell
import ifcopenshell.util.element
import ifcopenshell.util.geolocation
import ifcopenshell.util.unit
import numpy as np
import pyproj

from facadelake.errors import GeoreferenceError
from facadelake.frames import Array
from facadelake.geobim.vertical import ELLIPSOIDAL, horizontal_and_vertical, vertical_named
from facadelake.geodesy import GEO, as_3d, transform

__all__ = ["ELLIPSOIDAL", "Georeference", "MapPlacement", "georeferences_of", "the_one_in_use"]

_log = logging.getLogger(__name__)
_SCALE_LIMIT = 0.1  # a grid factor beyond 1 +- this is a wrong unit, not a projection
_BORDER_DEG = 1.0  # how far outside a CRS's area of use a building may stand


@dataclass(frozen=True, kw_only=True)
class MapPlacement:
    """Where the model's origin lies on the map, all in metres.

    ``rotation_deg`` turns map east anticlockwise into the model's x axis; ``scale`` holds metres on the map for a
    metre in the model along x, y, z.
    """

    east_m: float
    north_m: float
    height_m: float
    rotation_deg: float = 0.0
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def map_from_ifc(self, xyz_ifc_m: Array) -> Array:
        """Model points (n, 3) as east, north, height (n, 3), metres."""
        angle = np.radians(self.rotation_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        scaled = np.asarray(xyz_ifc_m, dtype=np.float64) * np.array(self.scale)
        moved: Array = scaled @ turn.T + np.array([self.east_m, self.north_m, self.height_m])
        return moved


@dataclass(frozen=True, kw_only=True)
class Georeference:
    """A model's placement with its CRS ("EPSG:25832") and vertical datum ("ellipsoidal" or "EPSG:7837")."""

    placement: MapPlacement
    map_crs: str
    vertical_datum: str
    level: str
    remarks: str

    def geo_from_ifc(self, xyz_ifc_m: Array) -> Array:
        """Model points (n, 3) in EPSG:4979 (n, 3: lon_deg, lat_deg, height_ellipsoidal_m)."""
        return _geo_from_map(self.placement.map_from_ifc(xyz_ifc_m), self.map_crs, self.vertical_datum)


def _geo_from_map(map_m: Array, map_crs: str, vertical_datum: str) -> Array:
    """Map points in metres (n, 3) in EPSG:4979, whatever unit the CRS counts in."""
    whole = map_crs if vertical_datum == ELLIPSOIDAL else f"{map_crs}+{vertical_datum.removeprefix('EPSG:')}"
    units = np.array([axis.unit_conversion_factor for axis in as_3d(whole).axis_info])
    return transform(map_m / units, whole, GEO)


def georeferences_of(
    model: ifcopenshell.file, *, map_crs: str | None, vertical_datum: str | None, placement: MapPlacement | None
) -> list[Georeference]:
    """Readings of the model's georeference, the standard's first; what the caller gives goes before what the IFC says.

    Raises GeoreferenceError where the map placement, the CRS or the vertical datum is neither in the IFC nor given,
    or where PROJ lacks a grid for them.
    """
    stated_crs, stated_vertical = _stated_crs(model)
    if map_crs is None and stated_crs is None:
        raise GeoreferenceError(
            f"the IFC names no projected CRS ({_what_there_is(model)}); "
            "write IfcProjectedCRS into it, or give the registry's crs.map, such as EPSG:25832"
        )
    horizontal, by_crs = horizontal_and_vertical(map_crs or stated_crs or "")
    vertical = vertical_datum and vertical_named(vertical_datum)
    vertical = vertical or by_crs or (stated_vertical and vertical_named(stated_vertical))
    if not vertical:
        raise GeoreferenceError(
            f"neither the IFC nor the registry says what the model's heights refer to (CRS {horizontal}); give the "
            "registry's crs.vertical: 'ellipsoidal', or a vertical CRS such as EPSG:5783 (DHHN92)"
        )
    places = [(placement, "", "registry")] if placement else [(p, said, "50") for p, said in _stated(model, horizontal)]
    if not places:
        raise GeoreferenceError(
            f"the IFC is not georeferenced: it has no IfcMapConversion ({_what_there_is(model)}); "
            "georeference it in the authoring tool, or give the registry's crs.placement "
            "(east_m, north_m, height_m, rotation_deg)"
        )
    readings = [
        Georeference(placement=place, map_crs=horizontal, vertical_datum=vertical, level=level, remarks=said)
        for place, said, level in places
    ]
    _in_use(readings[0], np.zeros(3))  # raises where a grid is missing, before the long work of meshing
    return readings


def the_one_in_use(readings: list[Georeference], centre_ifc_m: Array) -> Georeference:
    """The first reading that puts ``centre_ifc_m`` (3,), the middle of the geometry, where its CRS is in use.

    Raises GeoreferenceError where none does.
    """
    for reading in readings:
        if _in_use(reading, centre_ifc_m):
            if reading.remarks:
                _log.info("georeference of the model: %s", reading.remarks)
            return reading
    horizontal = readings[0].map_crs
    found = readings[0].placement.map_from_ifc(centre_ifc_m[None])[0].round(1).tolist()
    raise GeoreferenceError(
        f"the model's middle comes to lie at east, north, height {found} m, outside the area where {horizontal} is in "
        f"use ({_area_text(horizontal)}); is the CRS the right one, are units mixed, or is the shift in the "
        "geometry and in IfcMapConversion too?"
    )


def _stated_crs(model: ifcopenshell.file) -> tuple[str | None, str | None]:
    """Name of the projected CRS and what is said of heights, as the IFC states them."""
    if model.schema == "IFC2X3":
        values = _pset_2x3(model, "ePSet_ProjectedCRS")
    else:
        found = [op.TargetCRS for op in model.by_type("IfcCoordinateOperation")] or model.by_type("IfcProjectedCRS")
        values = found[0].get_info(recursive=False) if found else {}
    vertical = values.get("VerticalDatum")
    description = values.get("Description") or ""
    if not vertical and "ellipsoid" in description.lower():
        vertical = ELLIPSOIDAL
    return values.get("Name") or None, vertical or None


def _stated(model: ifcopenshell.file, horizontal: str) -> Iterator[tuple[MapPlacement, str]]:
    """Readings of the map conversion, the standard's first; each with what it assumes beyond the standard.

    Exporters differ in what ``Scale`` and an omitted ``MapUnit`` mean, so a reading must give a metre scale near 1.
    """
    helmert = None
    if model.schema == "IFC2X3":
        values = _pset_2x3(model, "ePSet_MapConversion")
        if values:
            helmert = ifcopenshell.util.geolocation.HelmertTransformation(
                *(float(values.get(name) or 0) for name in ("Eastings", "Northings", "OrthogonalHeight")),
                *(float(values.get(name) or 0) for name in ("XAxisAbscissa", "XAxisOrdinate")),
                float(values.get("Scale") or 1), 1.0, 1.0, 1.0,
            )  # fmt: skip
    else:
        helmert = ifcopenshell.util.geolocation.get_helmert_transformation_parameters(model)
    if helmert is None:
        return
    _refuse_shifted_world(model)
    project_m = float(ifcopenshell.util.unit.calculate_unit_scale(model))
    stated_m = _map_unit_m(model)
    crs_m = float(as_3d(horizontal).axis_info[0].unit_conversion_factor)
    unit_readings = [(stated_m, "")] if stated_m else [(project_m, "")]
    if not stated_m and abs(crs_m - project_m) > 1e-9:
        unit_readings.append((crs_m, f"MapUnit is not given; the unit of {horizontal} was taken"))
    for unit_m, said in unit_readings:
        for metre_scale, scale_said in (
            (helmert.scale * unit_m / project_m, ""),
            (helmert.scale, "Scale was taken as a factor between metres, for it does not hold the units' ratio"),
        ):
            if abs(metre_scale - 1) <= _SCALE_LIMIT:
                grid_said = f"Scale is taken as the map's grid factor {metre_scale:.6f}, of east and north alone"
                remarks = (said, scale_said, grid_said if abs(metre_scale - 1) > 1e-9 else "")
                yield _placement(helmert, unit_m, metre_scale), "; ".join(filter(None, remarks))
                break


def _refuse_shifted_world(model: ifcopenshell.file) -> None:
    """Raises where the context's WorldCoordinateSystem is not the identity: readers disagree on its direction."""
    world = ifcopenshell.util.geolocation.get_wcs(model)
    if world is not None and not np.allclose(world, np.eye(4), rtol=0, atol=1e-6):
        raise GeoreferenceError(
            f"the IFC's WorldCoordinateSystem is shifted or turned (by {np.round(world[:3, 3], 3).tolist()}), and "
            "it has a map conversion too; programs read the two in different ways: export with the world coordinate "
            "system at zero, or give the registry's crs.placement"
        )


def _placement(helmert: Any, unit_m: float, metre_scale: float) -> MapPlacement:
    abscissa, ordinate = (helmert.xaa, helmert.xao) if helmert.xaa or helmert.xao else (1.0, 0.0)
    factors = (helmert.factor_x, helmert.factor_y, helmert.factor_z)
    return MapPlacement(
        east_m=helmert.e * unit_m,
        north_m=helmert.n * unit_m,
        height_m=helmert.h * unit_m,
        rotation_deg=float(np.degrees(np.arctan2(ordinate, abscissa))),
        # What is left of Scale once units are taken out is the projection's grid factor: maps stretch, heights do not.
        scale=(metre_scale * factors[0], metre_scale * factors[1], factors[2]),
    )


def _map_unit_m(model: ifcopenshell.file) -> float | None:
    """Metres of IfcProjectedCRS.MapUnit; None where it is not given."""
    if model.schema == "IFC2X3":
        name = str(_pset_2x3(model, "ePSet_ProjectedCRS").get("MapUnit") or "").upper()
        return {"METRE": 1.0, "METER": 1.0, "M": 1.0, "MILLIMETRE": 0.001, "MM": 0.001, "FOOT": 0.3048}.get(name)
    for crs in model.by_type("IfcProjectedCRS"):
        if crs.MapUnit is not None:
            return float(
                ifcopenshell.util.unit.convert_unit(
                    1.0, crs.MapUnit, model.create_entity("IfcSIUnit", None, "LENGTHUNIT", None, "METRE")
                )
            )
    return None


def _pset_2x3(model: ifcopenshell.file, name: str) -> dict[str, Any]:
    """A property set of the project or, as the user guide has it, of the site; empty where there is none."""
    for holder in [*model.by_type("IfcProject"), *model.by_type("IfcSite")]:
        for found, values in ifcopenshell.util.element.get_psets(holder, psets_only=True).items():
            if found.lower() == name.lower():  # exporters write ePset and ePSet
                return dict(values)
    return {}


def _in_use(georeference: Georeference, centre_ifc_m: Array) -> bool:
    try:
        lon, lat, _ = georeference.geo_from_ifc(centre_ifc_m[None])[0]
    except GeoreferenceError as error:
        if "domain" in str(error):
            return False
        raise
    area = pyproj.CRS.from_user_input(georeference.map_crs).area_of_use
    if area is None:
        return True
    b = _BORDER_DEG
    crosses = area.west > area.east  # the date line runs through the area
    in_lon = (lon >= area.west - b or lon <= area.east + b) if crosses else area.west - b <= lon <= area.east + b
    return bool(in_lon and area.south - b <= lat <= area.north + b)


def _area_text(crs: str) -> str:
    area = pyproj.CRS.from_user_input(crs).area_of_use
    return area.name.split(":")[0] if area else "area unknown"


def _what_there_is(model: ifcopenshell.file) -> str:
    """Lower levels of georeference the model has, for the message: none of them is exact enough."""
    sites = model.by_type("IfcSite")
    if any(site.RefLatitude and site.RefLongitude for site in sites):
        return "it has IfcSite latitude and longitude alone, LoGeoRef 20, good to tens of metres"
    return "it has no IfcSite latitude and longitude either"
