"""Where the demo building stands: model axes to the projected CRS (IfcMapConversion) to the site frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyproj

from facadelake.core.arrays import Float64Array
from facadelake.core.geodesy import GEO, SiteOrigin, transform
from facadelake.demo.recipe import DemoPlace


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelPlacement:
    """IfcMapConversion: ``(east, north) = origin + scale * Rz(rotation) @ xy_ifc``, ``height = origin + z_ifc``.

    The scale is that of the grid and of the height above the ellipsoid together, so the model's metres are true ones.
    """

    crs: str
    origin: SiteOrigin
    east_m: float
    north_m: float
    height_m: float
    rotation_rad: float
    scale: float

    def map_from_ifc(self, xyz_ifc: Float64Array) -> Float64Array:
        """Points (n, 3) of the model in the projected CRS, ellipsoidal heights, metres.

        The scale is the grid's, of east and north; a height is no longer on the map than in nature.
        """
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        stretched = np.asarray(xyz_ifc, dtype=np.float64) * [self.scale, self.scale, 1.0]
        out = stretched @ turn.T + [self.east_m, self.north_m, self.height_m]
        return np.asarray(out, dtype=np.float64)

    def site_from_ifc(self, xyz_ifc: Float64Array) -> Float64Array:
        """Points (n, 3) of the model in site metres, through map, geographic and ECEF coordinates."""
        geo = transform(self.map_from_ifc(np.atleast_2d(xyz_ifc)), self.crs, GEO)
        return self.origin.site_from_geo(geo)

    def compute_affine(self) -> Float64Array:
        """``site_from_ifc`` (4, 4), exact to 0.1 mm over 50 m."""
        arm = 20.0
        tips = self.site_from_ifc(np.vstack([np.zeros(3), arm * np.eye(3), -arm * np.eye(3)]))
        out = np.eye(4)
        out[:3, :3] = ((tips[1:4] - tips[4:7]) / (2 * arm)).T
        out[:3, 3] = tips[0]
        return out


def place_model(place: DemoPlace) -> ModelPlacement:
    """The georeference of a place; its scale is the projection's at the place, reduced from the height."""
    east, north, height = transform(
        np.array([[place.lon_deg, place.lat_deg, place.height_ellipsoidal_m]]), GEO, place.crs
    )[0]
    grid = pyproj.Proj(place.crs).get_factors(place.lon_deg, place.lat_deg).meridional_scale
    return ModelPlacement(
        crs=place.crs,
        origin=SiteOrigin(
            lon_deg=place.lon_deg, lat_deg=place.lat_deg, height_ellipsoidal_m=place.height_ellipsoidal_m
        ),
        east_m=float(east),
        north_m=float(north),
        height_m=float(height),
        rotation_rad=float(np.radians(place.rotation_deg)),
        scale=float(grid / (1 + place.height_ellipsoidal_m / 6.38e6)),
    )
