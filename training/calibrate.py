"""Calibration of scores, choice of thresholds, and the card: `python -m training.calibrate --model ... --data ...`.

A line on the logit of the score (Platt, Probabilistic outputs for support vector machines, 1999) is fitted to the
detections in the validation pictures, real and generated (only these have moisture), with the detector run as in the
product. Score threshold and IoU of the suppression are chosen on the real ones. The test sites are not used.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.hashing import hash_file
from facadelake.detection import ModelCard, locate_card
from facadelake.detection.card import CardInput, CardOutput, OutputLayout, ResizeMode, ScoreCalibration, format_card
from facadelake.detection.inference import OnnxDetector
from facadelake.detection.tiling import detect_image
from training.assign import compute_iou_matrix
from training.data.sample import CLASSES, Sample
from training.sources import TRAINED_ON, read_evaluation_samples, read_generated_samples, read_validation_samples

INPUT_PX = 416
SCORE_MIN = 0.02  # smallest uncalibrated score of a detection
NMS_IOUS = (0.45, 0.6)
HIT_IOU = 0.5
F1_TIE = 0.015  # of thresholds within this of the best F1 the lowest is chosen, because missed defects are worse
FALSE_BOXES_MAX = 0.5  # largest mean number of boxes in a picture without defects (a facade of about 150 m2)
THRESHOLDS = np.arange(0.2, 0.91, 0.01)


@dataclass(frozen=True, kw_only=True)
class MatchedDetections:
    """Detections (n) of a set of pictures, matched with the true boxes.

    ``hit``: whether the detection matches a true box of its class. ``kind``: its class index. ``sound``: whether its
    picture is without defects.
    """

    score: Float64Array
    hit: BoolArray
    kind: Int64Array
    truths: Int64Array  # number of true boxes by class
    sound: BoolArray
    sound_pictures: int

    def compute_f1(self, threshold: float) -> float:
        """F1 at a score threshold, mean over the classes with true boxes."""
        shown = self.score >= threshold
        scores = [
            2
            * int((self.hit & shown & (self.kind == kind)).sum())
            / (int((shown & (self.kind == kind)).sum()) + truths)
            for kind, truths in enumerate(self.truths)
            if truths
        ]
        return float(np.mean(scores))

    def compute_false_box_rate(self, threshold: float) -> float:
        """Mean number of boxes per picture without defects, at a score threshold."""
        return float((self.sound & (self.score >= threshold)).sum() / max(self.sound_pictures, 1))


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True, help="folder with defects/ and drone/")
    parser.add_argument("--generated", type=Path, nargs="*", default=(), help="folders written by training.generate")
    parser.add_argument("--validation", type=Path, nargs="*", default=(), help="validation sets with areas, COCO")
    parser.add_argument("--name", default="facadelake-nano")
    options = parser.parse_args()
    real = (*read_validation_samples(options.data), *read_evaluation_samples(options.validation))
    generated = read_generated_samples(options.generated)
    detections_by_iou = {
        iou: match_detections(options.model, create_card(options.name, nms_iou=iou), real) for iou in NMS_IOUS
    }
    best_f1 = {
        iou: max(real_detections.compute_f1(t) for t in THRESHOLDS)
        for iou, real_detections in detections_by_iou.items()
    }
    nms_iou = max(best_f1, key=lambda iou: best_f1[iou])
    print("suppression IoU -> best F1:", {iou: round(f1, 3) for iou, f1 in best_f1.items()}, "chosen", nms_iou)
    card = create_card(options.name, nms_iou=nms_iou)
    real_detections, generated_detections = detections_by_iou[nms_iou], match_detections(options.model, card, generated)
    line = fit_platt_line(
        np.concatenate([real_detections.score, generated_detections.score]),
        np.concatenate([real_detections.hit, generated_detections.hit]),
    )
    real_detections = replace(real_detections, score=_apply_line(real_detections.score, line))
    allowed = [one for one in THRESHOLDS if real_detections.compute_false_box_rate(one) <= FALSE_BOXES_MAX]
    f1_min = max(real_detections.compute_f1(one) for one in allowed) - F1_TIE
    threshold = float(min(one for one in allowed if real_detections.compute_f1(one) >= f1_min))
    for one in (*np.arange(0.2, 0.91, 0.1), threshold):
        f1, false_boxes = real_detections.compute_f1(one), real_detections.compute_false_box_rate(one)
        print(f"score {one:.2f}: F1 {f1:.3f}, false boxes per picture without defects {false_boxes:.2f}")
    card = card.model_copy(update={"score_calibration": line, "score_threshold": round(threshold, 2)})
    card = card.model_copy(update={"metrics": {"model_sha256": hash_file(options.model)}})
    locate_card(options.model).write_text(format_card(card), encoding="utf-8")
    print(f"{locate_card(options.model)}: slope {line.slope}, intercept {line.intercept}, threshold {threshold:.2f}")


def create_card(name: str, *, nms_iou: float) -> ModelCard:
    """The card of the model before calibration."""
    return ModelCard(
        name=name,
        licence="Apache-2.0",
        source="https://github.com/Megvii-BaseDetection/YOLOX (YOLOX-nano, Apache-2.0); training/README.md",
        training_data=TRAINED_ON,
        class_names=tuple(str(name) for name in CLASSES),
        input=CardInput(width_px=INPUT_PX, height_px=INPUT_PX, colour="bgr", scale=1.0, resize=ResizeMode.CORNER),
        output=CardOutput(layout=OutputLayout.YOLOX),
        score_threshold=SCORE_MIN,
        nms_iou=nms_iou,
    )


def match_detections(model: Path, card: ModelCard, samples: Sequence[Sample]) -> MatchedDetections:
    """Detect in every picture as the product does, and match the detections with the true boxes, best score first."""
    detector = OnnxDetector(model, card)
    scores: list[float] = []
    hits: list[bool] = []
    kinds: list[int] = []
    sound: list[bool] = []
    for sample in samples:
        free = np.ones(len(sample.classes), dtype=bool)
        for one in detect_image(detector, sample.read()):
            box = one.box
            corners = np.array([[box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px]])
            iou = compute_iou_matrix(corners.astype(np.float32), sample.boxes_px.astype(np.float32))[0]
            kind = [str(name) for name in CLASSES].index(one.class_name)
            iou[~free | (sample.classes != kind)] = 0
            hit = bool(len(iou)) and iou.max() >= HIT_IOU
            if hit:
                free[iou.argmax()] = False
            scores.append(one.score)
            hits.append(hit)
            kinds.append(kind)
            sound.append(not len(sample.classes))
    return MatchedDetections(
        score=np.array(scores, dtype=np.float64),
        hit=np.array(hits, dtype=bool),
        kind=np.array(kinds, dtype=np.int64),
        truths=np.bincount(
            np.concatenate([sample.classes for sample in samples] or [np.zeros(0, np.int64)]), minlength=len(CLASSES)
        ),
        sound=np.array(sound, dtype=bool),
        sound_pictures=sum(not len(sample.classes) for sample in samples),
    )


def fit_platt_line(score: Float64Array, hit: BoolArray) -> ScoreCalibration:
    """Line on the logit of the score (n,) of maximum likelihood of the hits (n,), with Platt's regularised targets."""
    logit = _compute_logit(score)
    right, wrong = int(hit.sum()), int((~hit).sum())
    target = np.where(hit, (right + 1) / (right + 2), 1 / (wrong + 2))

    def compute_loss(line: Float64Array) -> float:
        calibrated = np.exp(line[0]) * logit + line[1]
        return float((np.logaddexp(0, calibrated) - target * calibrated).mean())

    slope, intercept = minimize(compute_loss, np.zeros(2), method="Nelder-Mead").x
    return ScoreCalibration(slope=round(float(np.exp(slope)), 4), intercept=round(float(intercept), 4))


def _apply_line(score: Float64Array, line: ScoreCalibration) -> Float64Array:
    calibrated: Float64Array = 1 / (1 + np.exp(-(line.slope * _compute_logit(score) + line.intercept)))
    return calibrated


def _compute_logit(score: Float64Array) -> Float64Array:
    inside = np.clip(score, 1e-7, 1 - 1e-7)
    logit: Float64Array = np.log(inside) - np.log1p(-inside)
    return logit


if __name__ == "__main__":
    main()
