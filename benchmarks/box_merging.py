"""The usual ways to make one list of many tiles' boxes, for comparison: NMS, NMM, WBF; boxes of one class alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Boxes = NDArray[np.float64]  # (n, 4): left, top, right, bottom
Scores = NDArray[np.float64]


def nms(boxes: Boxes, scores: Scores, *, limit: float = 0.5) -> Boxes:
    """Greedy suppression: what overlaps a better box by ``limit`` (intersection over union) goes."""
    kept: list[int] = []
    for i in np.argsort(-scores, kind="stable"):
        if not kept or _overlaps(boxes[i], boxes[kept])[0].max() < limit:
            kept.append(int(i))
    return boxes[kept]


def nmm(boxes: Boxes, scores: Scores, *, limit: float = 0.5) -> Boxes:
    """Greedy merging as SAHI's GREEDYNMM: what overlaps the best box by ``limit`` of the smaller one joins it."""
    left = np.argsort(-scores, kind="stable")
    out = []
    while len(left):
        best = boxes[left[0]]
        joins = _overlaps(best, boxes[left])[1] >= limit
        joins[0] = True
        some = boxes[left[joins]]
        out.append(np.concatenate([some[:, :2].min(axis=0), some[:, 2:].max(axis=0)]))
        left = left[~joins]
    return np.array(out).reshape(-1, 4)


def wbf(boxes: Boxes, scores: Scores, *, limit: float = 0.55) -> Boxes:
    """Weighted boxes fusion (Solovyev et al. 2021): boxes that overlap a cluster's mean by ``limit`` shift it."""
    members: list[list[int]] = []
    means: list[NDArray[np.float64]] = []
    for i in np.argsort(-scores, kind="stable"):
        fits = _overlaps(boxes[i], np.array(means))[0] if means else np.zeros(0)
        if len(fits) and fits.max() >= limit:
            k = int(fits.argmax())
            members[k].append(int(i))
            means[k] = np.average(boxes[members[k]], axis=0, weights=scores[members[k]])
        else:
            members.append([int(i)])
            means.append(boxes[i])
    return np.array(means).reshape(-1, 4)


def _overlaps(box: NDArray[np.float64], others: Boxes) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Intersection over union, and over the smaller of the two, of a box with others (n, 4)."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    both = np.prod(np.clip(sides, 0.0, None), axis=1)
    area, areas = np.prod(box[2:] - box[:2]), np.prod(others[:, 2:] - others[:, :2], axis=1)
    return both / np.maximum(area + areas - both, 1e-9), both / np.maximum(np.minimum(area, areas), 1e-9)
