"""A model's place on the map: four numbers and a grid factor, and with the CRS its place on the globe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.building.model_georeference.crs import ELLIPSOIDAL
from facadelake.core.arrays import Float64Array
from facadelake.core.geodesy import GEO, SiteOrigin, promote_to_3d, transform

_HALF_BASE_M = 50.0  # half the base over which the map's stretch and turn are measured


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

    def map_from_ifc(self, xyz_ifc_m: Float64Array) -> Float64Array:
        """Model points (n, 3) as east, north, height (n, 3), metres."""
        scaled = np.asarray(xyz_ifc_m, dtype=np.float64) * np.array(self.scale)
        moved: Float64Array = scaled @ rotation_from_angle(self.rotation_deg).T + np.array(
            [self.east_m, self.north_m, self.height_m]
        )
        return moved


@dataclass(frozen=True, kw_only=True)
class ModelGeoreference:
    """A model's placement with its CRS ("EPSG:25832") and vertical datum ("ellipsoidal" or "EPSG:7837").

    ``level`` is its LoGeoRef (Clemen and Goerne 2019) or "registry". ``sigma_m`` is how far the place may be off, one
    sigma, where its kind tells that and not the surveyor; 0 where it is as good as whoever measured it.
    """

    placement: MapPlacement
    map_crs: str
    vertical_datum: str
    level: str
    remarks: str
    sigma_m: float = 0.0

    def geo_from_ifc(self, xyz_ifc_m: Float64Array) -> Float64Array:
        """Model points (n, 3) in EPSG:4979 (n, 3: lon_deg, lat_deg, height_ellipsoidal_m)."""
        return geo_from_map(self.placement.map_from_ifc(xyz_ifc_m), self.map_crs, self.vertical_datum)


@dataclass(frozen=True, kw_only=True)
class GridFactors:
    """The map at one place: its coordinates in metres, degrees from map east anticlockwise to true east, map metres
    for a metre on the ground (the projection's factor and the height's)."""

    map_m: Float64Array
    true_east_deg: float
    combined_factor: float


def rotation_from_angle(angle_deg: float) -> Float64Array:
    """Rotation (3, 3) anticlockwise about the vertical."""
    angle = np.radians(angle_deg)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def geo_from_map(map_m: Float64Array, map_crs: str, vertical_datum: str) -> Float64Array:
    """Map points in metres (n, 3) in EPSG:4979, whatever unit the CRS counts in."""
    whole, units = _combine_crs(map_crs, vertical_datum)
    return transform(map_m / units, whole, GEO)


def map_from_geo(lon_lat_height: Float64Array, map_crs: str, vertical_datum: str) -> Float64Array:
    """EPSG:4979 points (n, 3) as east, north and height in metres."""
    whole, units = _combine_crs(map_crs, vertical_datum)
    metres: Float64Array = transform(lon_lat_height, GEO, whole) * units
    return metres


def compute_grid_factors(lon_lat_height: Float64Array, map_crs: str, vertical_datum: str) -> GridFactors:
    """How the map is turned and stretched at a place (3,) of EPSG:4979, measured over 100 m."""
    lon, lat, height = (float(value) for value in lon_lat_height)
    origin = SiteOrigin(lon_deg=lon, lat_deg=lat, height_ellipsoidal_m=height)
    star = _HALF_BASE_M * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=np.float64)
    on_map = map_from_geo(origin.geo_from_site(star), map_crs, vertical_datum)
    east, north = (on_map[1] - on_map[2]) / (2 * _HALF_BASE_M), (on_map[3] - on_map[4]) / (2 * _HALF_BASE_M)
    return GridFactors(
        map_m=on_map[0],
        true_east_deg=float(np.degrees(np.arctan2(east[1], east[0]))),
        combined_factor=float(np.sqrt(abs(east[0] * north[1] - east[1] * north[0]))),
    )


def place_upright(grid: GridFactors, *, anchor_ifc_m: Float64Array, x_axis_deg: float) -> MapPlacement:
    """The placement that puts ``anchor_ifc_m`` (3,) at ``grid`` in true metres.

    ``x_axis_deg`` is the angle from true east anticlockwise to the model's x axis.
    """
    rotation = x_axis_deg + grid.true_east_deg
    scale = np.array([grid.combined_factor, grid.combined_factor, 1.0])
    east, north, height = grid.map_m - rotation_from_angle(rotation) @ (np.asarray(anchor_ifc_m) * scale)
    return MapPlacement(
        east_m=float(east),
        north_m=float(north),
        height_m=float(height),
        rotation_deg=rotation,
        scale=(grid.combined_factor, grid.combined_factor, 1.0),
    )


def _combine_crs(map_crs: str, vertical_datum: str) -> tuple[str, Float64Array]:
    whole = map_crs if vertical_datum == ELLIPSOIDAL else f"{map_crs}+{vertical_datum.removeprefix('EPSG:')}"
    return whole, np.array([axis.unit_conversion_factor for axis in promote_to_3d(whole).axis_info])
