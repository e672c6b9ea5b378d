"""Which boxes of two sets stand for one another: by intersection over union, the best pairs first, each box once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.detection import Box


@dataclass(frozen=True, kw_only=True)
class BoxPair:
    """Box ``first`` of the first set and ``second`` of the second, by their places, and how far they overlap (0..1)."""

    first: int
    second: int
    iou: float


def corners_from_boxes(boxes: Iterable[Box]) -> Float64Array:
    """Boxes as (n, 4): left, top, right, bottom, in their pixels."""
    rows = [(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px) for box in boxes]
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def compute_iou(ones: Float64Array, others: Float64Array) -> Float64Array:
    """Intersection over union (n, m) of corners (n, 4) and (m, 4)."""
    low = np.maximum(ones[:, None, :2], others[None, :, :2])
    high = np.minimum(ones[:, None, 2:], others[None, :, 2:])
    shared = np.prod(np.clip(high - low, 0.0, None), axis=2)
    areas = [np.prod(boxes[:, 2:] - boxes[:, :2], axis=1) for boxes in (ones, others)]
    whole = areas[0][:, None] + areas[1][None, :] - shared
    share: Float64Array = np.divide(shared, whole, out=np.zeros_like(shared), where=whole > 0)
    return share


def pair_greedily(shares: Float64Array, least: float) -> tuple[BoxPair, ...]:
    """Pairs of rows and columns of ``shares`` (n, m) from ``least`` on, the largest first, none of them twice."""
    rows, columns = np.nonzero(shares >= least)
    order = np.argsort(-shares[rows, columns], kind="stable")
    taken_rows: set[int] = set()
    taken_columns: set[int] = set()
    found = []
    for i in order:
        row, column = int(rows[i]), int(columns[i])
        if row not in taken_rows and column not in taken_columns:
            taken_rows.add(row)
            taken_columns.add(column)
            found.append(BoxPair(first=row, second=column, iou=float(shares[row, column])))
    return tuple(found)


def matched(ones: Sequence[Box], others: Sequence[Box], least: float) -> tuple[BoxPair, ...]:
    """Pairs of boxes that overlap by ``least`` or more."""
    return pair_greedily(compute_iou(corners_from_boxes(ones), corners_from_boxes(others)), least)
