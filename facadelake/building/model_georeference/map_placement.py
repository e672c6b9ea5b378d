"""Placement of a model on the map (a similarity about the vertical), and with its CRS on the globe."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin, find_operation, transform
from facadelake.core.proj.crs import (
    AREA_MARGIN_DEG,
    GEO,
    combine_crs,
    get_crs_name,
    list_axis_directions,
    mask_in_area_of_use,
    parse_crs,
    promote_to_3d,
)
from facadelake.core.proj.operations import PlacedOperation, describe_poor_operation, require_best

REGISTRY_LEVEL = "registry"  # stands in for a LoGeoRef level
MIN_MAP_COORDINATE_M = 10_000.0  # coordinates beyond this are map coordinates; a building's own are smaller
_MAX_ORIGIN_DISTANCE_M = 20_000.0  # beyond, east-north-up of the origin is not that of the building
_DIRECTIONS = {"east": (1, 0), "north": (0, 1), "west": (-1, 0), "south": (0, -1)}
_HALF_BASE_M = 50.0  # half the base over which the map's scale and convergence are measured


@dataclass(frozen=True, kw_only=True)
class MapPlacement:
    """Position of the model's origin on the map, in metres.

    ``rotation_deg`` is the angle from map east anticlockwise to the model's x axis; ``scale`` holds map metres per
    model metre along x, y, z.
    """

    east_m: float
    north_m: float
    height_m: float
    rotation_deg: float = 0.0
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def map_from_ifc(self, xyz_ifc_m: Float64Nx3) -> Float64Nx3:
        """Transform model points (n, 3) to east, north, height (n, 3), metres."""
        scaled = np.asarray(xyz_ifc_m, dtype=np.float64) * np.array(self.scale)
        xyz_map_m: Float64Nx3 = scaled @ rotation_from_angle(self.rotation_deg).T + np.array(
            [self.east_m, self.north_m, self.height_m]
        )
        return xyz_map_m


@dataclass(frozen=True, kw_only=True)
class ModelGeoreference:
    """A model's placement with its CRS ("EPSG:25832") and vertical datum ("ellipsoidal" or "EPSG:7837").

    ``level`` is its LoGeoRef level (Clemen and Goerne 2019) or "registry". ``remarks`` lists the assumptions made.
    ``sigma_m`` is the standard deviation of the position where it follows from the kind of georeference; 0 where the
    accuracy is that of the survey. ``reading`` names the unit in which map coordinates were read, where there are
    several possible; ``contradicts`` the statement that this reading contradicts, empty if none; ``height_unit_m`` the
    unit of the height, 0 where it is in metres by definition.
    """

    placement: MapPlacement
    map_crs: str
    vertical_datum: str
    level: str
    remarks: str
    sigma_m: float = 0.0
    reading: str = ""
    contradicts: str = ""
    height_unit_m: float = 0.0

    def geo_from_ifc(self, xyz_ifc_m: Float64Nx3) -> Float64Nx3:
        """Transform model points (n, 3) to EPSG:4979 (n, 3: lon_deg, lat_deg, height_ellipsoidal_m)."""
        return geo_from_map(self.placement.map_from_ifc(xyz_ifc_m), self.map_crs, self.vertical_datum)

    def is_in_area_of_use(self, xyz_ifc_m: Float64x3, *, margin_deg: float = AREA_MARGIN_DEG) -> bool:
        """Whether a model point (3,) is in the CRS's area of use, or up to ``margin_deg`` outside it."""
        compound, units = _combine_crs(self.map_crs, self.vertical_datum)
        xyz_map = self.placement.map_from_ifc(xyz_ifc_m[None]) / units
        return bool(mask_in_area_of_use(xyz_map, compound, margin_deg)[0])

    def find_operation(self, xyz_ifc_m: Float64x3) -> PlacedOperation:
        """The operation from the map to EPSG:4979 at a model point (3,). Raises GeoreferenceError if there is none."""
        lon, lat, _ = self.geo_from_ifc(xyz_ifc_m[None])[0].tolist()
        return find_operation(combine_crs(self.map_crs, self.vertical_datum), GEO, lon_deg=lon, lat_deg=lat)


def accept_operation(
    georeference: ModelGeoreference, origin: SiteOrigin, accepted_accuracy_m: float | None
) -> ModelGeoreference:
    """The georeference with a remark on a poor operation to EPSG:4979.

    Raises GeoreferenceError where a better one lacks its grid, unless its accuracy is accepted.
    """
    crs = combine_crs(georeference.map_crs, georeference.vertical_datum)
    operation = find_operation(crs, GEO, lon_deg=origin.lon_deg, lat_deg=origin.lat_deg)
    require_best(operation, accepted_accuracy_m)
    remarks = "; ".join(filter(None, [georeference.remarks, describe_poor_operation(operation)]))
    return replace(georeference, remarks=remarks)


