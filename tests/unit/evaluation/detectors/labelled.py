"""Labelled photographs and predictions in memory, and small pictures on disk."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from facadelake.detection.boxes import Box
from facadelake.evaluation.detectors.labels.labels import LabelledImage, TruthBox
from facadelake.evaluation.detectors.predictions import Prediction
from schemas.vocabulary import DefectClass

CRACK, SPALLING, MOISTURE = DefectClass

Corner = tuple[float, float, float, float]


def box(x: float, y: float, width: float, height: float) -> Box:
    return Box(x_px=x, y_px=y, width_px=width, height_px=height)


def image(
    key: str,
    *boxes: Corner,
    site: str | None = None,
    defect_class: DefectClass = CRACK,
    labelled: tuple[DefectClass, ...] = (CRACK,),
    ignored: tuple[Corner, ...] = (),
    area_m2: float | None = None,
) -> LabelledImage:
    """A photograph of 100 x 80 px that is not on disk."""
    return LabelledImage(
        key=key,
        path=Path(key),
        width_px=100,
        height_px=80,
        boxes=(
            *(TruthBox(box=box(*one), defect_class=defect_class) for one in boxes),
            *(TruthBox(box=box(*one), defect_class=defect_class, ignored=True) for one in ignored),
        ),
        labelled=frozenset(labelled),
        site=site,
        area_m2=area_m2,
    )


def guess(score: float, corner: Corner, defect_class: DefectClass = CRACK) -> Prediction:
    return Prediction(box=box(*corner), score=score, defect_class=defect_class)


def picture(path: Path, width: int = 100, height: int = 80) -> Path:
    """A grey photograph on disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((height, width, 3), 128, dtype=np.uint8))
    return path
