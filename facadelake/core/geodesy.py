"""Transformations between ``site`` (local east-north-up), ECEF and EPSG codes, by PROJ; heights have a datum.

PROJ does every geographic conversion (Eq. 4 of the paper misprints the altitude: ``p / (cos(lat) - N)``).
Grids are never downloaded, and ballpark transformations are refused.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyproj
from pyproj import network
from pyproj.exceptions import CRSError
from pyproj.transformer import TransformerGroup

from facadelake.core.arrays import BoolArray, Float64Array, Float64Nx3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity

network.set_network_enabled(active=False)

GEO = "EPSG:4979"
ECEF = "EPSG:4978"
# A building may lie this far outside the area of use of its CRS: all of Bavaria, to 13.84 deg east, is mapped in
# EPSG:25832, whose area ends at 12 deg. Exchanged axes and wrong units are off by more.
AREA_MARGIN_DEG = 2.0

SITE_AXES = ("east", "north", "up")


@dataclass(frozen=True, kw_only=True)
class SiteOrigin:
    """Origin of the site frame (x east, y north, z up, metres) in EPSG:4979."""

    lon_deg: float
    lat_deg: float
    height_ellipsoidal_m: float

    def __post_init__(self) -> None:
        if not (-180 <= self.lon_deg <= 180 and -90 <= self.lat_deg <= 90):
            raise GeoreferenceError(
                f"site origin lon {self.lon_deg}, lat {self.lat_deg} is out of range (lon -180..180, lat -90..90); "
                "check whether the two are swapped, or in metres"
            )

    def ecef_from_site(self) -> Similarity:
        """Rigid transform from ``site`` to ECEF."""
        lon, lat = np.radians([self.lon_deg, self.lat_deg])
        east = [-np.sin(lon), np.cos(lon), 0.0]
        north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
        up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
        xyz = transform(np.array([[self.lon_deg, self.lat_deg, self.height_ellipsoidal_m]]), GEO, ECEF)[0]
        return Similarity(rotation=np.array([east, north, up]).T, translation=xyz)

    def site_from_geo(self, lon_lat_height: Float64Nx3) -> Float64Nx3:
        """Points (n, 3) in ``site``, metres, of EPSG:4979 points (n, 3: lon_deg, lat_deg, height_ellipsoidal_m)."""
        return self.ecef_from_site().invert().apply(transform(lon_lat_height, GEO, ECEF))

    def geo_from_site(self, xyz_site_m: Float64Nx3) -> Float64Nx3:
        """EPSG:4979 points (n, 3: lon_deg, lat_deg, height_ellipsoidal_m) of points (n, 3) in ``site``, metres."""
        return transform(self.ecef_from_site().apply(xyz_site_m), ECEF, GEO)

    def map_from_site(self, xyz_site_m: Float64Nx3, map_crs: str) -> Float64Nx3:
        """East, north and height (n, 3) in ``map_crs`` of points (n, 3) in ``site``, metres.

        The height is ellipsoidal where ``map_crs`` is a horizontal CRS ("EPSG:25832"), and refers to the vertical datum
        where it is a compound CRS ("EPSG:25832+7837").
        """
        return transform(self.geo_from_site(xyz_site_m), GEO, map_crs)


def promote_to_3d(crs_text: str) -> pyproj.CRS:
    """The CRS as a 3D CRS: a compound CRS unchanged, a horizontal CRS with ellipsoidal height.

    Raises GeoreferenceError for a CRS that PROJ does not know.
    """
    try:
        crs = pyproj.CRS.from_user_input(crs_text)
    except CRSError as error:
        raise GeoreferenceError(
            f"CRS '{crs_text}' is not known to PROJ; give an EPSG code such as EPSG:25832 or EPSG:25832+7837"
        ) from error
    return crs if crs.is_compound or len(crs.axis_info) == 3 else crs.to_3d()


@lru_cache(maxsize=32)
def _select_transformer(source: str, target: str) -> pyproj.Transformer:
    """The best transformation. A missing grid is an error, since the next best operation would be used silently.

    Ballpark transformations are refused: they ignore the shift between datums.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # pyproj warns where the best is unavailable; it is an error below
        group = TransformerGroup(promote_to_3d(source), promote_to_3d(target), always_xy=True, allow_ballpark=False)
    if not group.transformers:
        missing = sorted(
            {grid.short_name for op in group.unavailable_operations for grid in op.grids if not grid.available}
        )
        raise GeoreferenceError(
            f"no transformation from {source} to {target} is available"
            + (f": the grid {', '.join(missing)} is not installed" if missing else "")
            + "; install the grid in PROJ's data folder, or give heights as ellipsoidal"
        )
    if not group.best_available:
        best = group.unavailable_operations[0]
        missing = sorted({grid.short_name for grid in best.grids if not grid.available})
        raise GeoreferenceError(
            f"the best transformation from {source} to {target} needs the grid {', '.join(missing) or best.name}, "
            "which is not installed; install it in PROJ's data folder, or give heights as ellipsoidal"
        )
    return group.transformers[0]


def transform(points: Float64Nx3, source: str, target: str) -> Float64Nx3:
    """Transform points (n, 3) between CRSs, in the order lon, lat or east, north whatever the axis order of the CRS.

    Raises GeoreferenceError where no transformation is available, or a point lies outside the domain of the CRS.
    """
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    if len(points) == 0:
        return points.reshape(0, 3)
    x, y, z = _select_transformer(source, target).transform(points[:, 0], points[:, 1], points[:, 2])
    out = np.column_stack([x, y, z])
    if not np.isfinite(out).all():
        bad = points[~np.isfinite(out).all(axis=1)][0]
        raise GeoreferenceError(
            f"the point {bad.tolist()} of {source} lies outside the domain of {target}; "
            "check the axis order and the unit"
        )
    return out


def is_in_area_of_use(crs: str, lon_deg: float, lat_deg: float, margin_deg: float) -> bool:
    """Whether a place is in the area of use of ``crs``, or up to ``margin_deg`` outside it; True if it has none.

    Args:
        crs: a CRS.
        lon_deg: longitude of the place.
        lat_deg: latitude of the place.
        margin_deg: margin around the area, degrees.
    """
    area = _get_horizontal_crs(crs).area_of_use
    return area is None or bool(_mask_in_area(area.bounds, np.array([[lon_deg, lat_deg]]), margin_deg)[0])


def name_area_of_use(crs: str) -> str:
    """The name of the area of use of ``crs``, for messages."""
    area = _get_horizontal_crs(crs).area_of_use
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
    horizontal = _get_horizontal_crs(crs)
    area = horizontal.area_of_use
    if horizontal.is_geocentric or area is None:
        return
    xy = np.atleast_2d(np.asarray(points, dtype=np.float64))[:, :2]
    inside = _mask_in_area(area.bounds, _lon_lat_from_xy(horizontal, xy), margin_deg)
    if inside.all():
        return
    x, y = xy[~inside][0]
    readings = {
        "exchanged": (y, x),
        "with the other sign": (-x, -y),
        "exchanged and with the other sign": (-y, -x),
    }
    fits = _mask_in_area(area.bounds, _lon_lat_from_xy(horizontal, np.array(list(readings.values()))), 0.0)
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


def _get_horizontal_crs(crs: str) -> pyproj.CRS:
    """The horizontal part of a compound CRS, else the CRS itself."""
    parsed = promote_to_3d(crs)
    return parsed.sub_crs_list[0] if parsed.is_compound else parsed


def _lon_lat_from_xy(crs: pyproj.CRS, xy: Float64Array) -> Float64Array:
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
