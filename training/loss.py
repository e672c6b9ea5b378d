"""Loss of YOLOX: GIoU of boxes, binary cross entropy of objectness and classes, per assigned cell.

Sources: Ge et al., arXiv 2107.08430 (terms, weight 5 of the boxes, IoU as class target);
Rezatofighi et al., Generalized Intersection over Union, CVPR 2019.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from facadelake.core.arrays import Float32Array, Int64Array
from training.assign import Cells, assign, decode

BOX_WEIGHT = 5.0


@dataclass(frozen=True, kw_only=True)
class TargetBoxes:
    """True boxes (n, 4: x_min, y_min, x_max, y_max; pixels of the input) and class indices (n,) of one picture."""

    boxes_px: Float32Array
    classes: Int64Array


@dataclass(frozen=True, kw_only=True)
class Loss:
    """The weighted sum to minimise, and its parts."""

    total: Tensor
    box: float
    objectness: float
    classes: float


def compute_loss(raw: Tensor, truths: Sequence[TargetBoxes], cells: Cells) -> Loss:
    """Loss of a batch of outputs ``raw`` (b, cells, 5 + classes) of ``Yolox.forward``."""
    output = raw.detach().float().numpy()
    picture, cell, target, iou, target_class = [], [], [], [], []
    for i, truth in enumerate(truths):
        odds = 1 / (1 + np.exp(-np.clip(output[i, :, 4:], -30, 30)))
        found = assign(
            truth.boxes_px, truth.classes, decode(output[i], cells), np.sqrt(odds[:, 1:] * odds[:, :1]), cells
        )
        picture.append(np.full(len(found.cell), i))
        cell.append(found.cell)
        target.append(truth.boxes_px[found.box])
        iou.append(found.iou)
        target_class.append(truth.classes[found.box])
    index = torch.from_numpy(np.concatenate(picture)), torch.from_numpy(np.concatenate(cell))
    assigned = raw[index]
    count = max(len(assigned), 1)
    objectness = torch.zeros_like(raw[..., 4])
    objectness[index] = 1.0
    class_target = functional.one_hot(torch.from_numpy(np.concatenate(target_class)), raw.shape[2] - 5).to(raw.dtype)
    class_target = class_target * torch.from_numpy(np.concatenate(iou))[:, None]
    stride = torch.from_numpy(cells.stride_px)[index[1]][:, None]
    centre = assigned[:, :2] * stride + torch.from_numpy(cells.corner_px)[index[1]]
    half = assigned[:, 2:4].clamp(-8, 8).exp() * stride / 2
    predicted = torch.cat([centre - half, centre + half], dim=1)
    box_loss = (1 - _compute_giou(predicted, torch.from_numpy(np.concatenate(target)))).sum() / count
    object_loss = functional.binary_cross_entropy_with_logits(raw[..., 4], objectness, reduction="sum") / count
    class_loss = functional.binary_cross_entropy_with_logits(assigned[:, 5:], class_target, reduction="sum") / count
    return Loss(
        total=BOX_WEIGHT * box_loss + object_loss + class_loss,
        box=float(box_loss.detach()),
        objectness=float(object_loss.detach()),
        classes=float(class_loss.detach()),
    )


def _compute_giou(first: Tensor, second: Tensor) -> Tensor:
    """Generalised IoU (n,) of boxes (n, 4) by corners: 1 for identical boxes, towards -1 for distant ones."""
    overlap = _compute_area(torch.maximum(first[:, :2], second[:, :2]), torch.minimum(first[:, 2:], second[:, 2:]))
    union = _compute_area(first[:, :2], first[:, 2:]) + _compute_area(second[:, :2], second[:, 2:]) - overlap
    hull = _compute_area(torch.minimum(first[:, :2], second[:, :2]), torch.maximum(first[:, 2:], second[:, 2:]))
    return overlap / union.clamp(min=1e-6) - (hull - union) / hull.clamp(min=1e-6)


def _compute_area(low: Tensor, high: Tensor) -> Tensor:
    return (high - low).clamp(min=0).prod(dim=1)
