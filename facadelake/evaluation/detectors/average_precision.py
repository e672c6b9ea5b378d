"""Matching of predictions with labelled boxes, and average precision, by pycocotools, one class at a time.

COCO's definition: in order of score, each prediction of a photograph takes the free labelled box of its class with the
largest IoU of at least the threshold. Average precision is the mean of the precision envelope at 101 recalls (Lin et
al., Microsoft COCO, ECCV 2014; pycocotools.cocoeval).
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

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, RowIndices
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import Prediction
from schemas.vocabulary import DefectClass

IOU_THRESHOLDS = np.linspace(0.5, 0.95, 10)
RECALLS = np.linspace(0.0, 1.0, 101)
COCO_BOXES_MAX = 100  # predictions of a photograph, as in COCO


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictionMatches:
    """The matches of one class in the photographs with labels of that class (``images``).

    n predictions in order of falling score: ``image`` (n,) index into ``images``; ``rank`` (n,) index into the
    photograph's predictions; ``score`` (n,); ``hit`` and ``ignored`` (10, n) at each of ``IOU_THRESHOLDS``. m labelled
    boxes that are not ignored: ``truth_image`` (m,) index into ``images``; ``truth_rank`` (m,) index into the
    photograph's boxes; ``found`` (10, m). ``coco_precision`` (10,): average precision accumulated by pycocotools, NaN
    without labelled boxes.
    """

    defect_class: DefectClass
    images: tuple[LabelledImage, ...]
    image: RowIndices
    rank: RowIndices
    score: Float64N
    hit: BoolArray
    ignored: BoolArray
    truth_image: RowIndices
    truth_rank: RowIndices
    found: BoolArray
    coco_precision: Float64N


def match_predictions(
    images: Sequence[LabelledImage],
    predictions: Mapping[str, tuple[Prediction, ...]],
    defect_class: DefectClass,
    *,
    boxes_max: int = COCO_BOXES_MAX,
) -> PredictionMatches:
    """Match the predictions of a class with the labelled boxes.

    Args:
        images: The labelled photographs.
        predictions: Predictions by the photograph's key.
        defect_class: The class; photographs without labels of it are left out.
        boxes_max: Only so many predictions of a photograph count, those of the highest scores.
    """
    chosen = tuple(image for image in images if defect_class in image.labelled)
    truths = _list_boxes_of_class([image.boxes for image in chosen], defect_class)
    predicted = _list_boxes_of_class([predictions[image.key] for image in chosen], defect_class)
    evaluation = _run_pycocotools(chosen, truths, predicted, boxes_max)
    parts = [one for one in evaluation.evalImgs if one is not None]
    predicted_ids, truth_ids = ([id_ for one in parts for id_ in one[key]] for key in ("dtIds", "gtIds"))
    score = np.array([one for part in parts for one in part["dtScores"]], dtype=np.float64)
    order = np.argsort(-score, kind="mergesort")  # as pycocotools orders equal scores
    counting = ~_concatenate_results(parts, "gtIgnore").astype(np.bool_).ravel()
    predicted_indices = np.array([predicted[id_ - 1][:2] for id_ in predicted_ids], dtype=np.int64).reshape(-1, 2)
    truth_indices = np.array([truths[id_ - 1][:2] for id_ in truth_ids], dtype=np.int64).reshape(-1, 2)
    ignored = _concatenate_results(parts, "dtIgnore").astype(np.bool_)
    precision = (
        evaluation.eval["precision"][:, :, 0, 0, 0].mean(axis=1) if parts else np.full(len(IOU_THRESHOLDS), -1.0)
    )
    return PredictionMatches(
        defect_class=defect_class,
        images=chosen,
        image=predicted_indices[order, 0],
        rank=predicted_indices[order, 1],
        score=score[order],
        hit=((_concatenate_results(parts, "dtMatches") > 0) & ~ignored)[:, order],
        ignored=ignored[:, order],
        truth_image=truth_indices[counting, 0],
        truth_rank=truth_indices[counting, 1],
        found=_concatenate_results(parts, "gtMatches")[:, counting] > 0,
        coco_precision=np.where(precision < 0, np.nan, precision),
    )


def compute_average_precision(
    matches: PredictionMatches, weights: Float64N | None = None, *, thresholds: int = len(IOU_THRESHOLDS)
) -> Float64N:
    """Average precision at the first ``thresholds`` of ``IOU_THRESHOLDS``; NaN without labelled boxes.

    ``weights`` (one for each photograph) repeat photographs or leave them out: matches in one photograph do not depend
    on others, so that sites and resampled sets are not matched again.
    """
    curves = [compute_precision_at_recalls(matches, i, weights) for i in range(thresholds)]
    means: Float64N = np.array([curve.mean() for curve in curves])
    return means


def compute_precision_at_recalls(
    matches: PredictionMatches, threshold: int, weights: Float64N | None = None
) -> Float64N:
    """Precision envelope (101,) at ``RECALLS`` for the IoU threshold of that index; NaN without labelled boxes."""
    weight = np.ones(len(matches.images)) if weights is None else weights
    truths = weight[matches.truth_image].sum()
    if truths <= 0:
        return np.full(len(RECALLS), np.nan)
    prediction_weight = weight[matches.image]
    hits = np.cumsum(prediction_weight * matches.hit[threshold])
    false_alarms = np.cumsum(prediction_weight * ~(matches.hit[threshold] | matches.ignored[threshold]))
    precision = hits / np.maximum(hits + false_alarms, np.finfo(np.float64).tiny)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    index = np.searchsorted(hits / truths, RECALLS, side="left")
    at_recalls: Float64N = np.where(
        index < len(envelope), np.append(envelope, 0.0)[np.minimum(index, len(envelope))], 0.0
    )
    return at_recalls


def _list_boxes_of_class(boxes: Sequence[Sequence[Any]], defect_class: DefectClass) -> list[tuple[int, int, Any]]:
    """(index of the photograph, index in the photograph, box) of all boxes of a class."""
    return [
        (i, rank, box)
        for i, of_photograph in enumerate(boxes)
        for rank, box in enumerate(of_photograph)
        if box.defect_class is defect_class
    ]


def _run_pycocotools(
    images: Sequence[LabelledImage],
    truths: Sequence[tuple[int, int, Any]],
    predicted: Sequence[tuple[int, int, Any]],
    boxes_max: int,
) -> Any:
    """The evaluation of pycocotools, without its output to the terminal."""
    with redirect_stdout(io.StringIO()):
        evaluation = COCOeval(
            _build_coco(images, truths, lambda one: {"iscrowd": int(one.ignored)}),
            _build_coco(images, predicted, lambda one: {"score": one.score}),
            "bbox",
        )
        evaluation.params.iouThrs = IOU_THRESHOLDS
        evaluation.params.recThrs = RECALLS
        evaluation.params.maxDets = [boxes_max]
        evaluation.params.areaRng, evaluation.params.areaRngLbl = [[0.0, 1e10]], ["all"]
        evaluation.evaluate()
        evaluation.accumulate()
    return evaluation


def _build_coco(
    images: Sequence[LabelledImage],
    boxes: Sequence[tuple[int, int, Any]],
    extra_keys: Callable[[Any], dict[str, float]],
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
                **extra_keys(one),
            }
            for id_, (i, _, one) in enumerate(boxes, start=1)  # pycocotools reads 0 as no match
        ],
    }
    coco.createIndex()
    return coco


def _concatenate_results(parts: Sequence[Mapping[str, Any]], key: str) -> Float64Array:
    """The arrays (10, n) or (n,) of all photographs, concatenated."""
    arrays = [np.asarray(one[key], dtype=np.float64) for one in parts]
    if not arrays:
        return np.zeros((len(IOU_THRESHOLDS), 0)) if key != "gtIgnore" else np.zeros(0)
    return np.concatenate(arrays, axis=-1)
