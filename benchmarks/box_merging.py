"""Common methods of merging the boxes of overlapping tiles, for comparison: NMS, NMM, WBF; boxes of one class."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx4


def suppress_boxes(boxes: Float64Nx4, scores: Float64N, *, limit: float = 0.5) -> Float64Nx4:
    """Greedy non-maximum suppression (NMS) of boxes (n, 4: left, top, right, bottom).

    A box whose intersection over union with a box of higher score is ``limit`` or more is removed.
    """
    kept: list[int] = []
    for i in np.argsort(-scores, kind="stable"):
        if not kept or _compute_overlaps(boxes[i], boxes[kept])[0].max() < limit:
            kept.append(int(i))
    return boxes[kept]


def merge_boxes(boxes: Float64Nx4, scores: Float64N, *, limit: float = 0.5) -> Float64Nx4:
    """Greedy non-maximum merging (NMM) as in SAHI's GREEDYNMM, of boxes (n, 4: left, top, right, bottom).

    A box is merged into the box of highest score where the two share ``limit`` of the smaller one's area.
    """
    left = np.argsort(-scores, kind="stable")
    out = []
    while len(left):
        best = boxes[left[0]]
        joins = _compute_overlaps(best, boxes[left])[1] >= limit
        joins[0] = True
        some = boxes[left[joins]]
        out.append(np.concatenate([some[:, :2].min(axis=0), some[:, 2:].max(axis=0)]))
        left = left[~joins]
    return np.array(out).reshape(-1, 4)


def fuse_boxes(boxes: Float64Nx4, scores: Float64N, *, limit: float = 0.55) -> Float64Nx4:
    """Weighted boxes fusion (WBF; Solovyev et al. 2021) of boxes (n, 4: left, top, right, bottom).

    A box whose intersection over union with a cluster's mean is ``limit`` or more joins the cluster; the mean is
    weighted by score.
    """
    members: list[list[int]] = []
    means: list[Float64Array] = []
    for i in np.argsort(-scores, kind="stable"):
        fits = _compute_overlaps(boxes[i], np.array(means))[0] if means else np.zeros(0)
        if len(fits) and fits.max() >= limit:
            k = int(fits.argmax())
            members[k].append(int(i))
            means[k] = np.average(boxes[members[k]], axis=0, weights=scores[members[k]])
        else:
            members.append([int(i)])
            means.append(boxes[i])
    return np.array(means).reshape(-1, 4)


def _compute_overlaps(box: Float64Array, others: Float64Nx4) -> tuple[Float64Array, Float64Array]:
    """Intersection over union, and over the smaller area, of a box (4,) with others (n, 4)."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    both = np.prod(np.clip(sides, 0.0, None), axis=1)
    area, areas = np.prod(box[2:] - box[:2]), np.prod(others[:, 2:] - others[:, :2], axis=1)
    return both / np.maximum(area + areas - both, 1e-9), both / np.maximum(np.minimum(area, areas), 1e-9)
