"""Predictions on labelled photographs, from any source: a model, a file, a classical filter."""

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
    """A predicted box inside its photograph, px; ``score`` from 0 to 1."""

    box: Box
    score: float
    defect_class: DefectClass


@dataclass(frozen=True, kw_only=True)
class ImagePredictions:
    """The detections in one photograph: down to the lowest score, and at the detector's threshold."""

    above_floor: tuple[DetectedBox, ...]
    above_threshold: tuple[DetectedBox, ...]


class PredictionSource(Protocol):
    """A detector, or a file of its detections. ``threshold``: the least score of a box that is shown."""

    @property
    def name(self) -> str: ...

    @property
    def sha256(self) -> str: ...

    @property
    def threshold(self) -> float: ...

    @property
    def left_out(self) -> Mapping[str, int]: ...

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class CollectedPredictions:
    """Predictions by the photograph's key.

    ``images``: the photographs that can be read; ``left_out``: numbers of photographs and boxes that cannot be used, by
    reason; ``seconds``: time of detection, without reading of files.
    """

    images: tuple[LabelledImage, ...]
    above_floor: Mapping[str, tuple[Prediction, ...]]
    above_threshold: Mapping[str, tuple[Prediction, ...]]
    left_out: Mapping[str, int]
    seconds: float

    @property
    def megapixels(self) -> float:
        """Size of all photographs."""
        return sum(image.width_px * image.height_px for image in self.images) / 1e6


def collect_predictions(
    source: PredictionSource, images: Sequence[LabelledImage], crosswalk: Crosswalk
) -> CollectedPredictions:
    """Run ``source`` on each photograph; one that cannot be decoded is left out and counted."""
    above_floor: dict[str, tuple[Prediction, ...]] = {}
    above_threshold: dict[str, tuple[Prediction, ...]] = {}
    left_out: Counter[str] = Counter()
    read: list[LabelledImage] = []
    seconds = 0.0
    for image in track(images, label="Detecting"):
        pixels = read_pixels(image.path)
        if pixels is None:
            _log.warning("%s cannot be decoded and is left out", image.path)
            left_out["photographs that cannot be decoded"] += 1
            continue
        begin = time.perf_counter()
        detected = source.detect(image, pixels)
        seconds += time.perf_counter() - begin
        read.append(image)
        above_floor[image.key] = _filter_predictions(detected.above_floor, image, crosswalk, left_out)
        above_threshold[image.key] = _filter_predictions(detected.above_threshold, image, crosswalk, Counter())
    return CollectedPredictions(
        images=tuple(read),
        above_floor=above_floor,
        above_threshold=above_threshold,
        left_out=dict(left_out + Counter(source.left_out)),
        seconds=seconds,
    )


def read_pixels(path: Path) -> UInt8Image | None:
    """Pixels of a photograph (h, w, 3: blue, green, red) as stored; None where it cannot be decoded completely."""
    try:
        with PilImage.open(path) as opened:
            opened.load()  # OpenCV fills the missing part of a truncated file with grey; an inspection refuses it
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
            left_out[f"predicted boxes of class '{one.class_name}', which has no defect class"] += 1
        elif inside is None:
            left_out["predicted boxes outside their photograph"] += 1
        elif not _is_on_target(inside, image):
            left_out["predicted boxes off the building"] += 1
        else:
            kept.append(Prediction(box=inside, score=one.score, defect_class=defect_class))
    return tuple(sorted(kept, key=lambda prediction: -prediction.score))


def _is_on_target(box: Box, image: LabelledImage) -> bool:
    """Whether the centre of the box is on the building; an inspection does not register other boxes."""
    if image.target is None:
        return True
    rows, columns = image.target.shape
    row = int((box.y_px + box.height_px / 2) / image.height_px * rows)
    column = int((box.x_px + box.width_px / 2) / image.width_px * columns)
    return bool(image.target[min(row, rows - 1), min(column, columns - 1)])
