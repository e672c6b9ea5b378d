"""Footprints: plan outlines of elements, and the horizontal distance from the building."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import shapely

from facadelake.building.model import BuildingModel
from facadelake.core.arrays import Float64Array, Float64N, Float64Nx2
from facadelake.core.geodesy import SiteOrigin

_MAX_UNION_TRIANGLES = 8_000
_CELL_M = 0.1
_MAX_CELLS = 4096  # along a side


def compute_outline(corners_site_m: Float64Array) -> shapely.Geometry:
    """Outline in site x, y of triangles (m, 3, 3) in plan; a vertical sheet becomes a strip 1 cm wide.

    The outline of more than 8,000 triangles, whose union would take minutes, consists of the cells of 0.1 m that they
    touch.
    """
    if len(corners_site_m) > _MAX_UNION_TRIANGLES:
        return _rasterise_outline(corners_site_m)
    flat = shapely.polygons(corners_site_m[:, :, :2])
    flat = flat[shapely.area(flat) > 1e-6]
    outline = shapely.union_all(flat, grid_size=1e-4) if len(flat) else shapely.Polygon()
    if outline.is_empty:
        outline = shapely.convex_hull(shapely.multipoints(corners_site_m[:, :, :2].reshape(-1, 2))).buffer(0.005)
    return outline.simplify(0.001)


def _rasterise_outline(corners_site_m: Float64Array) -> shapely.Geometry:
    """Union of the raster cells that triangles (m, 3, 3) touch in plan."""
    flat = corners_site_m[:, :, :2]
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    cell_m = max(_CELL_M, float((high - low).max()) / _MAX_CELLS)
    cells = np.floor((flat - low) / cell_m).astype(np.int32)
    columns, rows = cells.max(axis=(0, 1)) + 1
    covered = np.zeros((rows, columns + 2), dtype=np.uint8)
    for triangle in cells + np.array([1, 0], dtype=np.int32):
        cv2.fillConvexPoly(covered, triangle, 1)
    covered[:, [0, -1]] = 0
    steps = np.diff(covered.astype(np.int8), axis=1)
    (row, begin), (_, end) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    x, y = low[0] + np.stack([begin, end]) * cell_m, low[1] + np.stack([row, row + 1]) * cell_m
    return shapely.union_all(shapely.box(x[0], y[0], x[1], y[1]), grid_size=1e-4).simplify(0.001)


def lon_lat_from_site(outline: shapely.Geometry, level_m: float, origin: SiteOrigin) -> shapely.Geometry:
    """Transform an outline in site x, y at ``level_m`` in site z to lon, lat (EPSG:4979)."""

    def transform_xy(xy: Float64Nx2) -> Float64Nx2:
        return origin.geo_from_site(np.column_stack([xy, np.full(len(xy), level_m)]))[:, :2]

    return shapely.transform(outline, transform_xy)


def build_horizontal_distance(building: BuildingModel) -> Callable[[Float64Nx2], Float64N]:
    """Build a function that gives the distance (n,) in metres of points (n, 2: lon_deg, lat_deg) from the footprint."""
    footprint = compute_outline(building.vertices_site_m[building.triangles])
    shapely.prepare(footprint)

    def measure_distance(lon_lat_deg: Float64Nx2) -> Float64N:
        lon_lat = np.asarray(lon_lat_deg, dtype=np.float64).reshape(-1, 2)
        height = np.full(len(lon_lat), building.origin.height_ellipsoidal_m)
        xy = building.origin.site_from_geo(np.column_stack([lon_lat, height]))[:, :2]
        metres: Float64N = np.asarray(shapely.distance(footprint, shapely.points(xy)), dtype=np.float64)
        return metres

    return measure_distance
