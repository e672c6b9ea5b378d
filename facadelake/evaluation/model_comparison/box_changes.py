"""Differences between the boxes of two models in the same photographs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.detection import Box
from facadelake.reviews import AcceptedDetection, compute_iou, corners_from_boxes, pair_greedily
from schemas.vocabulary import DefectClass

SAME_BOX_IOU_MIN = 0.3  # of two models' boxes of one defect: models frame defects differently
COVERED_SHARE_MIN = 0.5  # share of a box that others cover together: a long crack in two boxes has not vanished


class Change(StrEnum):
    """Change of a box or a defect from the old model to the new one."""

    STAYS = "stays"
    RENAMED = "renamed"
    APPEARS = "appears"
    VANISHES = "vanishes"


@dataclass(frozen=True, kw_only=True)
class BoxChange:
    """A box of the old model, of the new one, or of both; None: the model has no box there, or several smaller ones."""

    change: Change
    old: AcceptedDetection | None
    new: AcceptedDetection | None

    @property
    def representative(self) -> AcceptedDetection:
        """The new model's box, or the old one's where the new model has none."""
        box = self.new or self.old
        assert box is not None
        return box


def compare_boxes(old: Sequence[AcceptedDetection], new: Sequence[AcceptedDetection]) -> tuple[BoxChange, ...]:
    """The changes between two models' boxes, each box once, sorted by photograph.

    Two boxes of one class with an IoU of 0.3 or more stay, and so does a box of which the other model's boxes of that
    class together cover half. Two of the remaining boxes, of different classes, with an IoU of 0.5 or more are renamed.
    """
    by_photo: dict[str, tuple[list[AcceptedDetection], list[AcceptedDetection]]] = defaultdict(lambda: ([], []))
    for index, boxes in enumerate((old, new)):
        for box in boxes:
            by_photo[box.photo_id][index].append(box)
    return tuple(change for photo_id in sorted(by_photo) for change in _compare_in_photograph(*by_photo[photo_id]))


def is_found(boxes: Sequence[AcceptedDetection], box: Box, defect_class: DefectClass | None) -> bool:
    """Whether ``boxes`` of the same photograph find what is in ``box``: one overlaps it, or several cover half of it.

    Only boxes of ``defect_class`` count; None: of any class.
    """
    of_class = [one.box for one in boxes if defect_class in (None, one.defect_class)]
    if not of_class:
        return False
    found, target = corners_from_boxes(of_class), corners_from_boxes([box])
    return bool(
        compute_iou(target, found).max() >= SAME_BOX_IOU_MIN
        or compute_covered_share(target[0], found) >= COVERED_SHARE_MIN
    )


def compute_covered_share(corners: Float64Array, others: Float64Array) -> float:
    """Share of the area of a box (4,) that the boxes ``others`` (n, 4) cover together, by the grid of all edges."""
    low = np.clip(others[:, :2], corners[:2], corners[2:])
    high = np.clip(others[:, 2:], corners[:2], corners[2:])
    overlapping = (high > low).all(axis=1)
    low, high = low[overlapping], high[overlapping]
    xs = np.unique(np.concatenate([corners[[0, 2]], low[:, 0], high[:, 0]]))
    ys = np.unique(np.concatenate([corners[[1, 3]], low[:, 1], high[:, 1]]))
    centre_x, centre_y = (xs[:-1] + xs[1:]) / 2, (ys[:-1] + ys[1:]) / 2
    across = (low[:, None, 0] < centre_x) & (centre_x < high[:, None, 0])
    down = (low[:, None, 1] < centre_y) & (centre_y < high[:, None, 1])
    inside = (across[:, None, :] & down[:, :, None]).any(axis=0)
    area = float(np.prod(corners[2:] - corners[:2]))
    return float((inside * np.diff(ys)[:, None] * np.diff(xs)[None, :]).sum()) / area if area > 0 else 0.0


def _compare_in_photograph(old: Sequence[AcceptedDetection], new: Sequence[AcceptedDetection]) -> list[BoxChange]:
    iou = compute_iou(corners_from_boxes(one.box for one in old), corners_from_boxes(one.box for one in new))
    same_class = np.array([[a.defect_class is b.defect_class for b in new] for a in old], dtype=bool).reshape(iou.shape)
    pairs = pair_greedily(np.where(same_class, iou, 0.0), SAME_BOX_IOU_MIN)
    left_old = set(range(len(old))) - {pair.first for pair in pairs}
    left_new = set(range(len(new))) - {pair.second for pair in pairs}
    changes = [BoxChange(change=Change.STAYS, old=old[pair.first], new=new[pair.second]) for pair in pairs]
    covered_old = {i for i in left_old if is_found(new, old[i].box, old[i].defect_class)}
    covered_new = {j for j in left_new if is_found(old, new[j].box, new[j].defect_class)}
    changes += [BoxChange(change=Change.STAYS, old=old[i], new=None) for i in sorted(covered_old)]
    changes += [BoxChange(change=Change.STAYS, old=None, new=new[j]) for j in sorted(covered_new)]
    left_old, left_new = left_old - covered_old, left_new - covered_new
    left_iou = np.zeros_like(iou)
    for i in left_old:
        for j in left_new:
            left_iou[i, j] = iou[i, j]
    renamed = pair_greedily(left_iou, COVERED_SHARE_MIN)
    changes += [BoxChange(change=Change.RENAMED, old=old[pair.first], new=new[pair.second]) for pair in renamed]
    vanished = sorted(left_old - {pair.first for pair in renamed})
    appeared = sorted(left_new - {pair.second for pair in renamed})
    changes += [BoxChange(change=Change.VANISHES, old=old[i], new=None) for i in vanished]
    return changes + [BoxChange(change=Change.APPEARS, old=None, new=new[j]) for j in appeared]
