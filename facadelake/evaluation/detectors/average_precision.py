"""Which predictions hit a labelled defect, and average precision: pycocotools' rules, one class at a time.

COCO's definition: predictions of a photograph in order of score each take the best overlapping free truth of their
class with an intersection over union of at least the threshold; precision is the envelope at 101 recalls
(Lin et al., ECCV 2014; pycocotools.cocoeval).
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import Prediction
from schemas.vocabulary import DefectClass

IOU_THRESHOLDS = np.linspace(0.5, 0.95, 10)
RECALLS = np.linspace(0.0, 1.0, 101)
COCO_BOXES_MAX = 100  # boxes of a photograph that COCO counts


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictionMatches:
    """Predictions of one class in the photographs that have labels of it.

    ``images``: those photographs. Of each of n predictions, in order of falling score: ``image`` (n,) index into
    ``images``, ``rank`` (n,) index into that photograph's predictions of the class, ``score`` (n,), ``hit`` and
    ``ignored`` (10, n) at each of ``IOU_THRESHOLDS``. Of each of m labelled boxes that count: ``truth_image`` (m,),
    ``truth_rank`` (m,) index into the photograph's boxes, ``found`` (10, m). ``coco_precision`` (10,): average
    precision as pycocotools accumulates it, NaN where there is no truth.
    """

    defect_class: DefectClass
    images: tuple[LabelledImage, ...]
    image: RowIndices
    rank: RowIndices
    score: Float64Array
    hit: BoolArray
    ignored: BoolArray
    truth_image: RowIndices
    truth_rank: RowIndices
    found: BoolArray
    coco_precision: Float64Array


def match_predictions(
    images: Sequence[LabelledImage],
    predictions: Mapping[str, tuple[Prediction, ...]],
    defect_class: DefectClass,
    *,
    most: int = COCO_BOXES_MAX,
) -> PredictionMatches:
    """Match the predictions of a class; at most the ``most`` best of a photograph count."""
    chosen = tuple(image for image in images if defect_class in image.labelled)
    truths = _list_boxes_of_class([image.boxes for image in chosen], defect_class)
    guesses = _list_boxes_of_class([predictions[image.key] for image in chosen], defect_class)
    evaluation = _run_pycocotools(chosen, truths, guesses, most)
    parts = [one for one in evaluation.evalImgs if one is not None]
    guess_ids, truth_ids = ([id_ for one in parts for id_ in one[key]] for key in ("dtIds", "gtIds"))
    score = np.array([one for part in parts for one in part["dtScores"]], dtype=np.float64)
    order = np.argsort(-score, kind="mergesort")  # as pycocotools orders equal scores
    counting = ~_concatenate_results(parts, "gtIgnore").astype(np.bool_).ravel()
    guess_places = np.array([guesses[id_ - 1][:2] for id_ in guess_ids], dtype=np.int64).reshape(-1, 2)
    truth_places = np.array([truths[id_ - 1][:2] for id_ in truth_ids], dtype=np.int64).reshape(-1, 2)
    ignored = _concatenate_results(parts, "dtIgnore").astype(np.bool_)
    precision = (
        evaluation.eval["precision"][:, :, 0, 0, 0].mean(axis=1) if parts else np.full(len(IOU_THRESHOLDS), -1.0)
    )
    return PredictionMatches(
        defect_class=defect_class,
        images=chosen,
        image=guess_places[order, 0],
        rank=guess_places[order, 1],
        score=score[order],
        hit=((_concatenate_results(parts, "dtMatches") > 0) & ~ignored)[:, order],
        ignored=ignored[:, order],
        truth_image=truth_places[counting, 0],
        truth_rank=truth_places[counting, 1],
        found=_concatenate_results(parts, "gtMatches")[:, counting] > 0,
        coco_precision=np.where(precision < 0, np.nan, precision),
    )


def compute_average_precision(
    matches: PredictionMatches, weights: Float64Array | None = None, *, thresholds: int = len(IOU_THRESHOLDS)
) -> Float64Array:
    """Average precision at the first ``thresholds`` of ``IOU_THRESHOLDS``, NaN where there is no truth.

    ``weights`` (one a photograph) repeat or leave out photographs: matches do not depend on one another across them, so
    sites and resampled sets need no new matching.
    """
    curves = [compute_precision_at_recalls(matches, i, weights) for i in range(thresholds)]
    means: Float64Array = np.array([curve.mean() for curve in curves])
    return means


def compute_precision_at_recalls(
    matches: PredictionMatches, threshold: int, weights: Float64Array | None = None
) -> Float64Array:
    """The precision's envelope (101,) at ``RECALLS`` for the IoU threshold of that index; NaN where no truth is."""
    weight = np.ones(len(matches.images)) if weights is None else weights
    truths = weight[matches.truth_image].sum()
    if truths <= 0:
        return np.full(len(RECALLS), np.nan)
    each = weight[matches.image]
    hits = np.cumsum(each * matches.hit[threshold])
    wrong = np.cumsum(each * ~(matches.hit[threshold] | matches.ignored[threshold]))
    precision = hits / np.maximum(hits + wrong, np.finfo(np.float64).tiny)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    at = np.searchsorted(hits / truths, RECALLS, side="left")
    reached: Float64Array = np.where(at < len(envelope), np.append(envelope, 0.0)[np.minimum(at, len(envelope))], 0.0)
    return reached


