"""Agreement of detections in two overlapping tiles: whether they can be of one object.

Compared is what each detection covers in the strip that both tiles share.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx4, RowIndices

Shapes = Sequence[shapely.Geometry | None]

# Weight of the IoU of boxes in the strip, where no line through both boxes agrees.
_BOX_WEIGHT = 0.5
# Iterations of the direction estimate, and the smallest probability of a direction that is considered.
_ITERATIONS = 5
_DIRECTION_MIN = 0.4
# A detection with this line agreement to some other one is linear. Between two linear ones the IoU of boxes counts only
# if it is this high along a strip of this aspect ratio (in the corner that four tiles share it is always high).
_LINE_MIN = 0.6
_BOX_IOU_MIN = 0.7
_ASPECT_RATIO_MIN = 1.5


def score_agreement(
    corners: Float64Nx4, masks: Shapes, first: RowIndices, second: RowIndices, overlap: Float64Nx4, tolerance_px: float
) -> Float64N:
    """Score the agreement of pairs of detections in the overlap of their tiles.

    Two masks agree by the share of the smaller one that lies in the other. Boxes agree by a line along the same
    diagonal of both: an elongated object crosses all tiles in one direction, falling or rising, which is estimated from
    all pairs. Otherwise boxes agree by half their IoU in the overlap.

    Args:
        corners: Boxes of all detections (n, 4: left, top, right, bottom) in pixels of the photograph.
        masks: Masks of all detections (n), None where there is none.
        first: First detection of each pair (k,).
        second: Second detection of each pair (k,).
        overlap: Overlap of the two tiles of each pair (k, 4).
        tolerance_px: Tolerance of edges.

    Returns:
        Agreement (k,), from 0 to 1.
    """
    a, b = corners[first], corners[second]
    lines = np.stack(
        [
            _compute_box_ious(_clip_diagonals(a, overlap, up), _clip_diagonals(b, overlap, up), tolerance_px)
            for up in (False, True)
        ]
    )
    direction = _estimate_directions(lines, first, second, len(corners))
    possible = (direction[:, first] >= _DIRECTION_MIN) & (direction[:, second] >= _DIRECTION_MIN)
    line = np.where(possible, lines, 0.0).max(axis=0)
    linearity = np.zeros(len(corners))
    np.maximum.at(linearity, first, line)
    np.maximum.at(linearity, second, line)
    box_iou = _compute_box_ious(intersect_boxes(a, overlap), intersect_boxes(b, overlap), tolerance_px)
    sides = np.sort(overlap[:, 2:] - overlap[:, :2], axis=1)
    box_counts = (box_iou >= _BOX_IOU_MIN) & (sides[:, 1] >= _ASPECT_RATIO_MIN * sides[:, 0])
    box_counts |= (linearity[first] < _LINE_MIN) | (linearity[second] < _LINE_MIN)
    agreement = np.maximum(line, np.where(box_counts, _BOX_WEIGHT * box_iou, 0.0))
    shapes = np.array(masks, dtype=object)
    masked = ~shapely.is_missing(shapes)
    rows = np.flatnonzero(masked[first] & masked[second])
    agreement[rows] = _compare_masks(
        shapes[first[rows]], shapes[second[rows]], shapely.box(*overlap[rows].T), tolerance_px
    )
    return np.asarray(agreement)


def _estimate_directions(lines: Float64Array, first: RowIndices, second: RowIndices, count: int) -> Float64Array:
    """Probability (2, n) that each detection falls, and rises: propagated from its pairs by ``lines`` (2, k)."""
    direction = np.full((2, count), 0.5)
    for _ in range(_ITERATIONS):
        votes = np.full((2, count), 1e-6)
        for way in (0, 1):
            np.add.at(votes[way], first, lines[way] * direction[way, second])
            np.add.at(votes[way], second, lines[way] * direction[way, first])
        direction = votes / votes.sum(axis=0)
    return direction


def intersect_boxes(a: Float64Nx4, b: Float64Nx4) -> Float64Nx4:
    """Intersections of boxes (n, 4); left > right or top > bottom where it is empty."""
    return np.column_stack([np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, 2:], b[:, 2:])])


def compute_areas(corners: Float64Nx4) -> Float64N:
    """Areas (n,) of boxes in square pixels; 0 where a box is empty."""
    area: Float64N = np.prod(np.clip(corners[:, 2:] - corners[:, :2], 0.0, None), axis=1)
    return area


def grow_boxes(corners: Float64Nx4, by_px: float) -> Float64Nx4:
    """Boxes with all sides moved outwards by ``by_px``."""
    larger: Float64Nx4 = corners + np.array([-by_px, -by_px, by_px, by_px])
    return larger


def compute_contained_shares(part: Float64Nx4, whole: Float64Nx4) -> Float64N:
    """Share (n,) of the area of each box ``part`` that lies in its ``whole``."""
    share: Float64N = compute_areas(intersect_boxes(part, whole)) / np.maximum(compute_areas(part), 1e-9)
    return share


def compute_iou(a: shapely.Geometry, b: shapely.Geometry) -> float:
    """Intersection over union of two areas."""
    intersection = a.intersection(b).area
    return float(intersection / max(a.area + b.area - intersection, 1e-9))


def _compute_box_ious(a: Float64Nx4, b: Float64Nx4, tolerance_px: float) -> Float64N:
    """Intersection over union (n,) of boxes grown by the tolerance; 0 where a box is empty."""
    valid = (a[:, 2:] >= a[:, :2]).all(axis=1) & (b[:, 2:] >= b[:, :2]).all(axis=1)
    a, b = grow_boxes(a, tolerance_px), grow_boxes(b, tolerance_px)
    intersection = compute_areas(intersect_boxes(a, b))
    union = np.maximum(compute_areas(a) + compute_areas(b) - intersection, 1e-9)
    iou: Float64N = np.where(valid, intersection / union, 0.0)
    return iou


def _clip_diagonals(box: Float64Nx4, window: Float64Nx4, up: bool) -> Float64Nx4:
    """Bounding box of a box's diagonal within the window: from left top to right bottom, or from left bottom ``up``."""
    start = np.column_stack([box[:, 0], box[:, 3] if up else box[:, 1]])
    step = np.column_stack([box[:, 2] - box[:, 0], (box[:, 1] - box[:, 3]) if up else (box[:, 3] - box[:, 1])])
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    parameter = np.stack([(window[:, :2] - start) / safe, (window[:, 2:] - start) / safe])
    low = np.clip(parameter.min(axis=0).max(axis=1), 0.0, None)[:, None]
    high = np.clip(parameter.max(axis=0).min(axis=1), None, 1.0)[:, None]
    ends = np.stack([start + low * step, start + high * step])
    bounds = np.column_stack([ends.min(axis=0), ends.max(axis=0)])
    return np.where(low <= high, bounds, np.array([1.0, 1.0, 0.0, 0.0]))


def _compare_masks(a: Any, b: Any, window: Any, tolerance_px: float) -> Float64N:
    """Share (k,) of the smaller mask in the window that lies in the larger one, grown by the tolerance of edges."""
    a_inside, b_inside = shapely.intersection(a, window), shapely.intersection(b, window)
    swapped = shapely.area(a_inside) > shapely.area(b_inside)
    small, large = np.where(swapped, b_inside, a_inside), np.where(swapped, a_inside, b_inside)
    near = np.flatnonzero((shapely.area(small) > 0) & (shapely.distance(small, large) < tolerance_px))
    share = np.zeros(len(small))
    grown = shapely.buffer(large[near], tolerance_px, quad_segs=2)
    share[near] = shapely.area(shapely.intersection(small[near], grown)) / shapely.area(small[near])
    return share
