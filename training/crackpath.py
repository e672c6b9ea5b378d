"""Where a crack runs inside its box, so that a box can be drawn anew when a picture is turned or cut.

A box about a crack says little of what is left of it in a part of the picture: half of a diagonal crack has a quarter
of its box. The darkest way through the box from end to end is found once, and carried along.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.graph import route_through_array

_SIDE_PX = 128  # the box is looked at in this size: ways through are found in milliseconds
_DIAGONAL = 0.5  # a box whose short side is more than this of its long side may be crossed both ways
_STEP_COST = 0.03  # against ways that wind


@dataclass(frozen=True, kw_only=True)
class CrackPath:
    """Points (n, 2) along a crack in pixels of its picture, and how far its box was drawn beyond them on each side
    (left, top, right, bottom; pixels)."""

    points_px: NDArray[np.float32]
    margin_px: NDArray[np.float32]


def crack_path(image_bgr: NDArray[np.uint8], box_px: NDArray[np.float64]) -> CrackPath:
    """The darkest way from end to end of the box (x_min, y_min, x_max, y_max)."""
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
    ways = []
    if size[0] >= _DIAGONAL * size[1]:
        ways.append(_across(cost))
    if size[1] >= _DIAGONAL * size[0]:
        rows, mean = _across(cost.T)
        ways.append((rows[:, ::-1], mean))
    rows = min(ways, key=lambda way: way[1])[0]
    gain = np.array([width / size[0], height / size[1]])
    points = ((rows[:, ::-1] + 0.5) * gain + [left, top]).astype(np.float32)
    low, high = points.min(axis=0), points.max(axis=0)
    margin = np.concatenate([low - box_px[:2], box_px[2:] - high])
    return CrackPath(points_px=points, margin_px=np.clip(margin, 0, None).astype(np.float32))


def _across(cost: NDArray[np.float32]) -> tuple[NDArray[np.int64], float]:
    """Points (row, column) of the cheapest way from the left edge to the right one, and its mean cost."""
    free = np.pad(cost, ((0, 0), (1, 1)), constant_values=1e-6)  # along the edges it may go for nothing
    way, _ = route_through_array(
        free, (0, 0), (free.shape[0] - 1, free.shape[1] - 1), fully_connected=True, geometric=True
    )
    points = np.array(way)
    points = points[(points[:, 1] > 0) & (points[:, 1] <= cost.shape[1])] - [0, 1]
    return points, float(cost[points[:, 0], points[:, 1]].mean())
