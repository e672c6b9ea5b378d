"""CRSs by code, name or WKT, with the heights they have, and their areas of use."""

from __future__ import annotations

import math
import warnings
from functools import lru_cache

import numpy as np
import pyproj
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.core.errors import GeoreferenceError

GEO = "EPSG:4979"
ECEF = "EPSG:4978"
# A building may lie this far outside the area of use of its CRS: all of Bavaria, to 13.84 deg east, is mapped in
# EPSG:25832, whose area ends at 12 deg. Exchanged axes and wrong units are off by more.
AREA_MARGIN_DEG = 2.0
# Words for a height: above the ellipsoid of WGS 84 and GRS 80, as GNSS receivers give it; above that of the CRS's own
# datum, tens of metres apart where that is an older one (Switzerland, Spain).
ELLIPSOIDAL = "ellipsoidal"
ELLIPSOID_OF_CRS = "ellipsoid of the CRS"


@lru_cache(maxsize=64)
def promote_to_3d(crs_text: str) -> pyproj.CRS:
    """The CRS as a 3D CRS: a compound CRS unchanged, a horizontal CRS with a height above its own ellipsoid.

    Raises GeoreferenceError for a CRS that PROJ does not know.
    """
    crs = parse_crs(crs_text)
    return crs.to_3d() if is_horizontal(crs) else crs


def combine_crs(horizontal: str, vertical_datum: str) -> str:
    """A horizontal CRS with the heights of a vertical datum, in a form that ``transform`` reads.

    Args:
        horizontal: a projected or geographic CRS.
        vertical_datum: "ellipsoidal" (a GNSS height), "ellipsoid of the CRS", or a vertical CRS such as "EPSG:7837".

    Returns:
        the CRS: unchanged for GNSS heights, else compound or three-dimensional.

    Raises:
        GeoreferenceError: PROJ does not know one of them, or cannot combine them.
    """
    if vertical_datum == ELLIPSOIDAL:
        return horizontal
    if vertical_datum == ELLIPSOID_OF_CRS:
        return str(promote_to_3d(horizontal).to_wkt())
    if horizontal.upper().startswith("EPSG:") and vertical_datum.upper().startswith("EPSG:"):
        return f"{horizontal}+{vertical_datum[5:]}"
    try:
        parts = [parse_crs(horizontal), parse_crs(vertical_datum)]
        return str(CompoundCRS(name=f"{parts[0].name} + {parts[1].name}", components=parts).to_wkt())
    except CRSError as error:
        raise GeoreferenceError(
            f"the CRS {horizontal} cannot be combined with the vertical CRS {vertical_datum}: {error}; "
            "name a compound CRS such as EPSG:25832+7837"
        ) from error


def parse_crs(crs_text: str) -> pyproj.CRS:
    """The CRS. Raises GeoreferenceError for one that PROJ does not know."""
    try:
        return _read_crs(crs_text)
    except CRSError as error:
        raise GeoreferenceError(
            f"CRS '{crs_text}' is not known to PROJ; give an EPSG code such as EPSG:25832 or EPSG:25832+7837"
        ) from error


_read_crs = lru_cache(maxsize=64)(pyproj.CRS.from_user_input)


def is_horizontal(crs: pyproj.CRS) -> bool:
    """Whether the CRS has no heights of its own, so that they are GNSS heights."""
    return not crs.is_compound and len(crs.axis_info) < 3


def name_crs(crs_text: str) -> str:
    """The CRS as given, or its name where it was given as WKT."""
    return crs_text if len(crs_text) <= 40 else get_crs_name(parse_crs(crs_text))


