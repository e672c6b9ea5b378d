"""What a new model finds differently from an old one in the same photographs: what stays, appears, vanishes."""

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

SAME_BOX_IOU_MIN = 0.3  # intersection over union from which two models' boxes are one: they draw differently
COVERED_SHARE_MIN = 0.5  # share of a box that others cover together: a long crack told in two parts has not vanished


class Change(StrEnum):
    """What becomes of a box from the old model to the new."""

    STAYS = "stays"
    RENAMED = "renamed"
    APPEARS = "appears"
    VANISHES = "vanishes"


@dataclass(frozen=True, kw_only=True)
class BoxChange:
    """A box of the old model (None: it had none there), one of the new, or both."""

    change: Change
    old: AcceptedDetection | None
    new: AcceptedDetection | None

    @property
    def representative(self) -> AcceptedDetection:
        """The new model's box where it has one."""
        one = self.new or self.old
        assert one is not None
        return one


def compare_boxes(old: Sequence[AcceptedDetection], new: Sequence[AcceptedDetection]) -> tuple[BoxChange, ...]:
    """Every box of both models once, photograph by photograph.

    Boxes of one class that overlap by 0.3 stay, and so do boxes that the other model's boxes of that class cover by
    half together; of two classes at one place (overlap 0.5) the box is renamed.
    """
    by_photo: dict[str, tuple[list[AcceptedDetection], list[AcceptedDetection]]] = defaultdict(lambda: ([], []))
    for which, boxes in enumerate((old, new)):
        for one in boxes:
            by_photo[one.photo_id][which].append(one)
    return tuple(change for photo_id in sorted(by_photo) for change in _compare_in_photograph(*by_photo[photo_id]))


def is_found(boxes: Sequence[AcceptedDetection], box: Box, defect_class: DefectClass | None) -> bool:
    """Whether some of a photograph's ``boxes``, of the class if one is given, tell of what lies in ``box``."""
    ours = [one.box for one in boxes if defect_class in (None, one.defect_class)]
    if not ours:
        return False
    corners, place = corners_from_boxes(ours), corners_from_boxes([box])
    return bool(
        compute_iou(place, corners).max() >= SAME_BOX_IOU_MIN
        or compute_covered_share(place[0], corners) >= COVERED_SHARE_MIN
    )


def compute_covered_share(corners: Float64Array, others: Float64Array) -> float:
    """Share of a box (4,) that the boxes ``others`` (n, 4) cover together, exact: on the grid of all their edges."""
    low = np.clip(others[:, :2], corners[:2], corners[2:])
    high = np.clip(others[:, 2:], corners[:2], corners[2:])
    seen = (high > low).all(axis=1)
    low, high = low[seen], high[seen]
    xs = np.unique(np.concatenate([corners[[0, 2]], low[:, 0], high[:, 0]]))
    ys = np.unique(np.concatenate([corners[[1, 3]], low[:, 1], high[:, 1]]))
    middle_x, middle_y = (xs[:-1] + xs[1:]) / 2, (ys[:-1] + ys[1:]) / 2
    across = (low[:, None, 0] < middle_x) & (middle_x < high[:, None, 0])
    down = (low[:, None, 1] < middle_y) & (middle_y < high[:, None, 1])
    inside = (across[:, None, :] & down[:, :, None]).any(axis=0)
    area = float(np.prod(corners[2:] - corners[:2]))
    return float((inside * np.diff(ys)[:, None] * np.diff(xs)[None, :]).sum()) / area if area > 0 else 0.0


def _compare_in_photograph(old: Sequence[AcceptedDetection], new: Sequence[AcceptedDetection]) -> list[BoxChange]:
    shares = compute_iou(corners_from_boxes(one.box for one in old), corners_from_boxes(one.box for one in new))
    same = np.array([[a.defect_class is b.defect_class for b in new] for a in old], dtype=bool).reshape(shares.shape)
    pairs = pair_greedily(np.where(same, shares, 0.0), SAME_BOX_IOU_MIN)
    left_old = set(range(len(old))) - {pair.first for pair in pairs}
    left_new = set(range(len(new))) - {pair.second for pair in pairs}
    out = [BoxChange(change=Change.STAYS, old=old[pair.first], new=new[pair.second]) for pair in pairs]
    parts_old = {i for i in left_old if is_found(new, old[i].box, old[i].defect_class)}
    parts_new = {j for j in left_new if is_found(old, new[j].box, new[j].defect_class)}
    out += [BoxChange(change=Change.STAYS, old=old[i], new=None) for i in sorted(parts_old)]
    out += [BoxChange(change=Change.STAYS, old=None, new=new[j]) for j in sorted(parts_new)]
    left_old, left_new = left_old - parts_old, left_new - parts_new
    others = np.zeros_like(shares)
    for i in left_old:
        for j in left_new:
            others[i, j] = shares[i, j]
    renamed = pair_greedily(others, COVERED_SHARE_MIN)
    out += [BoxChange(change=Change.RENAMED, old=old[pair.first], new=new[pair.second]) for pair in renamed]
    gone = sorted(left_old - {pair.first for pair in renamed})
    come = sorted(left_new - {pair.second for pair in renamed})
    out += [BoxChange(change=Change.VANISHES, old=old[i], new=None) for i in gone]
    return out + [BoxChange(change=Change.APPEARS, old=None, new=new[j]) for j in come]