def _list_boxes_of_class(boxes: Sequence[Sequence[Any]], defect_class: DefectClass) -> list[tuple[int, int, Any]]:
    """Index of photograph, index in it, and box, of all boxes of a class."""
    return [
        (i, rank, one)
        for i, many in enumerate(boxes)
        for rank, one in enumerate(many)
        if one.defect_class is defect_class
    ]


def _run_pycocotools(
    images: Sequence[LabelledImage],
    truths: Sequence[tuple[int, int, Any]],
    guesses: Sequence[tuple[int, int, Any]],
    most: int,
) -> Any:
    """pycocotools' evaluation, which prints."""
    with redirect_stdout(io.StringIO()):
        evaluation = COCOeval(
            _build_coco(images, truths, lambda one: {"iscrowd": int(one.ignored)}),
            _build_coco(images, guesses, lambda one: {"score": one.score}),
            "bbox",
        )
        evaluation.params.iouThrs = IOU_THRESHOLDS
        evaluation.params.recThrs = RECALLS
        evaluation.params.maxDets = [most]
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0.0, 1e10]], ["all"]
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation


def _build_coco(
    images: Sequence[LabelledImage],
    boxes: Sequence[tuple[int, int, Any]],
    more: Callable[[Any], dict[str, float]],
) -> Any:
    coco = COCO()
    coco.dataset = {
        "images": [{"id": i, "width": one.width_px, "height": one.height_px} for i, one in enumerate(images)],
        "categories": [{"id": 1, "name": "defect"}],
        "annotations": [
            {
                "id": id_,
                "image_id": i,
                "category_id": 1,
                "bbox": [one.box.x_px, one.box.y_px, one.box.width_px, one.box.height_px],
                "area": one.box.width_px * one.box.height_px,
                "iscrowd": 0,
                **more(one),
            }
            for id_, (i, _, one) in enumerate(boxes, start=1)  # 0 would mean no match
        ],
    }
    coco.createIndex()
    return coco


def _concatenate_results(parts: Sequence[Mapping[str, Any]], key: str) -> Float64Array:
    """The (10, n) or (n,) arrays of all photographs, joined."""
    arrays = [np.asarray(one[key], dtype=np.float64) for one in parts]
    if not arrays:
        return np.zeros((len(IOU_THRESHOLDS), 0)) if key != "gtIgnore" else np.zeros(0)
    return np.concatenate(arrays, axis=-1)
