"""Labels beside boxes so that they can be read: greedy, nearest free place first."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import Float64Array

_DIRECTIONS = 16
_RINGS = 9


def _compute_overlap(boxes: Float64Array, others: Float64Array) -> Float64Array:
    """Overlapping area (n, m) of boxes (n, 4) and others (m, 4), both left, bottom, right, top."""
    width = np.minimum(boxes[:, None, 2], others[None, :, 2]) - np.maximum(boxes[:, None, 0], others[None, :, 0])
    height = np.minimum(boxes[:, None, 3], others[None, :, 3]) - np.maximum(boxes[:, None, 1], others[None, :, 1])
    area: Float64Array = np.clip(width, 0, None) * np.clip(height, 0, None)
    return area


def place_labels(boxes: Float64Array, sizes: Float64Array, bounds: Float64Array) -> Float64Array:
    """Middles (n, 2) of labels of ``sizes`` (n, 2: width, height) beside ``boxes`` (n, 4: left, bottom, right, top).

    ``bounds`` (4,) is the area they must stay in. Labels avoid one another first, then other boxes, then distance.
    All in one unit, such as pixels; y may point either way.
    """
    placed = np.zeros((0, 4))
    middles = np.zeros((len(boxes), 2))
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    unit = np.column_stack([np.sin(angle), np.cos(angle)])
    crowded = _compute_overlap(boxes + np.array([-30, -30, 30, 30]), boxes).astype(bool).sum(axis=1)
    for row in np.argsort(-crowded, kind="stable"):
        box, size = boxes[row], sizes[row]
        centre, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2] + size) / 2
        rings = [unit * (half + 2 + ring * 0.8 * size[1]) for ring in range(_RINGS)]
        candidates = centre + np.vstack(rings)
        at = np.hstack([candidates - size / 2, candidates + size / 2])
        outside = (np.maximum(bounds[:2] - at[:, :2], 0) + np.maximum(at[:, 2:] - bounds[2:], 0)).sum(axis=1)
        cost = (
            50.0 * _compute_overlap(at, placed).sum(axis=1) / size.prod()
            + 4.0 * _compute_overlap(at, boxes).sum(axis=1) / size.prod()
            + 100.0 * (outside > 0)
            + np.repeat(np.arange(_RINGS), _DIRECTIONS) * 0.6
        )
        best = int(np.argmin(cost))
        middles[row] = candidates[best]
        placed = np.vstack([placed, at[best]])
    return middles
