"""The pixel that shows the centre, on the surface, of the area that a detection encloses."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely

from facadelake.building.surface import Hits
from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx2, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.registration.outline import Outlines
from facadelake.registration.patch import compute_tangents

_PLANAR_COSINE = 0.87  # 30 deg: a curved wall turns by less within a defect, a corner by more


def find_mask_centre(
    outlines: Outlines, hits: Hits, pixel_m2: Float64N, row: int, polygon_site: Any, camera: PosedCamera
) -> Float64Array:
    """The pixel of a mask's centre: the centroid of its area on the surface.

    Unlike the centroid of its pixels, it is the same point in all photographs. Around a corner, where the outline
    cannot be flattened, it is the centroid of the pixels weighted by their areas on the surface.

    Args:
        outlines: the outlines (n) with their samples (k).
        hits: hits of the samples (k).
        pixel_m2: area (k,) of the sample's pixel on the surface; 0 where it is no member.
        row: row of the detection.
        polygon_site: its outline on the surface, shapely polygon in site.
        camera: its photograph's camera.

    Returns:
        Pixel (2,).
    """
    first, last = np.searchsorted(outlines.detection, (row, row + 1))
    samples = slice(first, last)
    valid = pixel_m2[samples] > 0
    weight, normals, xyz = pixel_m2[samples][valid], hits.normal_site[samples][valid], hits.xyz_site_m[samples][valid]
    centre = np.average(xyz, axis=0, weights=weight)
    facing = weight @ normals
    facing /= max(float(np.linalg.norm(facing)), 1e-12)
    if np.all(normals @ facing > _PLANAR_COSINE):
        axes = np.vstack([*(tangent[0] for tangent in compute_tangents(facing[None])), facing])
        flat = shapely.transform(polygon_site, lambda xyz: (xyz - centre) @ axes.T, include_z=True)
        centre = centre + shapely.get_coordinates(shapely.centroid(flat))[0] @ axes[:2]
    pixel: Float64Array = camera.project_site(centre[None])[0]
    return pixel


def find_box_centres(outlines: Outlines, depth_m: Float64N, member: BoolArray, rows: RowIndices) -> Float64Nx2:
    """The pixels of the centres of what boxes enclose.

    What is nearer appears larger, so a box's centre is too near: the image of the midpoint of a segment is the mean of
    the images of its ends, weighted by their depths. A box that is not entirely on one surface keeps its centre.

    Args:
        outlines: the outlines (n) with their samples (k).
        depth_m: depth (k,) of the samples.
        member: which samples (k,) belong to their detection's patch.
        rows: rows (m,) of the boxes.

    Returns:
        Pixels (m, 2).
    """
    centre: Float64Array = outlines.centre_img[rows].copy()
    first = np.searchsorted(outlines.detection, rows)
    side = np.sqrt(np.searchsorted(outlines.detection, rows, side="right") - first).astype(np.int64)
    for number in np.unique(side):
        selected = np.flatnonzero(side == number)
        cells = first[selected, None] + np.arange(number * number)
        complete = member[cells].all(axis=1)
        selected, cells = selected[complete], cells[complete].reshape(-1, number, number)
        half_px = outlines.pitch_px[rows[selected]] * number / 2
        # On a plane the inverse depth is linear in pixels, so it is extrapolated from the last samples to the edges.
        for axis, line in ((0, cells[:, number // 2, :]), (1, cells[:, :, number // 2])):
            low, high = 1 / depth_m[line[:, 0]], 1 / depth_m[line[:, -1]]
            half_step = (high - low) / (2 * (number - 1))
            low, high = low - half_step, high + half_step
            seen = (low > 0) & (high > 0)  # otherwise the plane's horizon is in the box
            centre[selected[seen], axis] += half_px[seen, axis] * ((low - high) / (low + high))[seen]
    return centre
