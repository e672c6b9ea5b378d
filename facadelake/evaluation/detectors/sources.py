"""Sources of predictions: an ONNX model with its card, and a COCO file of detections."""

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

# Lowest score of predictions: precision at high recall needs boxes below the threshold.
SCORE_FLOOR = 0.01
_DETECTIONS_MAX = 300


class OnnxPredictionSource:
    """An ONNX model at the threshold of its card and at ``SCORE_FLOOR``.

    Inference runs once for each tile. Non-maximum suppression keeps boxes from the highest score down, so that a tile's
    boxes at the threshold are the first of those at the lower one. Boxes of several tiles are merged once for each
    threshold, because boxes of low scores would change the merged boxes.
    """

    def __init__(self, model: Path, *, threshold: float | None = None) -> None:
        """Load ``model`` with its card; ``threshold`` overrides the card's."""
        self.card = find_card(model)
        self.threshold = self.card.score_threshold if threshold is None else threshold
        low = {
            "score_threshold": min(SCORE_FLOOR, self.threshold),
            "max_detections": max(_DETECTIONS_MAX, self.card.max_detections),
        }
        self._detector = OnnxDetector(model, self.card.model_copy(update=low))
        self.name, self.sha256 = self._detector.name, self._detector.sha256

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions:
        """The detections of a photograph at both thresholds."""
        batches: list[tuple[tuple[DetectedBox, ...], ...]] = []
        low = detect_image(
            _RecordingDetector(self._detector, batches), pixels_bgr, gsd_mm=image.gsd_mm, target=image.target
        )
        replayed = _ReplayingDetector(self.card, self.threshold, iter(batches))
        return ImagePredictions(
            above_floor=low,
            above_threshold=detect_image(replayed, pixels_bgr, gsd_mm=image.gsd_mm, target=image.target),
        )


class _RecordingDetector:
    """A detector that records its results, batch by batch."""

    def __init__(self, detector: OnnxDetector, batches: list[tuple[tuple[DetectedBox, ...], ...]]) -> None:
        self.card = detector.card
        self._detector, self._batches = detector, batches

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        self._batches.append(self._detector.detect_batch(images_bgr))
        return self._batches[-1]


class _ReplayingDetector:
    """A detector that repeats recorded results from ``threshold`` up, in the same order of batches."""

    def __init__(
        self, card: ModelCard, threshold: float, batches: Iterator[tuple[tuple[DetectedBox, ...], ...]]
    ) -> None:
        self.card = card
        self._threshold, self._batches = threshold, batches

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        return tuple(
            tuple(one for one in many if one.score >= self._threshold)[: self.card.max_detections]
            for many in next(self._batches)
        )


class CocoPredictionSource:
    """Detections of a COCO file, by the photographs' file names; a box without a score has the score 1."""

    def __init__(self, file: Path, threshold: float = 0.0) -> None:
        """Read ``file``. Raises InputDataError where it is not a COCO file."""
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
        """The file's boxes of a photograph, found by the longest end of its path among the file's names."""
        parts = image.key.split("/")
        name = next((suffix for i in range(len(parts)) if (suffix := "/".join(parts[i:])) in self._names), None)
        found = tuple(self._found.get(name, ())) if name else ()
        return ImagePredictions(
            above_floor=found, above_threshold=tuple(one for one in found if one.score >= self.threshold)
        )

    def require_photographs(self, images: Sequence[LabelledImage]) -> None:
        """Raise InputDataError where the file has none of the photographs."""
        suffixes = {"/".join(image.key.split("/")[i:]) for image in images for i in range(image.key.count("/") + 1)}
        if not suffixes & self._names:
            raise InputDataError(
                f"{self.name} has none of the {len(images)} labelled photographs, such as '{images[0].key}'; its "
                "images must have their file names (file_name)"
            )


def _parse_annotation(annotation: CocoAnnotation, class_name: str | None) -> DetectedBox | None:
    values = [parse_number(value) for value in annotation.bbox] if isinstance(annotation.bbox, list) else []
    numbers = [value for value in values if value is not None]
    score = 1.0 if annotation.score is None else parse_number(annotation.score)
    if class_name is None or len(numbers) != 4 or min(numbers[2:]) <= 0 or score is None or not 0 <= score <= 1:
        return None
    x, y, width, height = numbers
    return DetectedBox(box=Box(x_px=x, y_px=y, width_px=width, height_px=height), score=score, class_name=class_name)
