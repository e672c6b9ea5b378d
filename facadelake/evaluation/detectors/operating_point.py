"""What a user gets at the card's threshold: hits, false alarms, misses, and what was taken for what."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from pycocotools.mask import iou

from facadelake.core.arrays import Float64Array
from facadelake.evaluation.detectors.average_precision import PredictionMatches
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import Prediction

NOTHING = "nothing"
IOU_MIN = 0.5


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """Counts at the threshold, and from them precision, recall and their harmonic mean (None where undefined)."""

    hits: int
    false_alarms: int
    misses: int

    @property
    def precision(self) -> float | None:
        """Share of the boxes shown that show a defect."""
        return self.hits / (self.hits + self.false_alarms) if self.hits + self.false_alarms else None

    @property
    def recall(self) -> float | None:
        """Share of the labelled defects that are shown."""
        return self.hits / (self.hits + self.misses) if self.hits + self.misses else None

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall."""
        total = 2 * self.hits + self.false_alarms + self.misses
        return 2 * self.hits / total if total else None

    def to_json(self) -> dict[str, float | int | None]:
        """Counts and shares."""
        shares = {name: getattr(self, name) for name in ("precision", "recall", "f1")}
        return {"hits": self.hits, "false_alarms": self.false_alarms, "misses": self.misses, **shares}


def compute_operating_point(matches: PredictionMatches, weights: Float64Array | None = None) -> OperatingPoint:
    """Counts of what is shown, at an IoU of 0.5; ``weights`` as for average precision."""
    weight = np.ones(len(matches.images)) if weights is None else weights
    each = weight[matches.image]
    return OperatingPoint(
        hits=round(float(each[matches.hit[0]].sum())),
        false_alarms=round(float(each[~(matches.hit[0] | matches.ignored[0])].sum())),
        misses=round(float(weight[matches.truth_image][~matches.found[0]].sum())),
    )


def sum_operating_points(parts: Sequence[OperatingPoint]) -> OperatingPoint:
    """The counts of several classes together."""
    return OperatingPoint(
        hits=sum(one.hits for one in parts),
        false_alarms=sum(one.false_alarms for one in parts),
        misses=sum(one.misses for one in parts),
    )


@dataclass(frozen=True, kw_only=True)
class Confusion:
    """``count`` labelled defects of class ``truth`` were shown as ``shown``; either may be ``nothing``."""

    truth: str
    shown: str
    count: int


def count_confusions(
    images: Sequence[LabelledImage], shown: Mapping[str, tuple[Prediction, ...]]
) -> tuple[Confusion, ...]:
    """What was taken for what, at an IoU of 0.5: truths of the same class are paired first, then of any.

    Ignored truths and what lies on them are left out, and so is a lone box of a class of which the photograph has no
    labels: nobody knows whether it is right.
    """
    counts: Counter[tuple[str, str]] = Counter()
    for image in images:
        guesses = shown[image.key]
        overlap = compute_coco_iou(image, guesses)
        free_truths, free_guesses = set(range(len(image.boxes))), list(range(len(guesses)))
        for same_class in (True, False):
            for g in list(free_guesses):
                able = [
                    t
                    for t in free_truths
                    if overlap[g, t] >= IOU_MIN
                    and (not same_class or image.boxes[t].defect_class is guesses[g].defect_class)
                ]
                if not able:
                    continue
                _, _, best = max((not image.boxes[t].ignored, float(overlap[g, t]), t) for t in able)
                free_guesses.remove(g)
                if not image.boxes[best].ignored:
                    free_truths.remove(best)
                    counts[str(image.boxes[best].defect_class), str(guesses[g].defect_class)] += 1
        for g in free_guesses:
            if guesses[g].defect_class in image.labelled:
                counts[NOTHING, str(guesses[g].defect_class)] += 1
        for t in free_truths:
            if not image.boxes[t].ignored:
                counts[str(image.boxes[t].defect_class), NOTHING] += 1
    rows, columns = sorted({truth for truth, _ in counts}), sorted({guess for _, guess in counts})
    return tuple(
        Confusion(truth=truth, shown=guess, count=counts[truth, guess])
        for truth, guess in product(rows, columns)
        if counts[truth, guess]
    )


def compute_coco_iou(image: LabelledImage, guesses: Sequence[Prediction]) -> Float64Array:
    """Intersection over union (guesses, truths); over the guess alone where the truth is a crowd, as COCO has it."""
    if not guesses or not image.boxes:
        return np.zeros((len(guesses), len(image.boxes)))
    corners = [
        [[b.x_px, b.y_px, b.width_px, b.height_px] for b in boxes]
        for boxes in ([one.box for one in guesses], [one.box for one in image.boxes])
    ]
    overlap: Float64Array = np.asarray(iou(corners[0], corners[1], [int(one.ignored) for one in image.boxes]))
    return overlap
