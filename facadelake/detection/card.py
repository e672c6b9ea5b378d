"""The model card: what a detector's ONNX file does not state and must not be guessed (docs/model-card.md).

After Mitchell et al. 2019, Model Cards for Model Reporting.
"""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from facadelake.core.arrays import Float32Array, Float64N
from facadelake.core.errors import ModelError
from facadelake.registry import RecallBySize
from schemas.vocabulary import DefectClass

PositiveInt = Annotated[int, Field(gt=0)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]
ChannelValues = tuple[float, float, float]


class OutputLayout(StrEnum):
    """How a detector's output tensors are read: ``nc`` classes, ``N`` candidates, ``Q`` queries (see layouts/)."""

    YOLOX = "yolox"  # (1, N, 5+nc): raw offsets in grid cells, log sizes, objectness, class scores
    YOLOV5 = "yolov5"  # (1, N, 5+nc): centre and size in pixels of the input, objectness, class scores
    YOLOV8 = "yolov8"  # (1, 4+nc, N): centre and size in pixels of the input, class scores
    NMS6 = "nms6"  # (1, N, 6): corners in pixels of the input, score, class; the model includes NMS
    YOLOV5_SEG = "yolov5_seg"  # yolov5 with k mask coefficients, and prototypes (1, k, h, w)
    YOLOV8_SEG = "yolov8_seg"  # yolov8 with k mask coefficients, and prototypes (1, k, h, w)
    NMS6_SEG = "nms6_seg"  # nms6 with k mask coefficients, and prototypes (1, k, h, w)
    RTDETR = "rtdetr"  # boxes (1, Q, 4): centre and size from 0 to 1; logits (1, Q, nc)
    RTDETR_TRIPLE = "rtdetr_triple"  # labels (1, Q), boxes (1, Q, 4): corners, scores (1, Q); a second input of sizes
    RTDETR_ROWS = "rtdetr_rows"  # (1, N, 6): centre and size from 0 to 1, score, class
    RFDETR = "rfdetr"  # dets (1, Q, 4): centre and size from 0 to 1; labels (1, Q, nc or nc+1): logits
    RFDETR_SEG = "rfdetr_seg"  # rfdetr with mask logits (1, Q, h, w)
    MAP = "map"  # (1, nc, h, w): probabilities of a semantic segmenter
    MAP_LOGITS = "map_logits"  # the same before the sigmoid, or before the softmax if a class is called background


class ResizeMode(StrEnum):
    """How a photograph is resized to the model's input."""

    CORNER = "letterbox_corner"  # one gain, padding at the right and bottom
    CENTRE = "letterbox_centre"  # one gain, equal padding on both sides
    STRETCH = "stretch"  # one gain per axis, no padding


class _CardSection(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CardInput(_CardSection):
    """The model's input: ``(value * scale - mean) / std`` of values 0..255, channels in the order ``colour``.

    ``gsd_mm``: GSD of the input that the model was trained for, in millimetres on the facade, one or two scales; empty:
    photographs are processed at their own GSD.
    """

    width_px: PositiveInt
    height_px: PositiveInt
    colour: Literal["rgb", "bgr"]
    scale: Annotated[float, Field(gt=0)]
    mean: ChannelValues = (0.0, 0.0, 0.0)
    std: ChannelValues = (1.0, 1.0, 1.0)
    resize: ResizeMode
    pad_value: Annotated[int, Field(ge=0, le=255)] = 114
    gsd_mm: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(max_length=2)] = ()

    @model_validator(mode="after")
    def _check_std(self) -> CardInput:
        if min(self.std) <= 0:
            raise ValueError(f"std is {self.std}; each of the three must be more than 0")
        return self


class CardOutput(_CardSection):
    """The model's outputs: ``names`` in the order of the layout, or ``name`` where the layout has a single output.

    Both may be omitted: a single output is then the model's first, several are identified by their usual names or their
    shapes. ``strides`` apply to layout yolox only.
    """

    layout: OutputLayout
    name: str | None = None
    names: tuple[str, ...] = ()
    strides: Annotated[tuple[PositiveInt, ...], Field(min_length=1)] = (8, 16, 32)

    @model_validator(mode="after")
    def _check_names(self) -> CardOutput:
        if self.name is not None and self.names:
            raise ValueError(f"name ({self.name}) and names ({', '.join(self.names)}) are both given; keep one of them")
        return self

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs that the card names; empty if it names none."""
        return self.names if self.name is None else (self.name,)


class ScoreCalibration(_CardSection):
    """Calibration of the model's scores: ``logit(probability) = slope * logit(score) + intercept`` (Platt 1999)."""

    slope: Annotated[float, Field(gt=0)] = 1.0
    intercept: float = 0.0


