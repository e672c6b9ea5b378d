"""Whether parts seen in two tiles can be the same thing: by what each would show in the strip that both tiles share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from facadelake.core.arrays import Float64Array, RowIndices

Corners = Float64Array  # (n, 4): left, top, right, bottom in pixels of the photograph
Shapes = Sequence[shapely.Geometry | None]

# Boxes that agree as a whole, without a line through both, count for half.
_BOX_WEIGHT = 0.5
# Rounds in which parts tell one another which way they run, and how much of a belief a way needs to be held possible.
_ITERATIONS = 5
_DIRECTION_MIN = 0.4
# A part that goes on as a line so well somewhere is one; of two such, boxes as a whole tell something where they agree
# by so much along a strip that is so much longer than wide (in the corner that four tiles share they always do).
_LINE_MIN = 0.6
_BOX_IOU_MIN = 0.7
_ASPECT_RATIO_MIN = 1.5


def score_agreement(
    corners: Corners, masks: Shapes, first: RowIndices, second: RowIndices, window: Corners, slack_px: float
) -> Float64Array:
    """How well parts ``first`` and ``second`` (k) of all parts (n) agree in ``window`` (k), 0 to 1.

    Masks tell it where both have one: the share of the smaller that lies in the other. Boxes tell it by a line along
    the same diagonal of both: what is long runs through tile after tile in the same direction, falling or rising, which
    its parts tell one another; boxes that agree as a whole count for half. Edges may be wrong by ``slack_px``.
    """
    a, b = corners[first], corners[second]
    lines = np.stack(
        [
            _compute_box_ious(_clip_diagonals(a, window, up), _clip_diagonals(b, window, up), slack_px)
            for up in (False, True)
        ]
    )
    belief = _estimate_directions(lines, first, second, len(corners))
    possible = (belief[:, first] >= _DIRECTION_MIN) & (belief[:, second] >= _DIRECTION_MIN)
    line = np.where(possible, lines, 0.0).max(axis=0)
    runs = np.zeros(len(corners))
    np.maximum.at(runs, first, line)
    np.maximum.at(runs, second, line)
    filled = _compute_box_ious(intersect_boxes(a, window), intersect_boxes(b, window), slack_px)
    sides = np.sort(window[:, 2:] - window[:, :2], axis=1)
    telling = (filled >= _BOX_IOU_MIN) & (sides[:, 1] >= _ASPECT_RATIO_MIN * sides[:, 0])
    telling |= (runs[first] < _LINE_MIN) | (runs[second] < _LINE_MIN)
    fit = np.maximum(line, np.where(telling, _BOX_WEIGHT * filled, 0.0))
    shapes = np.array(masks, dtype=object)
    masked = ~shapely.is_missing(shapes)
    rows = np.flatnonzero(masked[first] & masked[second])
    fit[rows] = _compare_masks(shapes[first[rows]], shapes[second[rows]], shapely.box(*window[rows].T), slack_px)
    return np.asarray(fit)


def _estimate_directions(lines: Float64Array, first: RowIndices, second: RowIndices, count: int) -> Float64Array:
    """How likely (2, n) each part runs falling, and rising: as those it meets do, by how well (2, k) they meet so."""
    belief = np.full((2, count), 0.5)
    for _ in range(_ITERATIONS):
        told = np.full((2, count), 1e-6)
        for way in (0, 1):
            np.add.at(told[way], first, lines[way] * belief[way, second])
            np.add.at(told[way], second, lines[way] * belief[way, first])
        belief = told / told.sum(axis=0)
    return belief


def intersect_boxes(a: Corners, b: Corners) -> Corners:
    """What boxes a and b (n, 4) share; turned inside out where that is nothing."""
    return np.column_stack([np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, 2:], b[:, 2:])])


def compute_areas(corners: Corners) -> Float64Array:
    """Areas (n,) in square pixels, 0 of what is turned inside out."""
    area: Float64Array = np.prod(np.clip(corners[:, 2:] - corners[:, :2], 0.0, None), axis=1)
    return area


def grow_boxes(corners: Corners, by_px: float) -> Corners:
    """Boxes with all sides moved outwards."""
    larger: Corners = corners + np.array([-by_px, -by_px, by_px, by_px])
    return larger


def compute_contained_shares(part: Corners, whole: Corners) -> Float64Array:
    """How much (n,) of each part's area lies in its whole."""
    share: Float64Array = compute_areas(intersect_boxes(part, whole)) / np.maximum(compute_areas(part), 1e-9)
    return share


def compute_iou(a: shapely.Geometry, b: shapely.Geometry) -> float:
    """Intersection over union of two areas."""
    both = a.intersection(b).area
    return float(both / max(a.area + b.area - both, 1e-9))


def _compute_box_ious(a: Corners, b: Corners, slack_px: float) -> Float64Array:
    """Intersection over union (n,) of boxes grown by the slack; 0 where one of them is turned inside out."""
    there = (a[:, 2:] >= a[:, :2]).all(axis=1) & (b[:, 2:] >= b[:, :2]).all(axis=1)
    a, b = grow_boxes(a, slack_px), grow_boxes(b, slack_px)
    both = compute_areas(intersect_boxes(a, b))
    share: Float64Array = np.where(there, both / np.maximum(compute_areas(a) + compute_areas(b) - both, 1e-9), 0.0)
    return share


def _clip_diagonals(box: Corners, window: Corners, up: bool) -> Corners:
    """Bounds of a box's diagonal within the window: from its left top down, or from its left bottom ``up``."""
    start = np.column_stack([box[:, 0], box[:, 3] if up else box[:, 1]])
    step = np.column_stack([box[:, 2] - box[:, 0], (box[:, 1] - box[:, 3]) if up else (box[:, 3] - box[:, 1])])
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    at = np.stack([(window[:, :2] - start) / safe, (window[:, 2:] - start) / safe])
    low = np.clip(at.min(axis=0).max(axis=1), 0.0, None)[:, None]
    high = np.clip(at.max(axis=0).min(axis=1), None, 1.0)[:, None]
    ends = np.stack([start + low * step, start + high * step])
    bounds = np.column_stack([ends.min(axis=0), ends.max(axis=0)])
    return np.where(low <= high, bounds, np.array([1.0, 1.0, 0.0, 0.0]))


def _compare_masks(a: Any, b: Any, window: Any, slack_px: float) -> Float64Array:
    """How much (k,) of the smaller mask's part in the window lies in the other's, grown by the slack of its edges."""
    one, two = shapely.intersection(a, window), shapely.intersection(b, window)
    turned = shapely.area(one) > shapely.area(two)
    small, large = np.where(turned, two, one), np.where(turned, one, two)
    there = np.flatnonzero((shapely.area(small) > 0) & (shapely.distance(small, large) < slack_px))
    share = np.zeros(len(small))
    around = shapely.buffer(large[there], slack_px, quad_segs=2)
    share[there] = shapely.area(shapely.intersection(small[there], around)) / shapely.area(small[there])
    return share
