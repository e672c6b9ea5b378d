"""Operating point: hits, false alarms and misses at the detector's threshold, and the confusion of classes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from pycocotools.mask import iou

from facadelake.core.arrays import Float64Array, Float64N
from facadelake.evaluation.detectors.average_precision import PredictionMatches
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import Prediction

NOTHING = "nothing"
IOU_MIN = 0.5
_TRUTHS_MIN = 10


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """Counts at the threshold; precision, recall and F1 are None where their denominator is 0."""

    hits: int
    false_alarms: int
    misses: int

    @property
    def precision(self) -> float | None:
        """Share of the predictions that hit a labelled defect."""
        return self.hits / (self.hits + self.false_alarms) if self.hits + self.false_alarms else None

    @property
    def recall(self) -> float | None:
        """Share of the labelled defects that are hit."""
        return self.hits / (self.hits + self.misses) if self.hits + self.misses else None

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall."""
        total = 2 * self.hits + self.false_alarms + self.misses
        return 2 * self.hits / total if total else None

    def convert_to_json(self) -> dict[str, float | int | None]:
        """Counts and shares."""
        shares = {name: getattr(self, name) for name in ("precision", "recall", "f1")}
        return {"hits": self.hits, "false_alarms": self.false_alarms, "misses": self.misses, **shares}


def compute_operating_point(matches: PredictionMatches, weights: Float64N | None = None) -> OperatingPoint:
    """Counts at an IoU of 0.5; ``weights`` as in ``compute_average_precision``."""
    weight = np.ones(len(matches.images)) if weights is None else weights
    prediction_weight = weight[matches.image]
    return OperatingPoint(
        hits=round(float(prediction_weight[matches.hit[0]].sum())),
        false_alarms=round(float(prediction_weight[~(matches.hit[0] | matches.ignored[0])].sum())),
        misses=round(float(weight[matches.truth_image][~matches.found[0]].sum())),
    )


@dataclass(frozen=True, kw_only=True)
class RecallAtSize:
    """Recall of the ``truths`` labelled boxes of a range of sizes; ``size_px``: median of the root of their areas."""

    size_px: float
    recall: float
    truths: int


def compute_recall_by_size(matches: PredictionMatches) -> tuple[RecallAtSize, ...]:
    """Recall at an IoU of 0.5 in ranges of half an octave of size, from the smallest up.

    Ranges of less than 10 boxes are joined to the next larger one, the last one to the one before.
    """
    boxes = [matches.images[i].boxes[k].box for i, k in zip(matches.truth_image, matches.truth_rank, strict=True)]
    size = np.sqrt([box.width_px * box.height_px for box in boxes])
    order = np.argsort(size, kind="stable")
    size, found = size[order], matches.found[0][order]
    bounds = [0]
    for end in range(1, len(size) + 1):
        is_last = end == len(size)
        if not is_last and size[end] < size[bounds[-1]] * np.sqrt(2.0):
            continue
        if end - bounds[-1] >= _TRUTHS_MIN:
            bounds.append(end)
        elif is_last and len(bounds) > 1:
            bounds[-1] = end
    return tuple(
        RecallAtSize(
            size_px=float(np.median(size[start:end])), recall=float(found[start:end].mean()), truths=end - start
        )
        for start, end in pairwise(bounds)
    )


def sum_operating_points(parts: Sequence[OperatingPoint]) -> OperatingPoint:
    """The sums of the counts of several classes."""
    return OperatingPoint(
        hits=sum(one.hits for one in parts),
        false_alarms=sum(one.false_alarms for one in parts),
        misses=sum(one.misses for one in parts),
    )


@dataclass(frozen=True, kw_only=True)
class Confusion:
    """``count`` pairs of a labelled box of class ``truth`` and a prediction of class ``shown``; ``nothing``: no box."""

    truth: str
    shown: str
    count: int


def count_confusions(
    images: Sequence[LabelledImage], predictions: Mapping[str, tuple[Prediction, ...]]
) -> tuple[Confusion, ...]:
    """Confusion of classes at an IoU of 0.5: boxes of one class are paired first, then of different classes.

    Ignored labels and the predictions on them are left out, and so is an unpaired prediction of a class without labels
    in its photograph.
    """
    counts: Counter[tuple[str, str]] = Counter()
    for image in images:
        predicted = predictions[image.key]
        iou_matrix = compute_coco_iou(image, predicted)
        free_truths, free_predictions = set(range(len(image.boxes))), list(range(len(predicted)))
        for same_class in (True, False):
            for p in list(free_predictions):
                candidates = [
                    t
                    for t in free_truths
                    if iou_matrix[p, t] >= IOU_MIN
                    and (not same_class or image.boxes[t].defect_class is predicted[p].defect_class)
                ]
                if not candidates:
                    continue
                _, _, best = max((not image.boxes[t].ignored, float(iou_matrix[p, t]), t) for t in candidates)
                free_predictions.remove(p)
                if not image.boxes[best].ignored:
                    free_truths.remove(best)
                    counts[str(image.boxes[best].defect_class), str(predicted[p].defect_class)] += 1
        for p in free_predictions:
            if predicted[p].defect_class in image.labelled:
                counts[NOTHING, str(predicted[p].defect_class)] += 1
        for t in free_truths:
            if not image.boxes[t].ignored:
                counts[str(image.boxes[t].defect_class), NOTHING] += 1
    rows, columns = sorted({truth for truth, _ in counts}), sorted({prediction for _, prediction in counts})
    return tuple(
        Confusion(truth=truth, shown=prediction, count=counts[truth, prediction])
        for truth, prediction in product(rows, columns)
        if counts[truth, prediction]
    )


def compute_coco_iou(image: LabelledImage, predicted: Sequence[Prediction]) -> Float64Array:
    """IoU (n, m) of predictions and labelled boxes; for a crowd intersection over the prediction's area, as in COCO."""
    if not predicted or not image.boxes:
        return np.zeros((len(predicted), len(image.boxes)))
    corners = [
        [[b.x_px, b.y_px, b.width_px, b.height_px] for b in boxes]
        for boxes in ([one.box for one in predicted], [one.box for one in image.boxes])
    ]
    matrix: Float64Array = np.asarray(iou(corners[0], corners[1], [int(one.ignored) for one in image.boxes]))
    return matrix
