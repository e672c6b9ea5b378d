"""The building model in grey, seen from above or from a side, as the ground of plans."""

from __future__ import annotations

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from facadelake.building import BuildingModel
from facadelake.core.arrays import Float64Array


def draw_model(
    axes: Axes, building: BuildingModel, across: Float64Array, up: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Draw the elements' triangles seen against ``across`` x ``up`` (unit vectors (3,) of site), the nearest last.

    Returns the corners (2,) of their extent along ``across`` and ``up``, metres.
    """
    corners = building.vertices_site_m[building.triangles]
    flat, near = corners @ np.column_stack([across, up]), corners @ np.cross(across, up)
    is_area = np.abs(shapely.area(shapely.polygons(flat))) > 1e-4
    order = np.argsort(near[is_area].max(axis=1))
    depth = near[is_area].max(axis=1)[order]
    share = (depth - depth.min()) / max(float(np.ptp(depth)), 1e-6) if len(depth) else depth
    shade = 0.90 - 0.18 * share
    axes.add_collection(
        PolyCollection(flat[is_area][order], facecolors=np.column_stack([shade] * 3), edgecolors="face", linewidths=0.3)
    )
    return flat.reshape(-1, 2).min(axis=0), flat.reshape(-1, 2).max(axis=0)
