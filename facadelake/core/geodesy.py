"""Transformations between ``site`` (local east-north-up), ECEF and EPSG codes, by PROJ; heights have a datum.

PROJ does every geographic conversion (Eq. 4 of the paper misprints the altitude: ``p / (cos(lat) - N)``).
Grids are never downloaded, and ballpark transformations are refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyproj

from facadelake.core.arrays import Float64Array, Float64Nx3, Float64x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.proj.crs import (
    AREA_MARGIN_DEG,
    ECEF,
    GEO,
    check_area_of_use,
    get_horizontal_crs,
    is_horizontal,
    is_in_area_of_use,
    lon_lat_from_xy,
    name_area_of_use,
    name_crs,
    parse_crs,
    promote_to_3d,
)
from facadelake.core.proj.operations import METRES_PER_DEGREE, PlacedOperation, place_operation

SITE_AXES = ("east", "north", "up")
# An inverse is improved until round trips return to this, or so many times.
_INVERSE_EXACT_M = 1e-5
_INVERSE_STEPS = 3


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


def find_operation(source: str, target: str, *, lon_deg: float, lat_deg: float) -> PlacedOperation:
    """The operation by which ``transform`` goes from one CRS to another at a place.

    Args:
        source: the CRS to transform from.
        target: the CRS to transform to.
        lon_deg: longitude of the place.
        lat_deg: latitude of the place.

    Returns:
        the best available operation, its accuracy, and whether a better one lacks its grid.

    Raises:
        GeoreferenceError: there is none for the place, or the grids of all of them are missing.
    """
    place = _choose_place(source, target, lon_deg, lat_deg)
    return place_operation(promote_to_3d(source), promote_to_3d(target), *place)


@dataclass(frozen=True, kw_only=True, eq=False)
class OperationSigma:
    """What an operation between two CRSs adds to the error of every point alike.

    ``sigma_m`` (3,: east, north, up): one sigma. ``convention_m``: stated accuracy of a null transformation, 0 without
    one. WGS 84 and ETRS89 or NAD83 are equal by convention: coordinates that were computed by it return unchanged,
    those observed in the other datum are off by decimetres to metres. It is therefore told, not added.
    """

    sigma_m: Float64x3
    convention_m: float


def compute_operation_sigma(source: str, target: str, *, lon_deg: float, lat_deg: float) -> OperationSigma:
    """The error that the operation between two CRSs adds to all points of a site.

    Args:
        source: the CRS to transform from.
        target: the CRS to transform to.
        lon_deg: longitude of the site.
        lat_deg: latitude of the site.

    Returns:
        the accuracy that PROJ's database states, as one sigma of each axis; of the height alone where only heights are
        transformed; zero between CRSs of one datum.

    Raises:
        GeoreferenceError: there is no operation for the place.
    """
    source, target = (GEO if crs == ECEF else crs for crs in (source, target))
    total_m = find_operation(source, target, lon_deg=lon_deg, lat_deg=lat_deg).sigma_m
    place = _choose_place(source, target, lon_deg, lat_deg)
    geographic = [get_horizontal_crs(crs).geodetic_crs for crs in (source, target)]
    if None in geographic or any(crs.is_geocentric for crs in geographic if crs is not None):
        return OperationSigma(sigma_m=np.full(3, total_m), convention_m=0.0)
    horizontal = place_operation(*(crs.to_2d() for crs in geographic if crs is not None), *place)
    across_m = horizontal.sigma_m
    if across_m and np.array_equal(horizontal.transformer.transform(*place), place):
        up_m = max(total_m - across_m, 0.0)  # PROJ adds the accuracies of the steps
        return OperationSigma(sigma_m=np.array([0.0, 0.0, up_m]), convention_m=across_m)
    return OperationSigma(sigma_m=np.array([across_m, across_m, total_m]), convention_m=0.0)


def _choose_place(source: str, target: str, lon_deg: float, lat_deg: float) -> tuple[float, float]:
    """The place to choose an operation for: inside the areas of use of both CRSs, if need be by the margin.

    Rounded to a kilometre, so that all points of a site share one operation.
    """
    for crs in (source, target):
        area = get_horizontal_crs(crs).area_of_use
        if area is not None and area.west < area.east:
            lon_deg = min(max(lon_deg, area.west), area.east)
            lat_deg = min(max(lat_deg, area.south), area.north)
    return round(lon_deg, 2), round(lat_deg, 2)


def transform(points: Float64Nx3, source: str, target: str) -> Float64Nx3:
    """Transform points (n, 3) between CRSs, in the order lon, lat or east, north whatever the axis order of the CRS.

    The best operation that is installed is used for the place of the points; ``find_operation`` says which it is. The
    height of a horizontal CRS ("EPSG:2056") is a GNSS height, above the ellipsoid of WGS 84 (and GRS 80), in metres.
    ``combine_crs`` names other heights.

    Raises GeoreferenceError where no transformation is available, or a point lies outside the area of use of a CRS.
    """
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    if len(points) == 0:
        return points.reshape(0, 3)
    if source == target:
        return points.copy()
    if {source, target} <= {GEO, ECEF}:
        return _require_finite(_select_conversion(source, target).transform(*points.T), points, source, target)
    if ECEF in (source, target):  # PROJ has fewer operations to geocentric coordinates than to geographic ones
        return transform(transform(points, source, GEO), GEO, target)
    lon_deg, lat_deg = _locate(points, source)
    _require_place_in_area(lon_deg, lat_deg, target)
    own = points.copy()
    if is_horizontal(parse_crs(source)):
        # From the GNSS height to that above the CRS's own ellipsoid: their difference is the same at both heights.
        own[:, 2] -= _apply(points, source, GEO, lon_deg, lat_deg)[:, 2] - points[:, 2]
    out = _apply(own, source, target, lon_deg, lat_deg)
    heights_are_gnss = {crs == GEO or is_horizontal(parse_crs(crs)) for crs in (source, target)}
    if heights_are_gnss == {True}:
        out[:, 2] = points[:, 2]
    elif is_horizontal(parse_crs(target)):
        out[:, 2] = _apply(out, target, GEO, lon_deg, lat_deg)[:, 2]
    return out


def _apply(points: Float64Nx3, source: str, target: str, lon_deg: float, lat_deg: float) -> Float64Nx3:
    """Transform points; heights of horizontal CRSs are above their own ellipsoid.

    Args:
        points: points (n, 3).
        source: their CRS.
        target: the CRS to transform to.
        lon_deg: longitude of the place that the operation is chosen for.
        lat_deg: latitude of the place.

    Returns:
        the points (n, 3).
    """
    place = {"lon_deg": lon_deg, "lat_deg": lat_deg}
    operation = find_operation(source, target, **place)
    out = _require_finite(operation.transformer.transform(*points.T), points, source, target)
    if not operation.is_inverse:
        return out
    defined = find_operation(target, source, **place)
    if not defined.is_inverse_of(operation):
        return out
    # PROJ inverts a Helmert transformation by changing its signs, which is off by up to decimetres where rotations are
    # large: round trips would not return. The inverse is that of the operation as EPSG defines it.
    given = points
    for _ in range(_INVERSE_STEPS):
        missed = points - _require_finite(defined.transformer.transform(*out.T), out, target, source)
        if _measure_largest_m(missed[:, :2], source) < _INVERSE_EXACT_M:
            break
        given = given + missed
        out = _require_finite(operation.transformer.transform(*given.T), given, source, target)
    return out


def _measure_largest_m(steps: Float64Array, crs: str) -> float:
    """Length in metres of the largest of small steps (n, 2) in a CRS."""
    horizontal = get_horizontal_crs(crs)
    metres = METRES_PER_DEGREE if horizontal.is_geographic else horizontal.axis_info[0].unit_conversion_factor
    return float(np.abs(steps).max()) * metres


@lru_cache(maxsize=2)
def _select_conversion(source: str, target: str) -> pyproj.Transformer:
    """The conversion between geographic and geocentric coordinates of WGS 84, which is exact everywhere."""
    return pyproj.Transformer.from_crs(source, target, always_xy=True)


def _require_finite(xyz: tuple[Float64Array, ...], points: Float64Nx3, source: str, target: str) -> Float64Nx3:
    out = np.column_stack(xyz)
    if not np.isfinite(out).all():
        bad = points[~np.isfinite(out).all(axis=1)][0]
        raise GeoreferenceError(
            f"the point {bad.tolist()} of {name_crs(source)} lies outside the domain of {name_crs(target)}; "
            "check the axis order and the unit"
        )
    return out


def _locate(points: Float64Nx3, crs: str) -> tuple[float, float]:
    """Longitude and latitude of the middle of points (n, 3), which have to lie in the area of use of their CRS."""
    check_area_of_use(points, crs)
    horizontal = get_horizontal_crs(crs)
    if horizontal.is_geocentric:
        lon_lat = transform(points, ECEF, GEO)[:, :2]
    else:
        lon_lat = lon_lat_from_xy(horizontal, points[:, :2])
    lon_deg, lat_deg = np.median(lon_lat, axis=0).tolist()
    return lon_deg, lat_deg


def _require_place_in_area(lon_deg: float, lat_deg: float, crs: str) -> None:
    if is_in_area_of_use(crs, lon_deg, lat_deg, AREA_MARGIN_DEG):
        return
    raise GeoreferenceError(
        f"the place lon {lon_deg:.6f}, lat {lat_deg:.6f} lies outside the area of use of {name_crs(crs)} "
        f"({name_area_of_use(crs)}); check the axis order and the CRS"
    )
