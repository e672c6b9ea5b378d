"""Site (local east-north-up) <-> ECEF <-> EPSG codes, by PROJ; heights carry their datum.

PROJ does every geographic conversion (the paper's Eq. 4 has the altitude wrong: ``p / (cos(lat) - N)``).
Network grids are never fetched, and a transformation that PROJ can only guess ("ballpark") is refused.
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

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity

network.set_network_enabled(active=False)

GEO = "EPSG:4979"
ECEF = "EPSG:4978"


@dataclass(frozen=True, kw_only=True)
class SiteOrigin:
    """Where the site frame (x east, y north, z up, metres) has its zero, in EPSG:4979."""

    lon_deg: float
    lat_deg: float
    height_ellipsoidal_m: float

    def __post_init__(self) -> None:
        if not (-180 <= self.lon_deg <= 180 and -90 <= self.lat_deg <= 90):
            raise GeoreferenceError(
                f"site origin lon {self.lon_deg}, lat {self.lat_deg} is off the globe (lon -180..180, lat -90..90); "
                "are the two swapped, or in metres?"
            )

    def ecef_from_site(self) -> Similarity:
        """Rigid transform of site coordinates to ECEF."""
        lon, lat = np.radians([self.lon_deg, self.lat_deg])
        east = [-np.sin(lon), np.cos(lon), 0.0]
        north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
        up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
        xyz = transform(np.array([[self.lon_deg, self.lat_deg, self.height_ellipsoidal_m]]), GEO, ECEF)[0]
        return Similarity(rotation=np.array([east, north, up]).T, translation=xyz)

    def site_from_geo(self, lon_lat_height: Float64Array) -> Float64Array:
        """EPSG:4979 points (n, 3: lon_deg, lat_deg, height_ellipsoidal_m) in site metres (n, 3)."""
        return self.ecef_from_site().invert().apply(transform(lon_lat_height, GEO, ECEF))

    def geo_from_site(self, xyz_site_m: Float64Array) -> Float64Array:
        """Site metres (n, 3) as EPSG:4979 (n, 3: lon_deg, lat_deg, height_ellipsoidal_m)."""
        return transform(self.ecef_from_site().apply(xyz_site_m), ECEF, GEO)

    def map_from_site(self, xyz_site_m: Float64Array, map_crs: str) -> Float64Array:
        """Site metres (n, 3) as east, north and height of ``map_crs``.

        Where ``map_crs`` is horizontal alone ("EPSG:25832") the height is ellipsoidal; where it is compound
        ("EPSG:25832+7837") the height is that of its vertical datum.
        """
        return transform(self.geo_from_site(xyz_site_m), GEO, map_crs)


def promote_to_3d(crs_text: str) -> pyproj.CRS:
    """A CRS with a height: a compound CRS as it is, a horizontal one with ellipsoidal height.

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
    """The best transformation whose grids are at hand; ballpark ones are refused, for they change nothing silently."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # pyproj warns where the best is missing; below that is an error
        group = TransformerGroup(promote_to_3d(source), promote_to_3d(target), always_xy=True, allow_ballpark=False)
    if not group.transformers:
        missing = sorted(
            {grid.short_name for op in group.unavailable_operations for grid in op.grids if not grid.available}
        )
        raise GeoreferenceError(
            f"no exact transformation from {source} to {target}"
            + (f": the grid {', '.join(missing)} is not on this machine" if missing else "")
            + "; install the grid in PROJ's data folder, or give heights as ellipsoidal"
        )
    if not group.best_available:
        best = group.unavailable_operations[0]
        missing = sorted({grid.short_name for grid in best.grids if not grid.available})
        raise GeoreferenceError(
            f"the best transformation from {source} to {target} needs the grid {', '.join(missing) or best.name}, "
            "which is not on this machine; install it in PROJ's data folder, or give heights as ellipsoidal"
        )
    return group.transformers[0]


def transform(points: Float64Array, source: str, target: str) -> Float64Array:
    """Points (n, 3) of one CRS in another, x before y (lon, lat / east, north) whatever the CRS's own axis order.

    Raises GeoreferenceError where no exact transformation is at hand or a point is outside the CRS's domain.
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
            "are axes swapped or units wrong?"
        )
    return out
