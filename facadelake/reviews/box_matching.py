"""Matching of two sets of boxes by intersection over union (IoU): greedy, the best pair first, each box once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.detection import Box


@dataclass(frozen=True, kw_only=True)
class BoxPair:
    """Index ``first`` of a box of the first set, ``second`` of one of the second set, and the score of the pair."""

    first: int
    second: int
    score: float


def corners_from_boxes(boxes: Iterable[Box]) -> Float64Array:
    """Boxes as corners (n, 4): left, top, right, bottom, px."""
    rows = [(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px) for box in boxes]
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def compute_iou(first: Float64Array, second: Float64Array) -> Float64Array:
    """Intersection over union (n, m) of corners (n, 4) and (m, 4); 0 where both boxes are empty."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    intersection = np.prod(np.clip(high - low, 0.0, None), axis=2)
    areas = [np.prod(boxes[:, 2:] - boxes[:, :2], axis=1) for boxes in (first, second)]
    union = areas[0][:, None] + areas[1][None, :] - intersection
    iou: Float64Array = np.divide(intersection, union, out=np.zeros_like(intersection), where=union > 0)
    return iou


def pair_greedily(scores: Float64Array, score_min: float) -> tuple[BoxPair, ...]:
    """Pairs of rows and columns of ``scores`` (n, m) with ``score_min`` or more; the best first, each row and column
    at most once."""
    rows, columns = np.nonzero(scores >= score_min)
    order = np.argsort(-scores[rows, columns], kind="stable")
    taken_rows: set[int] = set()
    taken_columns: set[int] = set()
    pairs = []
    for i in order:
        row, column = int(rows[i]), int(columns[i])
        if row not in taken_rows and column not in taken_columns:
            taken_rows.add(row)
            taken_columns.add(column)
            pairs.append(BoxPair(first=row, second=column, score=float(scores[row, column])))
    return tuple(pairs)
