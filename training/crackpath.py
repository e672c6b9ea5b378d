"""Path of a crack inside its box, from which a new box is computed after a rotation or a cut of the picture.

The box of a crack does not determine the box of its part in a part of the picture: half of a diagonal crack has a
quarter of the box. The darkest path through the box from end to end is computed once and transformed with the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from skimage.graph import route_through_array

from facadelake.core.arrays import Float32Array, Float64Array, Int64Array, UInt8Image

_SIDE_PX = 128  # the box is reduced to this size, in which a path is found within milliseconds
_ASPECT_MIN = 0.5  # from this ratio of short to long side, paths are searched in both directions
_STEP_COST = 0.03  # cost per pixel of length, against winding paths


@dataclass(frozen=True, kw_only=True)
class CrackPath:
    """Points (n, 2) along a crack, and margins (4,: left, top, right, bottom) of its box beyond them, in pixels."""

    points_px: Float32Array
    margin_px: Float32Array


def trace_crack(image_bgr: UInt8Image, box_px: Float64Array) -> CrackPath:
    """Find the darkest path from end to end of a box (x_min, y_min, x_max, y_max; px) of a picture (h, w, 3)."""
    left, top, right, bottom = (int(v) for v in np.round(box_px))
    left, top = max(left, 0), max(top, 0)
    right, bottom = max(right, left + 2), max(bottom, top + 2)
    grey = cv2.cvtColor(image_bgr[top:bottom, left:right], cv2.COLOR_BGR2GRAY)
    height, width = grey.shape
    scale = min(1.0, _SIDE_PX / max(grey.shape))
    size = (max(2, round(width * scale)), max(2, round(height * scale)))
    small = cv2.resize(cv2.GaussianBlur(grey, (0, 0), max(0.3 / scale, 0.6)), size, interpolation=cv2.INTER_AREA)
    dark = cv2.morphologyEx(small, cv2.MORPH_BLACKHAT, np.ones((11, 11), np.uint8)).astype(np.float32)
    ridge = np.clip(dark / max(float(np.percentile(dark, 97)), 4.0), 0, 1)
    cost = (1 - ridge) ** 2 + _STEP_COST
    paths = []
    if size[0] >= _ASPECT_MIN * size[1]:
        paths.append(_find_path_across(cost))
    if size[1] >= _ASPECT_MIN * size[0]:
        rows, mean = _find_path_across(cost.T)
        paths.append((rows[:, ::-1], mean))
    rows = min(paths, key=lambda path: path[1])[0]
    gain = np.array([width / size[0], height / size[1]])
    points = ((rows[:, ::-1] + 0.5) * gain + [left, top]).astype(np.float32)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = np.concatenate([low - box_px[:2], box_px[2:] - high])
    return CrackPath(points_px=points, margin_px=np.clip(margin, 0, None).astype(np.float32))


def _find_path_across(cost: Float32Array) -> tuple[Int64Array, float]:
    """Points (n, 2: row, column) of the path of lowest cost from the left to the right edge, and its mean cost."""
    free = np.pad(cost, ((0, 0), (1, 1)), constant_values=1e-6)  # movement along both edges is free
    path, _ = route_through_array(
        free, (0, 0), (free.shape[0] - 1, free.shape[1] - 1), fully_connected=True, geometric=True
    )
    points = np.array(path)
    points = points[(points[:, 1] > 0) & (points[:, 1] <= cost.shape[1])] - [0, 1]
    return points, float(cost[points[:, 0], points[:, 1]].mean())
