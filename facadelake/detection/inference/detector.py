"""A detector: an ONNX model and the card that says how to read it, run by onnxruntime on the CPU."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from shapely import MultiPolygon, Polygon

from facadelake.core.arrays import Float32Array, Int64Array, UInt8Image
from facadelake.core.errors import InputDataError, ModelError
from facadelake.core.hashing import compute_key, hash_file
from facadelake.detection.boxes import Box
from facadelake.detection.card import ModelCard, calibrate_scores, invert_calibration
from facadelake.detection.inference.card_lookup import find_card
from facadelake.detection.inference.letterbox import Letterbox, fit_letterbox
from facadelake.detection.inference.mask_outline import trace_mask
from facadelake.detection.inference.session import ModelSession
from facadelake.detection.layouts.output_reader import DetectionCandidates
from facadelake.detection.layouts.output_verification import verify_outputs
from facadelake.detection.layouts.readers import READERS

_log = logging.getLogger(__name__)

# What of a card says nothing on what is found.
_DESCRIPTIVE_KEYS = {"licence", "source", "training_data", "metrics"}


@dataclass(frozen=True, kw_only=True)
class DetectedBox:
    """A box in pixels of the photograph, which may stick out of it; ``score`` is calibrated.

    ``mask`` is the outline of what was found inside the box, in the same pixels, where the model gives masks and
    something of this one lies in box and photograph.
    """

    box: Box
    score: float
    class_name: str
    mask: Polygon | MultiPolygon | None = None


class OnnxDetector:
    """A model whose outputs were found to be of the layout that its card declares."""

    def __init__(self, model: Path, card: ModelCard, *, threads: int = 0) -> None:
        """Load ``model`` and run it on a probe image; ``threads`` 0 is one for each core.

        Raises ModelError where the file is no model, takes another input or gives other outputs than declared.
        """
        self.card = card
        self.name = card.name
        self._session = ModelSession(model, threads=threads)
        self.sha256 = hash_file(model)
        self._session.check_input(card.input)
        self._reader = READERS[card.output.layout]
        self._threshold = invert_calibration(card.score_threshold, card.score_calibration)
        # Noise rather than a flat image: it reaches every part of the network.
        spec = card.input
        noise = np.random.default_rng(0).integers(0, 256, (2, spec.height_px, spec.width_px, 3), dtype=np.uint8)
        probes = np.concatenate([self._letterbox(image).input_from_image(image) for image in noise])
        names = self._session.output_names
        try:
            outputs = self._session.run(probes[:1], names)
        except Exception as error:
            raise ModelError(
                f"model {model} does not run on an input of 1 x 3 x {spec.height_px} x {spec.width_px}, as the card "
                f"declares: {error}"
            ) from error
        self._outputs = verify_outputs(dict(zip(names, outputs, strict=True)), card, str(model))
        self.supports_batches = self._takes_batches(probes)

    def detect(self, image_bgr: UInt8Image) -> tuple[DetectedBox, ...]:
        """What is found in a photograph (h, w, 3: blue, green, red), best first, suppressed within each class."""
        box = self._letterbox(image_bgr)
        outputs = self._session.run(box.input_from_image(image_bgr), self._outputs)
        return self._found([output[0] for output in outputs], box)

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        """What ``detect`` gives for each of the photographs, in one run of the model where its batch size is free."""
        if not self.supports_batches or len(images_bgr) < 2:
            return tuple(self.detect(image) for image in images_bgr)
        spec = self.card.input
        values = np.empty((len(images_bgr), 3, spec.height_px, spec.width_px), dtype=np.float32)
        boxes = [self._letterbox(image) for image in images_bgr]
        for image, box, planes in zip(images_bgr, boxes, values, strict=True):
            box.write_input(image, planes)
        outputs = self._session.run(values, self._outputs)
        return tuple(self._found([output[i] for output in outputs], box) for i, box in enumerate(boxes))

    def _letterbox(self, image_bgr: UInt8Image) -> Letterbox:
        height, width = image_bgr.shape[:2]
        return fit_letterbox(self.card.input, image_width_px=width, image_height_px=height)

    def _found(self, outputs: Sequence[Float32Array], box: Letterbox) -> tuple[DetectedBox, ...]:
        """What the outputs for one image say, in pixels of the photograph."""
        if any(np.isnan(output.min(initial=0)) for output in outputs):
            _log.warning(
                "%s: outputs for an image of %d x %d px hold values that are no numbers (NaN); what they stand for is "
                "not found", self.name, box.image_width_px, box.image_height_px,
            )  # fmt: skip
        candidates = self._reader.read_candidates(outputs, self.card, self._threshold)
        if not len(candidates.scores):
            return ()
        corners_input = candidates.corners_input
        usable = np.isfinite(corners_input).all(axis=1) & (corners_input[:, 2:] > corners_input[:, :2]).all(axis=1)
        if not usable.all():
            _log.warning("%s: %d boxes of no size were dropped", self.name, int((~usable).sum()))
        kept = self._kept(candidates, np.flatnonzero(usable))
        corners = box.image_from_input(corners_input[kept])
        scores = calibrate_scores(candidates.scores[kept], self.card.score_calibration)
        return tuple(
            DetectedBox(
                box=Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top),
                score=score,
                class_name=self._class_name(int(candidates.classes[i])),
                mask=None if candidates.masks is None else trace_mask(candidates.masks, i, corners_input[i], box),
            )
            for i, (left, top, right, bottom), score in zip(
                kept.tolist(), corners.tolist(), scores.tolist(), strict=True
            )
        )

    def _kept(self, found: DetectionCandidates, usable: Int64Array) -> Int64Array:
        """Which of the ``usable`` candidates stay, best first: suppressed within each class, and not too many."""
        scores = found.scores[usable]
        kept = np.arange(len(usable))
        if self._reader.needs_suppression and len(usable):
            corners = found.corners_input[usable]
            # From the origin: OpenCV tells classes apart by moving their boxes, which fails left of it.
            corners = corners - np.tile(corners[:, :2].min(axis=0), 2)
            boxes = np.concatenate([corners[:, :2], corners[:, 2:] - corners[:, :2]], axis=1)
            kept = np.asarray(
                cv2.dnn.NMSBoxesBatched(
                    boxes.tolist(), scores.tolist(), found.classes[usable].tolist(), 0.0, self.card.nms_iou
                ),
                dtype=np.int64,
            ).ravel()
        order = kept[np.argsort(-scores[kept], kind="stable")]
        return usable[order[: self.card.max_detections]]

    def _class_name(self, index: int) -> str:
        if not 0 <= index < len(self.card.class_names):
            raise ModelError(
                f"model {self.name} gives class {index}, its card names {len(self.card.class_names)} classes "
                f"(0 to {len(self.card.class_names) - 1}); complete class_names in the card"
            )
        return self.card.class_names[index]

    def _takes_batches(self, probes: Float32Array) -> bool:
        """Whether two images at once give what each gives alone: a free size of the batch does not promise it."""
        if self._session.input_shape[0] is not None:
            return False
        try:
            together = self._session.run(probes, self._outputs)
        except Exception as error:
            _log.info("%s runs one image at a time: a batch of two fails (%s)", self.name, error)
            return False
        second = self._session.run(probes[1:], self._outputs)
        same = all(
            both.shape == (2, *alone.shape[1:]) and np.allclose(both[1], alone[0], rtol=1e-2, atol=1e-2)
            for both, alone in zip(together, second, strict=True)
        )
        if not same:
            _log.info("%s runs one image at a time: in a batch of two the second gives something else", self.name)
        return same


def load_detector(
    model: Path, card: Path | None = None, *, threads: int = 0, score_threshold: float | None = None
) -> OnnxDetector:
    """The detector of ``model`` and its card: ``card``, or the one beside the model, or the one in its metadata.

    ``score_threshold`` stands in for the card's.
    """
    said = find_card(model, card)
    if score_threshold is not None:
        said = said.model_copy(update={"score_threshold": score_threshold})
    return OnnxDetector(model, said, threads=threads)


def hash_detector(file: Path, class_names: Mapping[str, str], card: Path | None = None) -> str:
    """A key of what a detector would find: a COCO file, or a model with its card, and the building's class names.

    Raises InputDataError where the file is not there, ModelError where a model has no card.
    """
    if not file.is_file():
        raise InputDataError(f"detector {file} does not exist; correct the detector's path in the registry")
    parts: dict[str, object] = {"class_names": dict(class_names), "name": file.name, "file": hash_file(file)}
    if file.suffix.lower() == ".onnx":
        parts["card"] = find_card(file, card).model_dump(mode="json", exclude=_DESCRIPTIVE_KEYS)
    return compute_key(parts)
