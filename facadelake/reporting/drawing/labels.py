"""Labels of defects: short texts, and positions beside their boxes without overlaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from facadelake.core.arrays import Float64Array, Float64Nx2

_DIRECTIONS = 16
_RINGS = 9


def label_ids(ids: Sequence[str]) -> dict[str, str]:
    """A short label for each id: the id without the prefix common to all ids and without leading zeros.

    "D0001" and "D0012" give "1" and "12". Where a label would be longer than four characters, empty or ambiguous, all
    ids are numbered 1, 2, ... instead.
    """
    if not ids:
        return {}
    first, last = min(ids), max(ids)
    prefix = 0
    while prefix < min(len(first), len(last)) and first[prefix] == last[prefix]:
        prefix += 1
    while prefix > 0 and first[prefix - 1].isdigit():
        prefix -= 1
    labels = {name: name[prefix:].lstrip("0") for name in ids}
    if all(0 < len(label) <= 4 for label in labels.values()) and len(set(labels.values())) == len(labels):
        return labels
    return {name: str(rank) for rank, name in enumerate(ids, start=1)}


def _compute_overlap(boxes: Float64Array, others: Float64Array) -> Float64Array:
    """Area of overlap (n, m) of boxes (n, 4) and others (m, 4), both left, bottom, right, top."""
    width = np.minimum(boxes[:, None, 2], others[None, :, 2]) - np.maximum(boxes[:, None, 0], others[None, :, 0])
    height = np.minimum(boxes[:, None, 3], others[None, :, 3]) - np.maximum(boxes[:, None, 1], others[None, :, 1])
    area: Float64Array = np.clip(width, 0, None) * np.clip(height, 0, None)
    return area


def place_labels(boxes: Float64Array, sizes: Float64Array, bounds: Float64Array) -> Float64Nx2:
    """Centres (n, 2) of labels beside their boxes, by a greedy search; the most crowded boxes are labelled first.

    The cost of a candidate position is the overlap with labels placed before, then with boxes, then the distance.

    Args:
        boxes: boxes to be labelled, (n, 4): left, bottom, right, top. All lengths in one unit, such as pixels; y may
            point up or down.
        sizes: width and height of each label, (n, 2).
        bounds: area that labels must not leave, (4,): left, bottom, right, top.

    Returns:
        Centres of the labels, (n, 2).
    """
    occupied = np.zeros((0, 4))
    centres = np.zeros((len(boxes), 2))
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    unit = np.column_stack([np.sin(angle), np.cos(angle)])
    neighbours = _compute_overlap(boxes + np.array([-30, -30, 30, 30]), boxes).astype(bool).sum(axis=1)
    for row in np.argsort(-neighbours, kind="stable"):
        box, size = boxes[row], sizes[row]
        centre, half = (box[:2] + box[2:]) / 2, (box[2:] - box[:2] + size) / 2
        rings = [unit * (half + 2 + ring * 0.8 * size[1]) for ring in range(_RINGS)]
        candidates = centre + np.vstack(rings)
        extents = np.hstack([candidates - size / 2, candidates + size / 2])
        outside = (np.maximum(bounds[:2] - extents[:, :2], 0) + np.maximum(extents[:, 2:] - bounds[2:], 0)).sum(axis=1)
        cost = (
            50.0 * _compute_overlap(extents, occupied).sum(axis=1) / size.prod()
            + 4.0 * _compute_overlap(extents, boxes).sum(axis=1) / size.prod()
            + 100.0 * (outside > 0)
            + np.repeat(np.arange(_RINGS), _DIRECTIONS) * 0.6
        )
        best = int(np.argmin(cost))
        centres[row] = candidates[best]
        occupied = np.vstack([occupied, extents[best]])
    return centres
