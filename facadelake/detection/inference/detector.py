"""A detector: an ONNX model and its card, run by onnxruntime on the CPU."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from shapely import MultiPolygon, Polygon

from facadelake.core.arrays import Float32Array, RowIndices, UInt8Image
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

# Keys of a card that do not influence its detections.
_DESCRIPTIVE_KEYS = {"licence", "source", "training_data", "metrics", "recall_by_size"}


@dataclass(frozen=True, kw_only=True)
class DetectedBox:
    """A detected box in pixels of the photograph; it may extend beyond it. ``score`` is calibrated.

    ``mask``: outline of the mask inside box and photograph, in the same pixels; None where the model has no masks or
    the mask is empty there.
    """

    box: Box
    score: float
    class_name: str
    mask: Polygon | MultiPolygon | None = None


class OnnxDetector:
    """A model whose outputs match the layout that its card declares."""

    def __init__(self, model: Path, card: ModelCard, *, threads: int = 0) -> None:
        """Load ``model`` and run it on a probe image; ``threads`` 0: one per core.

        Raises ModelError if the file is not a model, or its input or outputs are not as declared.
        """
        self.card = card
        self.name = card.name
        self._session = ModelSession(model, threads=threads)
        self.sha256 = hash_file(model)
        self._session.refuse_other_tasks()
        self._session.check_input(card.input)
        self._reader = READERS[card.output.layout]
        self._threshold = invert_calibration(card.score_threshold, card.score_calibration)
        # Noise instead of a flat image: it activates every part of the network.
        spec = card.input
        noise = np.random.default_rng(0).integers(0, 256, (2, spec.height_px, spec.width_px, 3), dtype=np.uint8)
        probes = np.concatenate([self._fit_letterbox(image).input_from_image(image) for image in noise])
        names = self._session.output_names
        try:
            outputs = self._session.run(probes[:1], names)
        except Exception as error:
            raise ModelError(
                f"model {model} does not run on an input of 1 x 3 x {spec.height_px} x {spec.width_px}, as the card "
                f"declares: {error}"
            ) from error
        self._outputs = verify_outputs(dict(zip(names, outputs, strict=True)), card, str(model))
        self.supports_batches = self._check_batching(probes)

    def detect(self, image_bgr: UInt8Image) -> tuple[DetectedBox, ...]:
        """Boxes in an image (h, w, 3: blue, green, red) after suppression within each class, highest score first."""
        letterbox = self._fit_letterbox(image_bgr)
        outputs = self._session.run(letterbox.input_from_image(image_bgr), self._outputs)
        return self._decode_outputs([output[0] for output in outputs], letterbox)

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        """As ``detect`` for each image, in one run of the model where its batch size is free."""
        if not self.supports_batches or len(images_bgr) < 2:
            return tuple(self.detect(image) for image in images_bgr)
        spec = self.card.input
        values = np.empty((len(images_bgr), 3, spec.height_px, spec.width_px), dtype=np.float32)
        letterboxes = [self._fit_letterbox(image) for image in images_bgr]
        for image, letterbox, planes in zip(images_bgr, letterboxes, values, strict=True):
            letterbox.write_input(image, planes)
        outputs = self._session.run(values, self._outputs)
        return tuple(
            self._decode_outputs([output[i] for output in outputs], letterbox)
            for i, letterbox in enumerate(letterboxes)
        )

    def _fit_letterbox(self, image_bgr: UInt8Image) -> Letterbox:
        height, width = image_bgr.shape[:2]
        return fit_letterbox(self.card.input, image_width_px=width, image_height_px=height)

    def _decode_outputs(self, outputs: Sequence[Float32Array], letterbox: Letterbox) -> tuple[DetectedBox, ...]:
        """The boxes of one image from its outputs, in pixels of the image."""
        if any(np.isnan(output.min(initial=0)) for output in outputs):
            _log.warning(
                "%s: outputs for an image of %d x %d px contain values that are not numbers (NaN); their boxes are "
                "dropped", self.name, letterbox.image_width_px, letterbox.image_height_px,
            )  # fmt: skip
        candidates = self._reader.read_candidates(outputs, self.card, self._threshold)
        if not len(candidates.scores):
            return ()
        corners_input = candidates.corners_input
        usable = np.isfinite(corners_input).all(axis=1) & (corners_input[:, 2:] > corners_input[:, :2]).all(axis=1)
        if not usable.all():
            _log.warning("%s: %d boxes without size were dropped", self.name, int((~usable).sum()))
        kept = self._suppress(candidates, np.flatnonzero(usable))
        corners = letterbox.image_from_input(corners_input[kept])
        scores = calibrate_scores(candidates.scores[kept], self.card.score_calibration)
        return tuple(
            DetectedBox(
                box=Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top),
                score=score,
                class_name=self._get_class_name(int(candidates.classes[i])),
                mask=None if candidates.masks is None else trace_mask(candidates.masks, i, corners_input[i], letterbox),
            )
            for i, (left, top, right, bottom), score in zip(
                kept.tolist(), corners.tolist(), scores.tolist(), strict=True
            )
        )

    def _suppress(self, candidates: DetectionCandidates, usable: RowIndices) -> RowIndices:
        """Rows of the ``usable`` candidates after non-maximum suppression, highest score first, at most the limit."""
        scores = candidates.scores[usable]
        kept = np.arange(len(usable))
        if self._reader.needs_suppression and len(usable):
            corners = candidates.corners_input[usable]
            # Shifted to the origin: OpenCV separates classes by offsets, which fails for negative coordinates.
            corners = corners - np.tile(corners[:, :2].min(axis=0), 2)
            boxes = np.concatenate([corners[:, :2], corners[:, 2:] - corners[:, :2]], axis=1)
            kept = np.asarray(
                cv2.dnn.NMSBoxesBatched(
                    boxes.tolist(), scores.tolist(), candidates.classes[usable].tolist(), 0.0, self.card.nms_iou
                ),
                dtype=np.int64,
            ).ravel()
        order = kept[np.argsort(-scores[kept], kind="stable")]
        return usable[order[: self.card.max_detections]]

    def _get_class_name(self, index: int) -> str:
        if not 0 <= index < len(self.card.class_names):
            raise ModelError(
                f"model {self.name} returned class {index}, its card names {len(self.card.class_names)} classes "
                f"(0 to {len(self.card.class_names) - 1}); complete class_names in the card"
            )
        return self.card.class_names[index]

    def _check_batching(self, probes: Float32Array) -> bool:
        """Whether a batch of two gives the same outputs as single images: a free batch size does not guarantee it."""
        if self._session.input_shape[0] is not None:
            return False
        try:
            batch = self._session.run(probes, self._outputs)
        except Exception as error:
            _log.info("%s runs one image at a time: a batch of two fails (%s)", self.name, error)
            return False
        single = self._session.run(probes[1:], self._outputs)
        equal = all(
            two.shape == (2, *one.shape[1:]) and np.allclose(two[1], one[0], rtol=1e-2, atol=1e-2)
            for two, one in zip(batch, single, strict=True)
        )
        if not equal:
            _log.info("%s runs one image at a time: outputs of the second image differ in a batch of two", self.name)
        return equal


def load_detector(
    model: Path, card: Path | None = None, *, threads: int = 0, score_threshold: float | None = None
) -> OnnxDetector:
    """Load a detector.

    Args:
        model: The ONNX file.
        card: File of its card; None: the card beside the model, else the one in its metadata.
        threads: Threads of onnxruntime; 0: one per core.
        score_threshold: Overrides the card's threshold, from 0 to 1.

    Returns:
        The detector, checked with a probe image.

    Raises:
        ModelError: Model or card is missing, or the model is not as its card declares.
    """
    model_card = find_card(model, card)
    if score_threshold is not None:
        model_card = model_card.model_copy(update={"score_threshold": score_threshold})
    return OnnxDetector(model, model_card, threads=threads)


def hash_detector(file: Path, class_names: Mapping[str, str], card: Path | None = None) -> str:
    """A key of all that determines the detections: a COCO file, or a model with its card, and the class names.

    Raises InputDataError if the file does not exist, ModelError if a model has no card.
    """
    if not file.is_file():
        raise InputDataError(f"detector {file} does not exist; correct the detector's path in the portfolio")
    parts: dict[str, object] = {"class_names": dict(class_names), "name": file.name, "file": hash_file(file)}
    if file.suffix.lower() == ".onnx":
        parts["card"] = find_card(file, card).model_dump(mode="json", exclude=_DESCRIPTIVE_KEYS)
    return compute_key(parts)
