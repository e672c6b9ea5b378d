"""Scores that mean probabilities, a threshold, and the card: `python -m training.calibrate --model ... --data ...`.

Platt's line on the logit (Platt, Probabilistic outputs for support vector machines, 1999) is fitted to what the
detector finds, as it is used, in the pictures kept for choosing, real and generated (the only ones with moisture);
threshold and suppression are chosen by the real ones. The test sites are not looked at.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from facadelake.core.hashing import hash_file
from facadelake.detection import ModelCard, locate_card
from facadelake.detection.card import CardInput, CardOutput, OutputLayout, ResizeMode, ScoreCalibration, format_card
from facadelake.detection.inference import OnnxDetector
from facadelake.detection.tiling import detect_image
from training.assign import iou_matrix
from training.data.sample import CLASSES, Sample
from training.sources import TRAINED_ON, drawn_samples, judged_samples, validation_samples

INPUT_PX = 416
LOWEST = 0.02  # of the uncalibrated score; what is below says nothing more
NMS_IOUS = (0.45, 0.6)
HIT_IOU = 0.5
F1_TIE = 0.015  # thresholds are alike in F1 up to this; the lowest of them is taken: a missed defect is worse,
ALARMS_MOST = 0.5  # while no more boxes than this are shown in a picture without defects (a facade of some 150 m2)
ALARM_RANGE = np.arange(0.2, 0.91, 0.01)


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a detector said in a set of pictures, best first, and what it should have."""

    score: NDArray[np.float64]
    hit: NDArray[np.bool_]
    kind: NDArray[np.int64]
    truths: NDArray[np.int64]  # of each class
    quiet: NDArray[np.bool_]  # said in a picture without defects
    quiet_pictures: int

    def f1(self, threshold: float) -> float:
        """Harmonic mean of precision and recall at a score; mean of the classes that are there to be found."""
        shown = self.score >= threshold
        scores = [
            2
            * int((self.hit & shown & (self.kind == kind)).sum())
            / (int((shown & (self.kind == kind)).sum()) + truths)
            for kind, truths in enumerate(self.truths)
            if truths
        ]
        return float(np.mean(scores))

    def alarms(self, threshold: float) -> float:
        """Boxes in a picture without defects."""
        return float((self.quiet & (self.score >= threshold)).sum() / max(self.quiet_pictures, 1))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True, help="folder with defects/ and drone/")
    parser.add_argument("--generated", type=Path, nargs="*", default=())
    parser.add_argument("--judge", type=Path, nargs="*", default=(), help="real areas, as COCO, to choose by")
    parser.add_argument("--name", default="facadelake-nano")
    options = parser.parse_args()
    real = (*validation_samples(options.data), *judged_samples(options.judge))
    drawn = drawn_samples(options.generated)
    tried = {iou: tell(options.model, base_card(options.name, nms_iou=iou), real) for iou in NMS_IOUS}
    best_f1 = {iou: max(told.f1(t) for t in ALARM_RANGE) for iou, told in tried.items()}
    nms_iou = max(best_f1, key=lambda iou: best_f1[iou])
    print("suppression IoU -> best F1:", {iou: round(f1, 3) for iou, f1 in best_f1.items()}, "chosen", nms_iou)
    card = base_card(options.name, nms_iou=nms_iou)
    told, also = tried[nms_iou], tell(options.model, card, drawn)
    line = platt(np.concatenate([told.score, also.score]), np.concatenate([told.hit, also.hit]))
    told = replace(told, score=_line(told.score, line))
    quiet = [one for one in ALARM_RANGE if told.alarms(one) <= ALARMS_MOST]
    enough = max(told.f1(one) for one in quiet) - F1_TIE
    threshold = float(min(one for one in quiet if told.f1(one) >= enough))
    for one in (*np.arange(0.2, 0.91, 0.1), threshold):
        print(f"score {one:.2f}: F1 {told.f1(one):.3f}, false boxes a quiet picture {told.alarms(one):.2f}")
    card = card.model_copy(update={"score_calibration": line, "score_threshold": round(threshold, 2)})
    card = card.model_copy(update={"metrics": {"model_sha256": hash_file(options.model)}})
    locate_card(options.model).write_text(format_card(card), encoding="utf-8")
    print(f"{locate_card(options.model)}: slope {line.slope}, intercept {line.intercept}, threshold {threshold:.2f}")