def describe_map_axes(georeference: ModelGeoreference) -> str:
    """Remark on a map whose x and y do not grow to the east and north; empty where they do, and at the poles.

    Raises GeoreferenceError where the model would be mirrored (Krovak, EPSG:5513: south, west), and for the Eastings
    and Northings of an IFC in such a CRS (South Africa, EPSG:2053: west, south): either may mean both signs.
    """
    x, y = list_axis_directions(georeference.map_crs)
    if (x, y) == ("east", "north") or x == y or not {x, y} <= set(_DIRECTIONS):
        return ""
    (x_east, x_north), (y_east, y_north) = _DIRECTIONS[x], _DIRECTIONS[y]
    axes = (
        f"x and y of {georeference.map_crs} ({get_crs_name(parse_crs(georeference.map_crs))}) grow to the {x} and {y}"
    )
    if x_east * y_north - x_north * y_east < 0:
        raise GeoreferenceError(
            f"{axes}, so that the model would be mirrored; give a CRS whose axes are east and north, with coordinates "
            "in it (EPSG:5514 in place of EPSG:5513)"
        )
    if georeference.level != REGISTRY_LEVEL:
        raise GeoreferenceError(
            f"{axes}, so that Eastings and Northings of the IFC may be either, and the model turned by "
            f"{90 if x_east == 0 else 180} degrees; set crs.control in the portfolio: pairs of points of the model and "
            f"of the map, {x} and {y} positive"
        )
    return f"{axes}; the model's coordinates are taken so"


@dataclass(frozen=True, kw_only=True)
class GridFactors:
    """Scale and convergence of the map at one point.

    ``map_m`` (3,): the point's east, north, height. ``true_east_deg``: angle from map east anticlockwise to true east.
    ``combined_factor``: map metres per metre on the ground, the product of the grid scale factor and the height's.
    """

    map_m: Float64x3
    true_east_deg: float
    combined_factor: float


def rotation_from_angle(angle_deg: float) -> Float64x3x3:
    """Rotation matrix (3, 3) of an anticlockwise rotation about the vertical."""
    angle = np.radians(angle_deg)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def geo_from_map(map_m: Float64Nx3, map_crs: str, vertical_datum: str) -> Float64Nx3:
    """Transform east, north, height (n, 3) in metres to EPSG:4979, whatever the unit of the CRS."""
    compound, units = _combine_crs(map_crs, vertical_datum)
    return transform(map_m / units, compound, GEO)


def map_from_geo(lon_lat_height: Float64Nx3, map_crs: str, vertical_datum: str) -> Float64Nx3:
    """Transform EPSG:4979 points (n, 3) to east, north, height in metres."""
    compound, units = _combine_crs(map_crs, vertical_datum)
    metres: Float64Nx3 = transform(lon_lat_height, GEO, compound) * units
    return metres


def require_origin_near(origin: SiteOrigin | None, geo: Float64x3) -> None:
    """Refuse an origin of the portfolio that is far from the building, at ``geo`` (3,) in EPSG:4979.

    Raises GeoreferenceError, and names latitude and longitude if they are exchanged.
    """
    if origin is None:
        return
    distance_m = float(np.linalg.norm(origin.site_from_geo(geo[None])[0]))
    if distance_m <= _MAX_ORIGIN_DISTANCE_M:
        return
    exchanged = np.abs([origin.lon_deg - geo[1], origin.lat_deg - geo[0]]).max() < 1.0
    raise GeoreferenceError(
        f"crs.origin of the portfolio, lon {origin.lon_deg:.6f}, lat {origin.lat_deg:.6f}, is {distance_m / 1000:,.1f} "
        f"km from the building at lon {geo[0]:.6f}, lat {geo[1]:.6f} (limit {_MAX_ORIGIN_DISTANCE_M / 1000:g} km)"
        + ("; latitude and longitude are exchanged" if exchanged else "")
        + ": correct it, or leave it out"
    )


def compute_grid_factors(lon_lat_height: Float64x3, map_crs: str, vertical_datum: str) -> GridFactors:
    """Scale and convergence of the map at a point (3,) of EPSG:4979, by differences over 100 m."""
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


def place_upright(grid: GridFactors, *, anchor_ifc_m: Float64x3, x_axis_deg: float) -> MapPlacement:
    """The placement, in metres on the ground, that puts the model point ``anchor_ifc_m`` (3,) at ``grid``.

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


def _combine_crs(map_crs: str, vertical_datum: str) -> tuple[str, Float64N]:
    """The CRS with height, and metres per unit of its three axes (3,)."""
    compound = combine_crs(map_crs, vertical_datum)
    return compound, np.array([axis.unit_conversion_factor for axis in promote_to_3d(compound).axis_info])
