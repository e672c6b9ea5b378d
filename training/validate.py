"""Average precision on pictures as the finished detector sees them: each whole, shrunk or enlarged to the input."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from torch import nn

from training.assign import Cells, decode, iou_matrix
from training.data.sample import CLASSES, Sample
from training.view import Placing, lay_image

NMS_IOU = 0.5
LOWEST_SCORE = 0.01
MOST_BOXES = 100


@dataclass(frozen=True, kw_only=True)
class Boxes:
    """What was found in one picture: corners (n, 4) in pixels of the picture, class indices, scores; best first."""

    corners_px: NDArray[np.float32]
    classes: NDArray[np.int64]
    scores: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Scores:
    """AP50 and AP50:95 of each class that has boxes, and how many boxes over 0.5 a picture without defects gets."""

    ap50: dict[str, float]
    ap: dict[str, float]
    false_boxes: float

    @property
    def mean(self) -> float:
        """Mean AP50 over the classes that can be judged."""
        return float(np.mean(list(self.ap50.values()))) if self.ap50 else 0.0


def letterbox(width_px: int, height_px: int, side_px: int) -> Placing:
    """The whole picture at the left top corner, one gain."""
    gain = min(side_px / width_px, side_px / height_px)
    matrix = np.array([[gain, 0, 0], [0, gain, 0]], dtype=np.float64)
    return Placing(input_from_image=matrix, width_px=side_px, height_px=side_px)


@torch.no_grad()
def found_in(network: nn.Module, samples: Sequence[Sample], cells: Cells, side_px: int) -> list[Boxes]:
    """What the network finds in each picture."""
    network.eval()
    found = []
    for sample in samples:
        image = sample.read()
        placing = letterbox(image.shape[1], image.shape[0], side_px)
        laid = torch.from_numpy(lay_image(image, placing).transpose(2, 0, 1)[None].astype(np.float32))
        raw = network(laid)[0].float()
        raw[:, 4:] = raw[:, 4:].sigmoid()
        found.append(_scaled(best_boxes(raw.numpy(), cells), 1 / placing.gain))
    return found


def best_boxes(output: NDArray[np.float32], cells: Cells) -> Boxes:
    """Boxes of one raw output (cells, 5 + classes; objectness and classes 0..1), suppressed within each class."""
    scores = output[:, 4:5] * output[:, 5:]
    cell, kind = np.nonzero(scores > LOWEST_SCORE)
    corners = decode(output[:, :4], cells)[cell]
    score = scores[cell, kind]
    kept: list[int] = []
    for one in np.unique(kind):
        order = np.flatnonzero(kind == one)
        order = order[np.argsort(-score[order], kind="stable")][:1000]
        while len(order):
            kept.append(int(order[0]))
            order = order[1:][iou_matrix(corners[order[:1]], corners[order[1:]])[0] <= NMS_IOU]
    best = np.array(kept, dtype=np.int64)
    best = best[np.argsort(-score[best], kind="stable")][:MOST_BOXES]
    return Boxes(corners_px=corners[best], classes=kind[best], scores=score[best])


def scores_of(samples: Sequence[Sample], found: Sequence[Boxes]) -> Scores:
    """Judge what was found by the samples' own boxes."""
    images, truth, said = [], [], []
    for i, (sample, boxes) in enumerate(zip(samples, found, strict=True), start=1):
        images.append({"id": i, "width": 1, "height": 1})
        for box, kind in zip(sample.boxes_px, sample.classes, strict=True):
            truth.append(_annotation(i, box, int(kind), id=len(truth) + 1, iscrowd=0))
        for box, kind, score in zip(boxes.corners_px, boxes.classes, boxes.scores, strict=True):
            said.append(_annotation(i, box, int(kind), score=float(score)))
    false = [
        int((boxes.scores > 0.5).sum()) for sample, boxes in zip(samples, found, strict=True) if not len(sample.classes)
    ]
    quiet = float(np.mean(false)) if false else 0.0
    if not said:
        return Scores(ap50={}, ap={}, false_boxes=quiet)
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO()
        categories = [{"id": i, "name": str(name)} for i, name in enumerate(CLASSES)]
        coco.dataset = {"images": images, "annotations": truth, "categories": categories}
        coco.createIndex()
        judge = COCOeval(coco, coco.loadRes(said), "bbox")
        judge.evaluate()
        judge.accumulate()
    precision = judge.eval["precision"][..., 0, 2]  # IoU, recall, class
    judged = [i for i in range(len(CLASSES)) if (precision[..., i] > -1).any()]
    return Scores(
        ap50={str(CLASSES[i]): float(precision[0, :, i].mean()) for i in judged},
        ap={str(CLASSES[i]): float(precision[..., i].mean()) for i in judged},
        false_boxes=quiet,
    )


def _annotation(image: int, box: NDArray[np.floating], kind: int, **more: float) -> dict[str, object]:
    x, y, right, bottom = (float(v) for v in box)
    size = [x, y, right - x, bottom - y]
    return {"image_id": image, "category_id": kind, "bbox": size, "area": size[2] * size[3], **more}


def _scaled(boxes: Boxes, gain: float) -> Boxes:
    return Boxes(corners_px=boxes.corners_px * np.float32(gain), classes=boxes.classes, scores=boxes.scores)
