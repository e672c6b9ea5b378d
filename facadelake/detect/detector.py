"""A detector: an ONNX model and the card that says how to read it, run by onnxruntime on the CPU."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from facadelake.cache import file_hash, key_of
from facadelake.detect.boxes import Box
from facadelake.detect.card import Layout, ModelCard, card_path, read_card
from facadelake.detect.layouts import Candidates, candidates, verify_output
from facadelake.detect.letterbox import Image, letterbox
from facadelake.errors import InputDataError, ModelError
from facadelake.frames import Array

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Found:
    """A box in pixels of the photograph, which may stick out of it; ``score`` is calibrated.

    ``mask`` is the outline of what was found inside the box, in the same pixels, where the model gives masks.
    """

    box: Box
    score: float
    class_name: str
    mask: Polygon | MultiPolygon | None = None


class OnnxDetector:
    """A model whose output was found to be of the layout that its card declares."""

    def __init__(self, model: Path, card: ModelCard, *, threads: int = 0) -> None:
        """Load ``model`` and run it once on a probe image; ``threads`` 0 is one for each core.

        Raises ModelError where the file is no model, takes another input or gives another output than declared.
        """
        self.card = card
        self.name = card.name
        if not model.is_file():
            raise ModelError(f"model {model} does not exist; correct the detector's path in the registry")
        self.sha256 = file_hash(model)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's errors share no base class but this
            raise ModelError(f"model {model} cannot be loaded by onnxruntime: {error}") from error
        self._input = self._checked_input(model)
        self._output = self._checked_output(model)
        spec = card.input
        # Noise rather than a flat image: it reaches every part of the network.
        probe = np.random.default_rng(0).integers(0, 256, (spec.height_px, spec.width_px, 3), dtype=np.uint8)
        try:
            output = self._run(probe)
        except Exception as error:
            raise ModelError(
                f"model {model} does not run on an input of 1 x 3 x {spec.height_px} x {spec.width_px}, as the card "
                f"declares: {error}"
            ) from error
        verify_output(output, card, str(model))

    def detect(self, image_bgr: Image) -> tuple[Found, ...]:
        """Boxes in a photograph (h, w, 3: blue, green, red), best first, suppressed within each class."""
        height, width = image_bgr.shape[:2]
        found = _above(candidates(self._run(image_bgr), self.card), self.card)
        box = letterbox(self.card.input, image_width_px=width, image_height_px=height)
        corners = box.image_from_input(found.corners_input)
        usable = np.isfinite(corners).all(axis=1) & (corners[:, 2:] > corners[:, :2]).all(axis=1)
        if not usable.all():
            _log.warning("%s: %d boxes of no size were dropped", self.name, int((~usable).sum()))
        corners, scores, classes = corners[usable], found.scores[usable], found.classes[usable]
        kept = self._suppressed(corners, scores, classes)
        return tuple(
            Found(
                box=Box(
                    x_px=float(corners[i, 0]),
                    y_px=float(corners[i, 1]),
                    width_px=float(corners[i, 2] - corners[i, 0]),
                    height_px=float(corners[i, 3] - corners[i, 1]),
                ),
                score=min(1.0, float(scores[i])),
                class_name=self._class_name(int(classes[i])),
            )
            for i in kept
        )

    def detect_batch(self, images_bgr: Sequence[Image]) -> tuple[tuple[Found, ...], ...]:
        """What ``detect`` gives for each of the photographs, in one run of the model where its batch size is free."""
        return tuple(self.detect(image) for image in images_bgr)

    def _run(self, image_bgr: Image) -> Array:
        height, width = image_bgr.shape[:2]
        box = letterbox(self.card.input, image_width_px=width, image_height_px=height)
        values = box.input_from_image(image_bgr).astype(self._dtype)
        (output,) = self._session.run([self._output], {self._input: values})
        return np.asarray(output, dtype=np.float64)

    def _suppressed(self, corners: Array, scores: Array, classes: NDArray[np.int64]) -> list[int]:
        """Indices to keep, best first; the list of layout nms6 was suppressed by the model."""
        kept = np.arange(len(scores))
        if self.card.output.layout is not Layout.NMS6 and len(scores):
            boxes = np.column_stack([corners[:, :2], corners[:, 2:] - corners[:, :2]])
            kept = np.asarray(
                cv2.dnn.NMSBoxesBatched(
                    boxes.tolist(), scores.tolist(), classes.tolist(), self.card.score_threshold, self.card.nms_iou
                ),
                dtype=np.int64,
            ).ravel()
        order = kept[np.argsort(-scores[kept], kind="stable")]
        return [int(i) for i in order[: self.card.max_detections]]

    def _class_name(self, index: int) -> str:
        if not 0 <= index < len(self.card.class_names):
            raise ModelError(
                f"model {self.name} gives class {index}, its card names {len(self.card.class_names)} classes "
                f"(0 to {len(self.card.class_names) - 1}); complete class_names in the card"
            )
        return self.card.class_names[index]

    def _checked_input(self, model: Path) -> str:
        inputs = self._session.get_inputs()
        types = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
        if len(inputs) != 1 or inputs[0].type not in types:
            raise ModelError(
                f"model {model} takes {[(i.name, i.type) for i in inputs]}; one input of float or float16 is supported"
            )
        self._dtype = types[inputs[0].type]
        declared = (1, 3, self.card.input.height_px, self.card.input.width_px)
        actual = inputs[0].shape  # text where a size is free
        fixed = [isinstance(size, int) and size > 0 for size in actual]
        if len(actual) != 4 or any(f and a != d for f, a, d in zip(fixed, actual, declared, strict=True)):
            raise ModelError(
                f"model {model} takes an input of shape {actual}, its card declares {list(declared)} (1, 3, height_px, "
                "width_px); correct the card's input"
            )
        return str(inputs[0].name)

    def _checked_output(self, model: Path) -> str:
        names = [str(output.name) for output in self._session.get_outputs()]
        wanted = self.card.output.name
        if wanted is not None and wanted not in names:
            raise ModelError(
                f"model {model} has no output '{wanted}' (it has {names}); correct output.name in the card"
            )
        return wanted or names[0]


def load_detector(model: Path, card: Path | None = None, *, threads: int = 0) -> OnnxDetector:
    """The detector of ``model`` and its card: the one beside it, unless ``card`` says another."""
    return OnnxDetector(model, read_card(card or card_path(model)), threads=threads)


def detector_fingerprint(file: Path, class_names: Mapping[str, str], card: Path | None = None) -> str:
    """A key of what a detector would find: a COCO file, or a model with its card, and the building's class names.

    Raises InputDataError where the file is not there, ModelError where a model has no card.
    """
    if not file.is_file():
        raise InputDataError(f"detector {file} does not exist; correct the detector's path in the registry")
    parts: dict[str, object] = {"class_names": dict(class_names), "name": file.name, "file": file_hash(file)}
    if file.suffix.lower() == ".onnx":
        parts["card"] = read_card(card or card_path(file)).model_dump(mode="json")
    return key_of(parts)


def _above(found: Candidates, card: ModelCard) -> Candidates:
    """The candidates that reach the card's score threshold."""
    enough = found.scores >= card.score_threshold
    return Candidates(
        corners_input=found.corners_input[enough], scores=found.scores[enough], classes=found.classes[enough]
    )