def base_card(name: str, *, nms_iou: float) -> ModelCard:
    """What is known of the model before it is calibrated."""
    return ModelCard(
        name=name,
        licence="Apache-2.0",
        source="https://github.com/Megvii-BaseDetection/YOLOX (YOLOX-nano, Apache-2.0); training/README.md",
        training_data=TRAINED_ON,
        class_names=tuple(str(name) for name in CLASSES),
        input=CardInput(width_px=INPUT_PX, height_px=INPUT_PX, colour="bgr", scale=1.0, resize=ResizeMode.CORNER),
        output=CardOutput(layout=OutputLayout.YOLOX),
        score_threshold=LOWEST,
        nms_iou=nms_iou,
    )


def tell(model: Path, card: ModelCard, samples: Sequence[Sample]) -> Told:
    """Look at every picture as the product does, and match what is found with the boxes, best first, once each."""
    detector = OnnxDetector(model, card)
    scores: list[float] = []
    hits: list[bool] = []
    kinds: list[int] = []
    quiet: list[bool] = []
    for sample in samples:
        free = np.ones(len(sample.classes), dtype=bool)
        for one in detect_image(detector, sample.read()):
            box = one.box
            corners = np.array([[box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px]])
            iou = iou_matrix(corners.astype(np.float32), sample.boxes_px.astype(np.float32))[0]
            kind = [str(name) for name in CLASSES].index(one.class_name)
            iou[~free | (sample.classes != kind)] = 0
            hit = bool(len(iou)) and iou.max() >= HIT_IOU
            if hit:
                free[iou.argmax()] = False
            scores.append(one.score)
            hits.append(hit)
            kinds.append(kind)
            quiet.append(not len(sample.classes))
    return Told(
        score=np.array(scores, dtype=np.float64),
        hit=np.array(hits, dtype=bool),
        kind=np.array(kinds, dtype=np.int64),
        truths=np.bincount(
            np.concatenate([sample.classes for sample in samples] or [np.zeros(0, np.int64)]), minlength=len(CLASSES)
        ),
        quiet=np.array(quiet, dtype=bool),
        quiet_pictures=sum(not len(sample.classes) for sample in samples),
    )


def platt(score: NDArray[np.float64], hit: NDArray[np.bool_]) -> ScoreCalibration:
    """The line on the logit of the score that makes the hits likeliest, with Platt's softened targets."""
    logit = _logit(score)
    right, wrong = int(hit.sum()), int((~hit).sum())
    target = np.where(hit, (right + 1) / (right + 2), 1 / (wrong + 2))

    def surprise(line: NDArray[np.float64]) -> float:
        said = np.exp(line[0]) * logit + line[1]
        return float((np.logaddexp(0, said) - target * said).mean())

    slope, intercept = minimize(surprise, np.zeros(2), method="Nelder-Mead").x
    return ScoreCalibration(slope=round(float(np.exp(slope)), 4), intercept=round(float(intercept), 4))


def _line(score: NDArray[np.float64], by: ScoreCalibration) -> NDArray[np.float64]:
    calibrated: NDArray[np.float64] = 1 / (1 + np.exp(-(by.slope * _logit(score) + by.intercept)))
    return calibrated


def _logit(score: NDArray[np.float64]) -> NDArray[np.float64]:
    inside = np.clip(score, 1e-7, 1 - 1e-7)
    logit: NDArray[np.float64] = np.log(inside) - np.log1p(-inside)
    return logit


if __name__ == "__main__":
    main()
