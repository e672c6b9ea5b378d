"""Predictions on labelled photographs: from a model, from a file of detections, or from anything else that looks."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.cache import file_hash
from facadelake.detect.boxes import Box, clip_box
from facadelake.detect.card import ModelCard
from facadelake.detect.coco_file import CocoAnnotation, number, read_coco
from facadelake.detect.crosswalk import Crosswalk
from facadelake.detect.detector import Found, OnnxDetector
from facadelake.detect.find_card import find_card
from facadelake.detect.letterbox import Image
from facadelake.detect.tiling import detect_image
from facadelake.errors import InputDataError
from facadelake.evaluate.detector.labels import LabelledImage
from facadelake.progress import track
from schemas.vocabulary import DefectClass

_log = logging.getLogger(__name__)

# Precision at high recall needs the boxes that nobody would be shown.
FLOOR = 0.01
_MOST = 300


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """A box inside its photograph; ``score`` from 0 to 1."""

    box: Box
    score: float
    defect_class: DefectClass


@dataclass(frozen=True, kw_only=True)
class Looks:
    """What was found in one photograph: down to ``FLOOR``, and what a user is shown."""

    down_to_floor: tuple[Found, ...]
    shown: tuple[Found, ...]


class Looker(Protocol):
    """Whatever finds boxes. ``threshold`` is the score from which a user is shown a box."""

    @property
    def name(self) -> str: ...

    @property
    def sha256(self) -> str: ...

    @property
    def threshold(self) -> float: ...

    def look(self, image: LabelledImage, pixels_bgr: Image) -> Looks: ...


class OnnxLooker:
    """A model with its card's threshold, and with one so low that precision can be drawn against recall.

    Each tile is run once: suppression goes from the best down, so that what a tile shows at the card's threshold is
    the best of what it shows at the low one. What is made of tiles along their seams is made twice, because faint
    boxes about would make others of them.
    """

    def __init__(self, model: Path, *, threshold: float | None = None) -> None:
        """Load ``model`` with its card; ``threshold`` goes over the card's."""
        self.card = find_card(model)
        self.threshold = self.card.score_threshold if threshold is None else threshold
        low = {"score_threshold": min(FLOOR, self.threshold), "max_detections": max(_MOST, self.card.max_detections)}
        self._detector = OnnxDetector(model, self.card.model_copy(update=low))
        self.name, self.sha256 = self._detector.name, self._detector.sha256

    def look(self, image: LabelledImage, pixels_bgr: Image) -> Looks:
        """What both thresholds give."""
        seen: list[tuple[tuple[Found, ...], ...]] = []
        low = detect_image(_Recording(self._detector, seen), pixels_bgr, gsd_mm=image.gsd_mm, target=image.target)
        replayed = _Replaying(self.card, self.threshold, iter(seen))
        return Looks(
            down_to_floor=low,
            shown=detect_image(replayed, pixels_bgr, gsd_mm=image.gsd_mm, target=image.target),
        )


class _Recording:
    """A detector that keeps what it gave, batch after batch."""

    def __init__(self, detector: OnnxDetector, seen: list[tuple[tuple[Found, ...], ...]]) -> None:
        self.card = detector.card
        self._detector, self._seen = detector, seen

    def detect_batch(self, images_bgr: Sequence[Image]) -> tuple[tuple[Found, ...], ...]:
        self._seen.append(self._detector.detect_batch(images_bgr))
        return self._seen[-1]


class _Replaying:
    """A detector that gives again, in the same order of batches, what reaches ``threshold``."""

    def __init__(self, card: ModelCard, threshold: float, seen: Iterator[tuple[tuple[Found, ...], ...]]) -> None:
        self.card = card
        self._threshold, self._seen = threshold, seen

    def detect_batch(self, images_bgr: Sequence[Image]) -> tuple[tuple[Found, ...], ...]:
        return tuple(
            tuple(one for one in many if one.score >= self._threshold)[: self.card.max_detections]
            for many in next(self._seen)
        )


