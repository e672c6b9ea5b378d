"""The pixel that shows the middle of what a detection encloses, as it lies on the surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from facadelake.building.surface import Hits
from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.registration.outline import Outlines
from facadelake.registration.patch import compute_tangents

_BENT_COSINE = 0.87  # 30 deg: a curved wall bends less within a defect, a corner more


def find_mask_centre(
    outlines: Outlines, hits: Hits, pixel_m2: Float64Array, row: int, polygon_site: Any, camera: PosedCamera
) -> Float64Array:
    """The pixel (2,) of a mask's middle: the centroid of its area on the surface.

    Other than the centroid of its pixels, it is one place for all photographs. Round a corner, where the outline cannot
    be laid flat, it is that of the pixels' areas.
    """
    first, last = np.searchsorted(outlines.detection, (row, row + 1))
    own = slice(first, last)
    met = pixel_m2[own] > 0
    weight, normals, xyz = pixel_m2[own][met], hits.normal_site[own][met], hits.xyz_site_m[own][met]
    middle = np.average(xyz, axis=0, weights=weight)
    facing = weight @ normals
    facing /= max(float(np.linalg.norm(facing)), 1e-12)
    if np.all(normals @ facing > _BENT_COSINE):
        axes = np.vstack([*(tangent[0] for tangent in compute_tangents(facing[None])), facing])
        flat = shapely.transform(polygon_site, lambda xyz: (xyz - middle) @ axes.T, include_z=True)
        middle = middle + shapely.get_coordinates(shapely.centroid(flat))[0] @ axes[:2]
    pixel: Float64Array = camera.project_site(middle[None])[0]
    return pixel


def find_box_centres(outlines: Outlines, depth_m: Float64Array, member: BoolArray, rows: RowIndices) -> Float64Array:
    """The pixels (m, 2) of the middles of what boxes ``rows`` (m,) enclose; ``depth_m``, ``member`` (k,) of all pixels.

    What is nearer looks larger, so a box's centre lies too near: the image of a segment's middle is the mean of its
    ends' images, weighted by their depths. A box that is not wholly on one surface keeps its centre.
    """
    middle: Float64Array = outlines.centre_img[rows].copy()
    first = np.searchsorted(outlines.detection, rows)
    side = np.sqrt(np.searchsorted(outlines.detection, rows, side="right") - first).astype(np.int64)
    for number in np.unique(side):
        mine = np.flatnonzero(side == number)
        cells = first[mine, None] + np.arange(number * number)
        whole = member[cells].all(axis=1)
        mine, cells = mine[whole], cells[whole].reshape(-1, number, number)
        half_px = outlines.pitch_px[rows[mine]] * number / 2
        # On a plane the inverse of the depth is linear in pixels, so it goes on from the last pixels to the edges.
        for axis, line in ((0, cells[:, number // 2, :]), (1, cells[:, :, number // 2])):
            low, high = 1 / depth_m[line[:, 0]], 1 / depth_m[line[:, -1]]
            beyond = (high - low) / (2 * (number - 1))
            low, high = low - beyond, high + beyond
            seen = (low > 0) & (high > 0)  # else the plane's horizon runs through the box
            middle[mine[seen], axis] += half_px[seen, axis] * ((low - high) / (low + high))[seen]
    return middle
