"""What can be judged: a model with its card, and a file of detections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from facadelake.core.arrays import UInt8Image
from facadelake.core.errors import InputDataError
from facadelake.core.hashing import hash_file
from facadelake.detection import Box, ModelCard
from facadelake.detection.coco import CocoAnnotation, parse_number, read_coco
from facadelake.detection.inference import DetectedBox, OnnxDetector, find_card
from facadelake.detection.tiling import detect_image
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.predictions import ImagePredictions

# Precision at high recall needs the boxes that nobody would be shown.
SCORE_FLOOR = 0.01
_DETECTIONS_MAX = 300


class OnnxPredictionSource:
    """A model with its card's threshold, and with one so low that precision can be drawn against recall.

    Each tile is run once: suppression goes from the best down, so that what a tile shows at the card's threshold is
    the best of what it shows at the low one. What is made of tiles along their seams is made twice, because faint
    boxes about would make others of them.
    """

    def __init__(self, model: Path, *, threshold: float | None = None) -> None:
        """Load ``model`` with its card; ``threshold`` goes over the card's."""
        self.card = find_card(model)
        self.threshold = self.card.score_threshold if threshold is None else threshold
        low = {
            "score_threshold": min(SCORE_FLOOR, self.threshold),
            "max_detections": max(_DETECTIONS_MAX, self.card.max_detections),
        }
        self._detector = OnnxDetector(model, self.card.model_copy(update=low))
        self.name, self.sha256 = self._detector.name, self._detector.sha256

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions:
        """What both thresholds give."""
        seen: list[tuple[tuple[DetectedBox, ...], ...]] = []
        low = detect_image(
            _RecordingDetector(self._detector, seen), pixels_bgr, gsd_mm=image.gsd_mm, target=image.target
        )
        replayed = _ReplayingDetector(self.card, self.threshold, iter(seen))
        return ImagePredictions(
            above_floor=low,
            above_threshold=detect_image(replayed, pixels_bgr, gsd_mm=image.gsd_mm, target=image.target),
        )


class _RecordingDetector:
    """A detector that keeps what it gave, batch after batch."""

    def __init__(self, detector: OnnxDetector, seen: list[tuple[tuple[DetectedBox, ...], ...]]) -> None:
        self.card = detector.card
        self._detector, self._seen = detector, seen

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        self._seen.append(self._detector.detect_batch(images_bgr))
        return self._seen[-1]


class _ReplayingDetector:
    """A detector that gives again, in the same order of batches, what reaches ``threshold``."""

    def __init__(self, card: ModelCard, threshold: float, seen: Iterator[tuple[tuple[DetectedBox, ...], ...]]) -> None:
        self.card = card
        self._threshold, self._seen = threshold, seen

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        return tuple(
            tuple(one for one in many if one.score >= self._threshold)[: self.card.max_detections]
            for many in next(self._seen)
        )


class CocoPredictionSource:
    """Detections of a COCO file, by the photographs' file names; a box without a score has 1."""

    def __init__(self, file: Path, threshold: float = 0.0) -> None:
        """Read ``file``. Raises InputDataError where it cannot be used."""
        coco = read_coco(file)
        self.name, self.sha256, self.threshold = file.name, hash_file(file), threshold
        self._found: dict[str, list[DetectedBox]] = {}
        self.unusable = 0
        for annotation in coco.annotations:
            image = coco.images.get(annotation.image_id)
            found = _parse_annotation(annotation, coco.categories.get(annotation.category_id))
            if image is None or found is None:
                self.unusable += 1
                continue
            self._found.setdefault(image.file_name.replace("\\", "/"), []).append(found)
        self._names = frozenset(image.file_name.replace("\\", "/") for image in coco.images.values())

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions:
        """The file's boxes of this photograph, by the longest end of its path that the file names."""
        parts = image.key.split("/")
        name = next((end for i in range(len(parts)) if (end := "/".join(parts[i:])) in self._names), None)
        found = tuple(self._found.get(name, ())) if name else ()
        return ImagePredictions(
            above_floor=found, above_threshold=tuple(one for one in found if one.score >= self.threshold)
        )

    def require_photographs(self, images: Sequence[LabelledImage]) -> None:
        """Raise InputDataError where the file names none of the photographs."""
        ends = {"/".join(image.key.split("/")[i:]) for image in images for i in range(image.key.count("/") + 1)}
        if not ends & self._names:
            raise InputDataError(
                f"{self.name} names none of the {len(images)} labelled photographs, such as '{images[0].key}'; "
                "its images' file_name must be theirs"
            )


def _parse_annotation(annotation: CocoAnnotation, class_name: str | None) -> DetectedBox | None:
    values = [parse_number(value) for value in annotation.bbox] if isinstance(annotation.bbox, list) else []
    numbers = [value for value in values if value is not None]
    score = 1.0 if annotation.score is None else parse_number(annotation.score)
    if class_name is None or len(numbers) != 4 or min(numbers[2:]) <= 0 or score is None or not 0 <= score <= 1:
        return None
    x, y, width, height = numbers
    return DetectedBox(box=Box(x_px=x, y_px=y, width_px=width, height_px=height), score=score, class_name=class_name)
