"""The building seen from above: outlines of its elements, and how far a place lies from it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely

from facadelake.frames import Array
from facadelake.geobim.model import BuildingModel
from facadelake.geodesy import SiteOrigin


def outline_of(corners_site_m: Array) -> shapely.Geometry:
    """Outline in site x, y of triangles (m, 3, 3) seen from above; of a bare vertical sheet, a strip 1 cm wide."""
    flat = shapely.polygons(corners_site_m[:, :, :2])
    flat = flat[shapely.area(flat) > 1e-6]
    outline = shapely.union_all(flat, grid_size=1e-4) if len(flat) else shapely.Polygon()
    if outline.is_empty:
        outline = shapely.convex_hull(shapely.multipoints(corners_site_m[:, :, :2].reshape(-1, 2))).buffer(0.005)
    return outline.simplify(0.001)


def in_lon_lat(outline: shapely.Geometry, level_m: float, origin: SiteOrigin) -> shapely.Geometry:
    """An outline in site x, y, at ``level_m`` in site z, as lon, lat (EPSG:4979)."""

    def lon_lat(xy: Array) -> Array:
        return origin.geo_from_site(np.column_stack([xy, np.full(len(xy), level_m)]))[:, :2]

    return shapely.transform(outline, lon_lat)


def horizontal_distance(building: BuildingModel) -> Callable[[Array], Array]:
    """A function of places (n, 2: lon_deg, lat_deg): their distance (n,) in metres from the building's plan."""
    plan = outline_of(building.vertices_site_m[building.triangles])
    shapely.prepare(plan)

    def distance(lon_lat_deg: Array) -> Array:
        lon_lat = np.asarray(lon_lat_deg, dtype=np.float64).reshape(-1, 2)
        height = np.full(len(lon_lat), building.origin.height_ellipsoidal_m)
        xy = building.origin.site_from_geo(np.column_stack([lon_lat, height]))[:, :2]
        metres: Array = np.asarray(shapely.distance(plan, shapely.points(xy)), dtype=np.float64)
        return metres

    return distance
