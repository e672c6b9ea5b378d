"""Assignment of the network's cells to boxes in training: SimOTA.

Source: Ge et al., YOLOX: Exceeding YOLO Series in 2021, arXiv 2107.08430, section 2.3, and Ge et al., OTA, CVPR 2021.
It is in numpy: it has no gradient, and for a few boxes it is faster than torch on a CPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Int64Array

STRIDES = (8, 16, 32)
CENTRE_RADIUS = 2.5  # in cells: cells this near to the centre of a box may be assigned to it
IOU_WEIGHT = 3.0
SUMMED_IOUS = 10  # number of the largest IoU whose sum is the number of cells of a box
_FAR_COST = 1e5  # additional cost of a cell that is not both inside the box and near its centre
_TINY = 1e-8


@dataclass(frozen=True, kw_only=True)
class Cells:
    """All cells of an input by level and row: top left corners (cells, 2) and strides (cells,), pixels of the input."""

    corner_px: Float32Array
    stride_px: Float32Array

    @property
    def centre_px(self) -> Float32Array:
        """Centres (cells, 2): x, y."""
        return self.corner_px + self.stride_px[:, None] / np.float32(2)


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """Cells that are assigned to a box: indices (k,) of cells and boxes, IoU of predicted and true box."""

    cell: Int64Array
    box: Int64Array
    iou: Float32Array


def list_cells(width_px: int, height_px: int, strides: tuple[int, ...] = STRIDES) -> Cells:
    """The cells of an input of this size."""
    corners, sizes = [], []
    for stride in strides:
        y, x = np.mgrid[0 : height_px // stride, 0 : width_px // stride]
        corners.append(np.stack([x.ravel(), y.ravel()], axis=1) * stride)
        sizes.append(np.full(x.size, stride))
    return Cells(
        corner_px=np.concatenate(corners).astype(np.float32), stride_px=np.concatenate(sizes).astype(np.float32)
    )


def decode(raw: Float32Array, cells: Cells) -> Float32Array:
    """Boxes (cells, 4: x_min, y_min, x_max, y_max; px) from offsets in cells and logarithms of sizes in cells."""
    centre = raw[:, :2] * cells.stride_px[:, None] + cells.corner_px
    half = np.exp(np.clip(raw[:, 2:4], -8, 8)) * cells.stride_px[:, None] / 2
    return np.concatenate([centre - half, centre + half], axis=1)


def compute_iou_matrix(first: Float32Array, second: Float32Array) -> Float32Array:
    """Intersection over union (n, m) of boxes (n, 4) with boxes (m, 4), given by corners."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    overlap = np.prod(np.clip(high - low, 0, None), axis=2)
    areas = [np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0, None), axis=1) for boxes in (first, second)]
    union = areas[0][:, None] + areas[1][None, :] - overlap
    iou: Float32Array = overlap / np.maximum(union, _TINY)
    return iou


def assign(
    boxes_px: Float32Array, classes: Int64Array, predicted_px: Float32Array, probability: Float32Array, cells: Cells
) -> Assignment:
    """Assign cells to the boxes of a picture at the lowest cost.

    A cell is assigned to one box at most. Every box has at least one cell if any cell is inside it or near its centre.

    Args:
        boxes_px: boxes (n, 4: x_min, y_min, x_max, y_max), pixels of the input.
        classes: their class indices (n,).
        predicted_px: boxes (cells, 4) that the network predicts.
        probability: objectness times class probability (cells, classes).
        cells: the cells of the input.
    """
    near, central = _find_candidates(boxes_px, cells)
    candidate = np.flatnonzero(near.any(axis=0))
    if not len(boxes_px) or not len(candidate):
        return Assignment(cell=np.zeros(0, np.int64), box=np.zeros(0, np.int64), iou=np.zeros(0, np.float32))
    iou = compute_iou_matrix(boxes_px, predicted_px[candidate])
    cost = _compute_class_cost(classes, probability[candidate]) - IOU_WEIGHT * np.log(iou + _TINY)
    cost = cost + _FAR_COST * ~central[:, candidate]
    chosen = np.zeros(cost.shape, dtype=bool)
    best = np.sort(iou, axis=1)[:, ::-1][:, :SUMMED_IOUS]
    for number, count in enumerate(np.clip(best.sum(axis=1).astype(int), 1, len(candidate))):
        chosen[number, np.argpartition(cost[number], count - 1)[:count]] = True
    shared = np.flatnonzero(chosen.sum(axis=0) > 1)
    winner = cost[:, shared].argmin(axis=0)
    chosen[:, shared] = False
    chosen[winner, shared] = True
    box, cell = np.nonzero(chosen)
    return Assignment(cell=candidate[cell], box=box, iou=iou[box, cell])


def _find_candidates(boxes_px: Float32Array, cells: Cells) -> tuple[BoolArray, BoolArray]:
    """Which cells are inside the box or near its centre, and which are both; each (boxes, cells)."""
    x, y = cells.centre_px.T
    inside = (x > boxes_px[:, :1]) & (x < boxes_px[:, 2:3]) & (y > boxes_px[:, 1:2]) & (y < boxes_px[:, 3:4])
    centre = (boxes_px[:, :2] + boxes_px[:, 2:]) / 2
    reach = CENTRE_RADIUS * cells.stride_px
    close = (np.abs(x - centre[:, :1]) < reach) & (np.abs(y - centre[:, 1:]) < reach)
    return inside | close, inside & close


def _compute_class_cost(classes: Int64Array, probability: Float32Array) -> Float32Array:
    """Binary cross entropy (boxes, cells) of a cell's probabilities with the class of a box, summed over classes."""
    clipped = np.clip(probability, 1e-6, 1 - 1e-6)
    cost_absent = -np.log(1 - clipped)
    cost: Float32Array = cost_absent.sum(axis=1)[None, :] + (-np.log(clipped) - cost_absent)[:, classes].T
    return cost