class ModelCard(_CardSection):
    """The declaration of a detector; ``class_names`` in the order of the model's outputs.

    ``classes``: class name -> defect class, overrides the built-in crosswalk. ``training_data``: one data set with its
    licence in each entry. ``metrics``: measured results, free in form. ``score_threshold`` applies to the calibrated
    score. ``recall_by_size``: how small a defect the model finds at that threshold, in pixels of the picture that it is
    given; None: unknown.
    """

    name: Annotated[str, Field(min_length=1)]
    licence: Annotated[str, Field(min_length=1)]
    source: str = ""
    training_data: tuple[str, ...] = ()
    metrics: dict[str, Any] = Field(default_factory=dict)
    class_names: Annotated[tuple[str, ...], Field(min_length=1)]
    classes: dict[str, DefectClass] = Field(default_factory=dict)
    input: CardInput
    output: CardOutput
    score_calibration: ScoreCalibration = ScoreCalibration()
    score_threshold: UnitInterval
    nms_iou: UnitInterval = 0.5
    max_detections: PositiveInt = 300
    recall_by_size: RecallBySize | None = None

    @model_validator(mode="after")
    def _check_strides(self) -> ModelCard:
        worst = max(self.output.strides)
        if self.output.layout is OutputLayout.YOLOX and (self.input.width_px % worst or self.input.height_px % worst):
            raise ValueError(
                f"input is {self.input.width_px} x {self.input.height_px} px; layout yolox needs multiples of its "
                f"largest stride, {worst}"
            )
        return self


def locate_card(model: Path) -> Path:
    """Path of a model's card: ``crack.card.yaml`` beside ``crack.onnx``."""
    return model.with_suffix(".card.yaml")


def read_card(path: Path) -> ModelCard:
    """Read and validate a card in YAML or JSON. Raises ModelError with file, key, value and the allowed values."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ModelError(
            f"model card {path} does not exist; every detector needs one beside it (docs/model-card.md shows one)"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"model card {path} cannot be read: {error}") from error
    return parse_card(text, f"model card {path}")


def parse_card(text: str, where: str) -> ModelCard:
    """Parse a card in YAML or JSON. Raises ModelError; its message begins with ``where``."""
    try:
        # YAML 1.1 reads JSON's 1e-3 as a text, so JSON has a parser of its own.
        content = json.loads(text) if text.lstrip().startswith("{") else yaml.safe_load(text)
    except (json.JSONDecodeError, yaml.YAMLError) as error:
        raise ModelError(f"{where} cannot be read as YAML or JSON: {error}") from error
    if not isinstance(content, dict):
        raise ModelError(f"{where} contains no keys; docs/model-card.md lists the required ones")
    try:
        return ModelCard.model_validate(content)
    except ValidationError as error:
        faults = []
        for fault in error.errors():
            key = ".".join(str(part) for part in fault["loc"]) or "card"
            value = "" if fault["type"] == "missing" or not fault["loc"] else f" is {fault['input']!r}"
            faults.append(f"{key}{value}: {fault['msg'].removeprefix('Value error, ')}")
        raise ModelError(f"{where}: {'; '.join(faults)} (docs/model-card.md lists the allowed values)") from error


def format_card(card: ModelCard) -> str:
    """The card as YAML, keys in the order of their declaration; default values are omitted."""
    content = card.model_dump(mode="json", exclude_defaults=True)
    text: str = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120)
    return text


_PROBABILITY_MARGIN = 1e-7  # from 0 and 1: the resolution of float32 scores


def calibrate_scores(scores: Float32Array, calibration: ScoreCalibration) -> Float64N:
    """Probabilities (n,) from a model's scores (n,), clipped to 0..1 (Platt 1999)."""
    exact = np.clip(scores.astype(np.float64), 0.0, 1.0)
    if calibration == ScoreCalibration():
        return exact
    return 1 / (1 + np.exp(-(calibration.slope * _logit(exact) + calibration.intercept)))


def invert_calibration(probability: float, calibration: ScoreCalibration) -> float:
    """The model's score whose calibrated value is ``probability``; 0 and 1 are unchanged."""
    if calibration == ScoreCalibration() or probability <= 0 or probability >= 1:
        return probability
    logit = float(_logit(np.array([probability]))[0])
    return float(1 / (1 + np.exp(-(logit - calibration.intercept) / calibration.slope)))


def _logit(probability: Float64N) -> Float64N:
    inside = np.clip(probability, _PROBABILITY_MARGIN, 1 - _PROBABILITY_MARGIN)
    logit: Float64N = np.log(inside) - np.log1p(-inside)
    return logit
