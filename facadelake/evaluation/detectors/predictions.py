"""Predictions on labelled photographs: from a model, from a file of detections, or from anything else that looks."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from PIL import Image as PilImage

from facadelake.core.arrays import UInt8Image
from facadelake.core.progress import track
from facadelake.detection import Box, Crosswalk, clip_box
from facadelake.detection.inference import DetectedBox, read_photograph
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from schemas.vocabulary import DefectClass

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """A box inside its photograph; ``score`` from 0 to 1."""

    box: Box
    score: float
    defect_class: DefectClass


@dataclass(frozen=True, kw_only=True)
class ImagePredictions:
    """What was found in one photograph: down to a score of 0.01, and what a user is shown."""

    above_floor: tuple[DetectedBox, ...]
    above_threshold: tuple[DetectedBox, ...]


class PredictionSource(Protocol):
    """Whatever finds boxes. ``threshold`` is the score from which a user is shown a box."""

    @property
    def name(self) -> str: ...

    @property
    def sha256(self) -> str: ...

    @property
    def threshold(self) -> float: ...

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class CollectedPredictions:
    """Predictions by photograph's key; ``left_out`` counts boxes that could not be used, by reason.

    ``images`` are those that could be read; ``seconds`` is the time spent looking, not reading files.
    """

    images: tuple[LabelledImage, ...]
    above_floor: Mapping[str, tuple[Prediction, ...]]
    above_threshold: Mapping[str, tuple[Prediction, ...]]
    left_out: Mapping[str, int]
    seconds: float

    @property
    def megapixels(self) -> float:
        """Of all photographs."""
        return sum(image.width_px * image.height_px for image in self.images) / 1e6


def collect_predictions(
    looker: PredictionSource, images: Sequence[LabelledImage], crosswalk: Crosswalk
) -> CollectedPredictions:
    """Look at every photograph, one in memory at a time; one that cannot be decoded is left out and counted."""
    low: dict[str, tuple[Prediction, ...]] = {}
    shown: dict[str, tuple[Prediction, ...]] = {}
    left_out: Counter[str] = Counter()
    read: list[LabelledImage] = []
    seconds = 0.0
    for image in track(images, label="Looking"):
        pixels = read_pixels(image.path)
        if pixels is None:
            _log.warning("%s cannot be decoded and is left out", image.path)
            left_out["photographs that cannot be decoded"] += 1
            continue
        begin = time.perf_counter()
        looks = looker.detect(image, pixels)
        seconds += time.perf_counter() - begin
        read.append(image)
        low[image.key] = _filter_predictions(looks.above_floor, image, crosswalk, left_out)
        shown[image.key] = _filter_predictions(looks.above_threshold, image, crosswalk, Counter())
    return CollectedPredictions(
        images=tuple(read), above_floor=low, above_threshold=shown, left_out=dict(left_out), seconds=seconds
    )


def read_pixels(path: Path) -> UInt8Image | None:
    """A photograph (h, w, 3: blue, green, red) as stored, or None where it cannot be decoded to its end."""
    try:
        with PilImage.open(path) as whole:
            whole.load()  # OpenCV makes grey of what a torn file lacks; an inspection refuses such a photograph
    except (OSError, SyntaxError, ValueError, PilImage.DecompressionBombError):
        return None
    return read_photograph(path)


def _filter_predictions(
    found: Sequence[DetectedBox], image: LabelledImage, crosswalk: Crosswalk, left_out: Counter[str]
) -> tuple[Prediction, ...]:
    kept = []
    for one in found:
        defect_class = crosswalk.find_defect_class(one.class_name)
        inside = clip_box(one.box, image_width_px=image.width_px, image_height_px=image.height_px).inside
        if defect_class is None:
            left_out[f"boxes found of class '{one.class_name}', which stands for no defect class"] += 1
        elif inside is None:
            left_out["boxes found outside their photograph"] += 1
        elif not _is_on_target(inside, image):
            left_out["boxes found beside the building"] += 1
        else:
            kept.append(Prediction(box=inside, score=one.score, defect_class=defect_class))
    return tuple(sorted(kept, key=lambda prediction: -prediction.score))


def _is_on_target(box: Box, image: LabelledImage) -> bool:
    """Whether the box's middle lies on the building; elsewhere an inspection has no wall to put it on."""
    if image.target is None:
        return True
    rows, columns = image.target.shape
    row = int((box.y_px + box.height_px / 2) / image.height_px * rows)
    column = int((box.x_px + box.width_px / 2) / image.width_px * columns)
    return bool(image.target[min(row, rows - 1), min(column, columns - 1)])
