"""Which cell of the network answers for which box: SimOTA.

Source: Ge et al., YOLOX: Exceeding YOLO Series in 2021, arXiv 2107.08430, section 2.3, and Ge et al., OTA, CVPR 2021.
In numpy: it has no gradient, and for a handful of boxes it is faster than torch on a CPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
STRIDES = (8, 16, 32)
CENTRE_RADIUS = 2.5  # cells about a box's centre that may answer for it
IOU_WEIGHT = 3.0
BEST_IOUS = 10  # the sum of this many IoU says how many cells a box gets
_FAR = 1e5  # cost of a cell that is not both inside the box and near its centre
_TINY = 1e-8


@dataclass(frozen=True, kw_only=True)
class Cells:
    """All cells of an input, level by level, row by row: left top corner and stride, in pixels of the input."""

    corner_px: Floats
    stride_px: Floats

    @property
    def centre_px(self) -> Floats:
        """(cells, 2) x, y."""
        return self.corner_px + self.stride_px[:, None] / np.float32(2)


@dataclass(frozen=True, kw_only=True)
class Assignment:
    """The cells that answer for a box: their index, their box's index, and the IoU of what they say with it."""

    cell: NDArray[np.int64]
    box: NDArray[np.int64]
    iou: Floats


def cells_of(width_px: int, height_px: int, strides: tuple[int, ...] = STRIDES) -> Cells:
    """The cells of an input of that size."""
    corners, sizes = [], []
    for stride in strides:
        y, x = np.mgrid[0 : height_px // stride, 0 : width_px // stride]
        corners.append(np.stack([x.ravel(), y.ravel()], axis=1) * stride)
        sizes.append(np.full(x.size, stride))
    return Cells(
        corner_px=np.concatenate(corners).astype(np.float32), stride_px=np.concatenate(sizes).astype(np.float32)
    )


def decode(raw: Floats, cells: Cells) -> Floats:
    """(cells, 4) offsets in cells and log sizes -> corners x_min, y_min, x_max, y_max in pixels of the input."""
    centre = raw[:, :2] * cells.stride_px[:, None] + cells.corner_px
    half = np.exp(np.clip(raw[:, 2:4], -8, 8)) * cells.stride_px[:, None] / 2
    return np.concatenate([centre - half, centre + half], axis=1)


def iou_matrix(first: Floats, second: Floats) -> Floats:
    """Intersection over union of (n, 4) with (m, 4) corners."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    overlap = np.prod(np.clip(high - low, 0, None), axis=2)
    areas = [np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0, None), axis=1) for boxes in (first, second)]
    union = areas[0][:, None] + areas[1][None, :] - overlap
    iou: Floats = overlap / np.maximum(union, _TINY)
    return iou


def assign(
    boxes_px: Floats, classes: NDArray[np.int64], said_px: Floats, probability: Floats, cells: Cells
) -> Assignment:
    """Give every box (n, 4 corners) the cells that answer for it at the least cost.

    ``said_px`` (cells, 4) are the boxes the network says, ``probability`` (cells, classes) objectness times class. A
    cell answers for one box at most; every box gets one at least where any cell is inside it or near its centre.
    """
    near, central = _candidates(boxes_px, cells)
    candidate = np.flatnonzero(near.any(axis=0))
    if not len(boxes_px) or not len(candidate):
        return Assignment(cell=np.zeros(0, np.int64), box=np.zeros(0, np.int64), iou=np.zeros(0, np.float32))
    iou = iou_matrix(boxes_px, said_px[candidate])
    cost = _class_cost(classes, probability[candidate]) - IOU_WEIGHT * np.log(iou + _TINY)
    cost = cost + _FAR * ~central[:, candidate]
    chosen = np.zeros(cost.shape, dtype=bool)
    best = np.sort(iou, axis=1)[:, ::-1][:, :BEST_IOUS]
    for number, count in enumerate(np.clip(best.sum(axis=1).astype(int), 1, len(candidate))):
        chosen[number, np.argpartition(cost[number], count - 1)[:count]] = True
    disputed = np.flatnonzero(chosen.sum(axis=0) > 1)
    winner = cost[:, disputed].argmin(axis=0)
    chosen[:, disputed] = False
    chosen[winner, disputed] = True
    box, cell = np.nonzero(chosen)
    return Assignment(cell=candidate[cell], box=box, iou=iou[box, cell])


def _candidates(boxes_px: Floats, cells: Cells) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(boxes, cells): inside the box or near its centre; inside and near."""
    x, y = cells.centre_px.T
    inside = (x > boxes_px[:, :1]) & (x < boxes_px[:, 2:3]) & (y > boxes_px[:, 1:2]) & (y < boxes_px[:, 3:4])
    centre = (boxes_px[:, :2] + boxes_px[:, 2:]) / 2
    reach = CENTRE_RADIUS * cells.stride_px
    close = (np.abs(x - centre[:, :1]) < reach) & (np.abs(y - centre[:, 1:]) < reach)
    return inside | close, inside & close


def _class_cost(classes: NDArray[np.int64], probability: Floats) -> Floats:
    """(boxes, cells): binary cross entropy of what the cell says with the box's class, summed over classes."""
    sure = np.clip(probability, 1e-6, 1 - 1e-6)
    against = -np.log(1 - sure)
    cost: Floats = against.sum(axis=1)[None, :] + (-np.log(sure) - against)[:, classes].T
    return cost
