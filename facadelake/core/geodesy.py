"""Transformations between ``site`` (local east-north-up), ECEF and EPSG codes, by PROJ; heights have a datum.

PROJ does every geographic conversion (Eq. 4 of the paper misprints the altitude: ``p / (cos(lat) - N)``).
Grids are never downloaded, and ballpark transformations are refused.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyproj
from pyproj import network
from pyproj.exceptions import CRSError
from pyproj.transformer import TransformerGroup

from facadelake.core.arrays import Float64Nx3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity

network.set_network_enabled(active=False)

GEO = "EPSG:4979"
ECEF = "EPSG:4978"


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
