"""Average precision on whole pictures, scaled to the input of the network."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from torch import nn

from facadelake.core.arrays import Float32Array, Float32Nx4, Float64Array, Int64Array
from training.assign import Cells, compute_iou_matrix, decode
from training.data.sample import CLASSES, Sample
from training.view import Placement, place_image

NMS_IOU = 0.5
SCORE_MIN = 0.01
BOXES_MAX = 100


@dataclass(frozen=True, kw_only=True)
class DetectedBoxes:
    """Detections of a picture by falling score: boxes (n, 4: x_min, y_min, x_max, y_max; px), class indices, scores."""

    corners_px: Float32Nx4
    classes: Int64Array
    scores: Float32Array


@dataclass(frozen=True, kw_only=True)
class DetectionScores:
    """AP50 and AP50:95 by class, and mean number of boxes with score > 0.5 per picture without defects.

    Classes without true boxes are omitted.
    """

    ap50: dict[str, float]
    ap: dict[str, float]
    false_boxes: float

    @property
    def mean(self) -> float:
        """Mean AP50 over the classes with true boxes."""
        return float(np.mean(list(self.ap50.values()))) if self.ap50 else 0.0


def create_letterbox(width_px: int, height_px: int, side_px: int) -> Placement:
    """Placement of the whole picture in the top left corner, with its aspect ratio."""
    gain = min(side_px / width_px, side_px / height_px)
    matrix = np.array([[gain, 0, 0], [0, gain, 0]], dtype=np.float64)
    return Placement(input_from_image=matrix, width_px=side_px, height_px=side_px)


@torch.no_grad()
def detect_boxes(network: nn.Module, samples: Sequence[Sample], cells: Cells, side_px: int) -> list[DetectedBoxes]:
    """Detections of the network in each picture."""
    network.eval()
    found = []
    for sample in samples:
        image = sample.read()
        placement = create_letterbox(image.shape[1], image.shape[0], side_px)
        image_input = torch.from_numpy(place_image(image, placement).transpose(2, 0, 1)[None].astype(np.float32))
        raw = network(image_input)[0].float()
        raw[:, 4:] = raw[:, 4:].sigmoid()
        found.append(_scale_boxes(select_boxes(raw.numpy(), cells), 1 / placement.gain))
    return found


def select_boxes(output: Float32Array, cells: Cells) -> DetectedBoxes:
    """Boxes of one output (cells, 5 + classes; objectness and classes 0..1), after suppression by class."""
    scores = output[:, 4:5] * output[:, 5:]
    cell, kind = np.nonzero(scores > SCORE_MIN)
    corners = decode(output[:, :4], cells)[cell]
    score = scores[cell, kind]
    kept: list[int] = []
    for one in np.unique(kind):
        order = np.flatnonzero(kind == one)
        order = order[np.argsort(-score[order], kind="stable")][:1000]
        while len(order):
            kept.append(int(order[0]))
            order = order[1:][compute_iou_matrix(corners[order[:1]], corners[order[1:]])[0] <= NMS_IOU]
    best = np.array(kept, dtype=np.int64)
    best = best[np.argsort(-score[best], kind="stable")][:BOXES_MAX]
    return DetectedBoxes(corners_px=corners[best], classes=kind[best], scores=score[best])


def compute_scores(samples: Sequence[Sample], found: Sequence[DetectedBoxes]) -> DetectionScores:
    """Compare the detections with the true boxes of the samples."""
    images, truth, detections = [], [], []
    for i, (sample, boxes) in enumerate(zip(samples, found, strict=True), start=1):
        images.append({"id": i, "width": 1, "height": 1})
        for box, kind in zip(sample.boxes_px, sample.classes, strict=True):
            truth.append(_create_annotation(i, box, int(kind), id=len(truth) + 1, iscrowd=0))
        for box, kind, score in zip(boxes.corners_px, boxes.classes, boxes.scores, strict=True):
            detections.append(_create_annotation(i, box, int(kind), score=float(score)))
    false = [
        int((boxes.scores > 0.5).sum()) for sample, boxes in zip(samples, found, strict=True) if not len(sample.classes)
    ]
    false_boxes = float(np.mean(false)) if false else 0.0
    if not detections:
        return DetectionScores(ap50={}, ap={}, false_boxes=false_boxes)
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO()
        categories = [{"id": i, "name": str(name)} for i, name in enumerate(CLASSES)]
        coco.dataset = {"images": images, "annotations": truth, "categories": categories}
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(detections), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
    precision = evaluation.eval["precision"][..., 0, 2]  # IoU, recall, class
    evaluated = [i for i in range(len(CLASSES)) if (precision[..., i] > -1).any()]
    return DetectionScores(
        ap50={str(CLASSES[i]): float(precision[0, :, i].mean()) for i in evaluated},
        ap={str(CLASSES[i]): float(precision[..., i].mean()) for i in evaluated},
        false_boxes=false_boxes,
    )


def _create_annotation(image: int, box: Float32Array | Float64Array, kind: int, **more: float) -> dict[str, object]:
    x, y, right, bottom = (float(v) for v in box)
    size = [x, y, right - x, bottom - y]
    return {"image_id": image, "category_id": kind, "bbox": size, "area": size[2] * size[3], **more}


def _scale_boxes(boxes: DetectedBoxes, gain: float) -> DetectedBoxes:
    return DetectedBoxes(corners_px=boxes.corners_px * np.float32(gain), classes=boxes.classes, scores=boxes.scores)