def get_crs_name(crs: pyproj.CRS) -> str:
    """The name of a CRS; the PROJ string of one that has no name."""
    if "unknown" not in crs.name.lower():
        return str(crs.name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a PROJ string has not all of a CRS; it is for people here
        return crs.to_proj4() or str(crs.name)


def mask_in_area_of_use(points: Float64Array, crs: str, margin_deg: float = AREA_MARGIN_DEG) -> BoolArray:
    """Mask (n,) of the points (n, 2 or more) of ``crs`` that lie in its area of use, or up to the margin outside it."""
    xy = np.atleast_2d(np.asarray(points, dtype=np.float64))[:, :2]
    horizontal = get_horizontal_crs(crs)
    if horizontal.is_geocentric or horizontal.area_of_use is None:
        return np.asarray(np.isfinite(xy).all(axis=1))
    return _mask_in_area(horizontal.area_of_use.bounds, lon_lat_from_xy(horizontal, xy), margin_deg)


def is_in_area_of_use(crs: str, lon_deg: float, lat_deg: float, margin_deg: float) -> bool:
    """Whether a place is in the area of use of ``crs``, or up to ``margin_deg`` outside it; True if it has none.

    Args:
        crs: a CRS.
        lon_deg: longitude of the place.
        lat_deg: latitude of the place.
        margin_deg: margin around the area, degrees.
    """
    area = get_horizontal_crs(crs).area_of_use
    return area is None or bool(_mask_in_area(area.bounds, np.array([[lon_deg, lat_deg]]), margin_deg)[0])


def name_area_of_use(crs: str) -> str:
    """The name of the area of use of ``crs``, for messages."""
    area = get_horizontal_crs(crs).area_of_use
    return area.name.split(":")[0].rstrip(".") if area else "area unknown"


def check_area_of_use(points: Float64Array, crs: str, *, margin_deg: float = AREA_MARGIN_DEG) -> None:
    """Refuse points that lie outside the area of use of their CRS.

    Args:
        points: points (n, 2 or more) in the units of ``crs``: x (east, longitude) before y, whatever its axis order.
        crs: their CRS; of a compound CRS, the horizontal part counts. A geocentric CRS has no area to check.
        margin_deg: how far outside the area points may lie, degrees.

    Raises:
        GeoreferenceError: names the first such point and the area, and the exchanged or negated coordinates where these
            lie in the area.
    """
    inside = mask_in_area_of_use(points, crs, margin_deg)
    horizontal = get_horizontal_crs(crs)
    area = horizontal.area_of_use
    if inside.all() or area is None:
        return
    x, y = np.atleast_2d(np.asarray(points, dtype=np.float64))[~inside][0, :2]
    readings = {
        "exchanged": (y, x),
        "with the other sign": (-x, -y),
        "exchanged and with the other sign": (-y, -x),
    }
    fits = mask_in_area_of_use(np.array(list(readings.values())), crs, 0.0)
    fitting = [
        f"{how} ({a:.10g}, {b:.10g}) it would lie in it; "
        for (how, (a, b)), fit in zip(readings.items(), fits, strict=True)
        if fit
    ]
    axes = "longitude, latitude" if horizontal.is_geographic else "east, north"
    raise GeoreferenceError(
        f"the point {x:.10g}, {y:.10g} of {horizontal.name} ({axes}) lies outside the area of use of that CRS "
        f"({name_area_of_use(crs)}: longitude {area.west:g} to {area.east:g}, latitude {area.south:g} to "
        f"{area.north:g}); {(fitting or [''])[0]}check the axis order, the unit and the CRS"
    )


def get_horizontal_crs(crs: str) -> pyproj.CRS:
    """The horizontal part of a compound CRS, else the CRS itself."""
    parsed = promote_to_3d(crs)
    return parsed.sub_crs_list[0] if parsed.is_compound else parsed


def list_axis_directions(crs: str) -> tuple[str, str]:
    """The directions in which x and y of a horizontal CRS grow ("east", "north"), in the order of ``transform``."""
    first, second = (str(axis.direction) for axis in get_horizontal_crs(crs).axis_info[:2])
    return (second, first) if (first, second) == ("north", "east") else (first, second)


def lon_lat_from_xy(crs: pyproj.CRS, xy: Float64Array) -> Float64Array:
    """Longitude and latitude (n, 2), degrees in the datum of ``crs``, of points (n, 2) of it."""
    if crs.is_geographic:
        return xy * math.degrees(crs.axis_info[0].unit_conversion_factor)
    return np.column_stack(pyproj.Proj(crs)(xy[:, 0], xy[:, 1], inverse=True))


def _mask_in_area(
    bounds_deg: tuple[float, float, float, float], lon_lat_deg: Float64Array, margin_deg: float
) -> BoolArray:
    """Mask (n,) of the places (n, 2) within ``bounds_deg`` and the margin; False where not finite.

    Args:
        bounds_deg: west, south, east, north; west > east across the date line.
        lon_lat_deg: the places (n, 2).
        margin_deg: margin around the bounds.

    Returns:
        the mask.
    """
    west, south, east, north = bounds_deg
    lon, lat = lon_lat_deg.T
    after_west, before_east = lon >= west - margin_deg, lon <= east + margin_deg
    in_lon = after_west | before_east if west > east else after_west & before_east
    inside: BoolArray = in_lon & (lat >= south - margin_deg) & (lat <= north + margin_deg)
    return inside & np.isfinite(lon_lat_deg).all(axis=1)
