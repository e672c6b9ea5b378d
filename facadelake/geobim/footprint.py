"""How far from the building, seen from above, a place is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely

from facadelake.frames import Array
from facadelake.geobim.model import BuildingModel


def horizontal_distance(building: BuildingModel) -> Callable[[Array], Array]:
    """A function of ``lon_deg, lat_deg`` (n, 2) giving metres (n,) to the nearest edge of the building in plan.

    Heights play no part, because those of photographs seldom name their datum.
    """
    corners = building.vertices_site_m[building.triangles][:, [0, 1, 2, 0], :2]
    edges = shapely.STRtree(shapely.linestrings(corners))

    def distance_m(lon_lat_deg: Array) -> Array:
        height = np.full((len(lon_lat_deg), 1), building.origin.height_ellipsoidal_m)
        points = building.origin.site_from_geo(np.hstack([lon_lat_deg, height]))[:, :2]
        indices, distances = edges.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
        out = np.full(len(points), np.inf)
        out[indices[0]] = distances
        return out

    return distance_m
