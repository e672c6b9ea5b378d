"""Sources of predictions: an ONNX model with its card, and a COCO file of detections."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from facadelake.core.arrays import UInt8Image
from facadelake.core.errors import InputDataError
from facadelake.core.hashing import hash_file
from facadelake.core.photo_names import PhotoNames
from facadelake.detection import ModelCard
from facadelake.detection.coco import CocoAnnotation, StoredImage, find_views, parse_number, parse_shape, read_coco
from facadelake.detection.inference import DetectedBox, OnnxDetector, find_card, read_exif_orientation
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
        self.left_out: Counter[str] = Counter()
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
        self._coco = read_coco(file)
        self.name, self.sha256, self.threshold = file.name, hash_file(file), threshold
        self.left_out: Counter[str] = Counter()
        self._annotations: dict[int | str, list[CocoAnnotation]] = defaultdict(list)
        for annotation in self._coco.annotations:
            if annotation.image_id in self._coco.images:
                self._annotations[annotation.image_id].append(annotation)
            else:
                self.left_out["predicted boxes of an image that is not in the file"] += 1
        self._ids: dict[str, list[int | str]] = defaultdict(list)
        for image_id, image in self._coco.images.items():
            self._ids[image.file_name].append(image_id)
        self._names = PhotoNames(self._ids)

    def detect(self, image: LabelledImage, pixels_bgr: UInt8Image) -> ImagePredictions:
        """The file's boxes of a photograph, found by its path among the file's names."""
        match = self._names.match(image.key)
        if match.candidates:
            self.left_out["photographs whose name matches several images of the predictions"] += 1
        found = tuple(
            one for image_id in self._ids.get(match.photo_id or "", ()) for one in self._read_boxes(image_id, image)
        )
        return ImagePredictions(
            above_floor=found, above_threshold=tuple(one for one in found if one.score >= self.threshold)
        )

    def _read_boxes(self, image_id: int | str, image: LabelledImage) -> Iterator[DetectedBox]:
        annotations = self._annotations.get(image_id, [])
        of_image = replace(self._coco, annotations=tuple(annotations))
        orientation = read_exif_orientation(image.path)
        stored = StoredImage(width_px=image.width_px, height_px=image.height_px, orientation=orientation)
        view = find_views(of_image, {image_id: stored}, None)[image_id]
        if isinstance(view, str):
            self.left_out["predicted boxes of another size or view than their photograph"] += len(annotations)
            return
        for annotation in annotations:
            class_name = self._coco.categories.get(annotation.category_id)
            shape = parse_shape(annotation, view)
            score = 1.0 if annotation.score is None else parse_number(annotation.score)
            if class_name is None:
                self.left_out["predicted boxes of a category that is not in the file"] += 1
            elif shape.problem or shape.box is None:
                self.left_out["predicted boxes without four numbers and an area, or with an unusable rotation"] += 1
            elif score is None or not 0 <= score <= 1:
                self.left_out["predicted boxes with a score that is not from 0 to 1"] += 1
            else:
                yield DetectedBox(box=shape.box, score=score, class_name=class_name)

    def require_photographs(self, images: Sequence[LabelledImage]) -> None:
        """Raise InputDataError where the file has none of the photographs."""
        if not any(self._names.match(image.key).photo_id for image in images):
            raise InputDataError(
                f"{self.name} has none of the {len(images)} labelled photographs, such as '{images[0].key}'; its "
                "images must have their file names (file_name)"
            )