class FileLooker:
    """Detections of a COCO file, by the photographs' file names; a box without a score has 1."""

    def __init__(self, file: Path, threshold: float = 0.0) -> None:
        """Read ``file``. Raises InputDataError where it cannot be used."""
        coco = read_coco(file)
        self.name, self.sha256, self.threshold = file.name, file_hash(file), threshold
        self._found: dict[str, list[Found]] = {}
        self.unusable = 0
        for annotation in coco.annotations:
            image = coco.images.get(annotation.image_id)
            found = _found(annotation, coco.categories.get(annotation.category_id))
            if image is None or found is None:
                self.unusable += 1
                continue
            self._found.setdefault(image.file_name.replace("\\", "/"), []).append(found)
        self._names = frozenset(image.file_name.replace("\\", "/") for image in coco.images.values())

    def look(self, image: LabelledImage, pixels_bgr: Image) -> Looks:
        """The file's boxes of this photograph, by the longest end of its path that the file names."""
        parts = image.key.split("/")
        name = next((end for i in range(len(parts)) if (end := "/".join(parts[i:])) in self._names), None)
        found = tuple(self._found.get(name, ())) if name else ()
        return Looks(down_to_floor=found, shown=tuple(one for one in found if one.score >= self.threshold))

    def refuse_if_strange(self, images: Sequence[LabelledImage]) -> None:
        """Raise InputDataError where the file names none of the photographs."""
        ends = {"/".join(image.key.split("/")[i:]) for image in images for i in range(image.key.count("/") + 1)}
        if not ends & self._names:
            raise InputDataError(
                f"{self.name} names none of the {len(images)} labelled photographs, such as '{images[0].key}'; "
                "its images' file_name must be theirs"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Collected:
    """Predictions by photograph's key; ``left_out`` counts boxes that could not be used, by reason.

    ``images`` are those that could be read; ``seconds`` is the time spent looking, not reading files.
    """

    images: tuple[LabelledImage, ...]
    down_to_floor: Mapping[str, tuple[Prediction, ...]]
    shown: Mapping[str, tuple[Prediction, ...]]
    left_out: Mapping[str, int]
    seconds: float

    @property
    def megapixels(self) -> float:
        """Of all photographs."""
        return sum(image.width_px * image.height_px for image in self.images) / 1e6


def collect(looker: Looker, images: Sequence[LabelledImage], crosswalk: Crosswalk) -> Collected:
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
        looks = looker.look(image, pixels)
        seconds += time.perf_counter() - begin
        read.append(image)
        low[image.key] = _predictions(looks.down_to_floor, image, crosswalk, left_out)
        shown[image.key] = _predictions(looks.shown, image, crosswalk, Counter())
    return Collected(images=tuple(read), down_to_floor=low, shown=shown, left_out=dict(left_out), seconds=seconds)


def read_pixels(path: Path) -> NDArray[np.uint8] | None:
    """A photograph (h, w, 3: blue, green, red) as stored, or None where it cannot be decoded."""
    try:
        pixels = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:  # a size beyond OpenCV's limit
        return None
    return None if pixels is None else np.asarray(pixels, dtype=np.uint8)


def _predictions(
    found: Sequence[Found], image: LabelledImage, crosswalk: Crosswalk, left_out: Counter[str]
) -> tuple[Prediction, ...]:
    kept = []
    for one in found:
        defect_class = crosswalk.defect_class(one.class_name)
        inside = clip_box(one.box, image_width_px=image.width_px, image_height_px=image.height_px).inside
        if defect_class is None:
            left_out[f"boxes found of class '{one.class_name}', which stands for no defect class"] += 1
        elif inside is None:
            left_out["boxes found outside their photograph"] += 1
        elif not _on_target(inside, image):
            left_out["boxes found beside the building"] += 1
        else:
            kept.append(Prediction(box=inside, score=one.score, defect_class=defect_class))
    return tuple(sorted(kept, key=lambda prediction: -prediction.score))


def _on_target(box: Box, image: LabelledImage) -> bool:
    """Whether the box's middle lies on the building; elsewhere an inspection has no wall to put it on."""
    if image.target is None:
        return True
    rows, columns = image.target.shape
    row = int((box.y_px + box.height_px / 2) / image.height_px * rows)
    column = int((box.x_px + box.width_px / 2) / image.width_px * columns)
    return bool(image.target[min(row, rows - 1), min(column, columns - 1)])


def _found(annotation: CocoAnnotation, class_name: str | None) -> Found | None:
    values = [number(value) for value in annotation.bbox] if isinstance(annotation.bbox, list) else []
    numbers = [value for value in values if value is not None]
    score = 1.0 if annotation.score is None else number(annotation.score)
    if class_name is None or len(numbers) != 4 or min(numbers[2:]) <= 0 or score is None or not 0 <= score <= 1:
        return None
    x, y, width, height = numbers
    return Found(box=Box(x_px=x, y_px=y, width_px=width, height_px=height), score=score, class_name=class_name)
