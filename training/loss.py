"""The loss of YOLOX: boxes by GIoU, objectness and classes by binary cross entropy, all over the answering cells.

Sources: Ge et al., arXiv 2107.08430 (which terms, weight 5 of the boxes, the class target is the IoU);
Rezatofighi et al., Generalized Intersection over Union, CVPR 2019.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from training.assign import Cells, assign, decode

BOX_WEIGHT = 5.0


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Boxes (n, 4 corners in pixels of the input) and class indices of one picture."""

    boxes_px: NDArray[np.float32]
    classes: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Loss:
    """The sum to minimise and its parts."""

    total: Tensor
    box: float
    objectness: float
    classes: float


def loss_of(raw: Tensor, truths: Sequence[Truth], cells: Cells) -> Loss:
    """Loss of a batch: ``raw`` (b, cells, 5 + classes) as ``Yolox.forward`` gives it."""
    seen = raw.detach().float().numpy()
    picture, cell, target, iou, wanted = [], [], [], [], []
    for i, truth in enumerate(truths):
        odds = 1 / (1 + np.exp(-np.clip(seen[i, :, 4:], -30, 30)))
        found = assign(truth.boxes_px, truth.classes, decode(seen[i], cells), np.sqrt(odds[:, 1:] * odds[:, :1]), cells)
        picture.append(np.full(len(found.cell), i))
        cell.append(found.cell)
        target.append(truth.boxes_px[found.box])
        iou.append(found.iou)
        wanted.append(truth.classes[found.box])
    index = torch.from_numpy(np.concatenate(picture)), torch.from_numpy(np.concatenate(cell))
    answering = raw[index]
    count = max(len(answering), 1)
    objectness = torch.zeros_like(raw[..., 4])
    objectness[index] = 1.0
    class_target = functional.one_hot(torch.from_numpy(np.concatenate(wanted)), raw.shape[2] - 5).to(raw.dtype)
    class_target = class_target * torch.from_numpy(np.concatenate(iou))[:, None]
    stride = torch.from_numpy(cells.stride_px)[index[1]][:, None]
    centre = answering[:, :2] * stride + torch.from_numpy(cells.corner_px)[index[1]]
    half = answering[:, 2:4].clamp(-8, 8).exp() * stride / 2
    said = torch.cat([centre - half, centre + half], dim=1)
    box_loss = (1 - _giou(said, torch.from_numpy(np.concatenate(target)))).sum() / count
    object_loss = functional.binary_cross_entropy_with_logits(raw[..., 4], objectness, reduction="sum") / count
    class_loss = functional.binary_cross_entropy_with_logits(answering[:, 5:], class_target, reduction="sum") / count
    return Loss(
        total=BOX_WEIGHT * box_loss + object_loss + class_loss,
        box=float(box_loss.detach()),
        objectness=float(object_loss.detach()),
        classes=float(class_loss.detach()),
    )


def _giou(first: Tensor, second: Tensor) -> Tensor:
    """Generalised IoU, row by row, of corners: 1 for the same box, towards -1 for boxes far apart."""
    overlap = _area(torch.maximum(first[:, :2], second[:, :2]), torch.minimum(first[:, 2:], second[:, 2:]))
    union = _area(first[:, :2], first[:, 2:]) + _area(second[:, :2], second[:, 2:]) - overlap
    hull = _area(torch.minimum(first[:, :2], second[:, :2]), torch.maximum(first[:, 2:], second[:, 2:]))
    return overlap / union.clamp(min=1e-6) - (hull - union) / hull.clamp(min=1e-6)


def _area(low: Tensor, high: Tensor) -> Tensor:
    return (high - low).clamp(min=0).prod(dim=1)
