"""Georeference of the demo building: from the model to the projected CRS (IfcMapConversion) and to site."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyproj

from facadelake.core.arrays import Float64Nx3, Float64x4x4
from facadelake.core.geodesy import SiteOrigin, transform
from facadelake.core.proj.crs import GEO
from facadelake.demo.recipe import DemoPlace


@dataclass(frozen=True, kw_only=True, eq=False)
class DemoPlacement:
    """IfcMapConversion: ``(east, north) = origin + scale * Rz(rotation) @ xy_ifc``, ``height = origin + z_ifc``.

    The scale combines the grid scale and the reduction from the height above the ellipsoid, so the model is in true
    metres.
    """

    crs: str
    origin: SiteOrigin
    east_m: float
    north_m: float
    height_m: float
    rotation_rad: float
    scale: float

    def map_from_ifc(self, xyz_ifc: Float64Nx3) -> Float64Nx3:
        """Points (n, 3) of the model in the projected CRS, with ellipsoidal heights, metres.

        The scale applies to east and north; heights have no grid scale.
        """
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        scaled = np.asarray(xyz_ifc, dtype=np.float64) * [self.scale, self.scale, 1.0]
        xyz_map = scaled @ rotation.T + [self.east_m, self.north_m, self.height_m]
        return np.asarray(xyz_map, dtype=np.float64)

    def site_from_ifc(self, xyz_ifc: Float64Nx3) -> Float64Nx3:
        """Points (n, 3) of the model in site, metres, through map, geographic and ECEF coordinates."""
        geo = transform(self.map_from_ifc(np.atleast_2d(xyz_ifc)), self.crs, GEO)
        return self.origin.site_from_geo(geo)

    def compute_affine(self) -> Float64x4x4:
        """``site_from_ifc`` as an affine matrix (4, 4), exact to 0.1 mm over 50 m."""
        arm = 20.0
        tips = self.site_from_ifc(np.vstack([np.zeros(3), arm * np.eye(3), -arm * np.eye(3)]))
        matrix = np.eye(4)
        matrix[:3, :3] = ((tips[1:4] - tips[4:7]) / (2 * arm)).T
        matrix[:3, 3] = tips[0]
        return matrix


def place_model(place: DemoPlace) -> DemoPlacement:
    """The georeference of a place; its scale is that of the projection there, reduced from the height."""
    east, north, height = transform(
        np.array([[place.lon_deg, place.lat_deg, place.height_ellipsoidal_m]]), GEO, place.crs
    )[0]
    grid = pyproj.Proj(place.crs).get_factors(place.lon_deg, place.lat_deg).meridional_scale
    return DemoPlacement(
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
