"""Detector outputs in their declared layout, read into candidates; an output that is not of it is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.detect.card import Layout, ModelCard
from facadelake.errors import ModelError
from facadelake.frames import Array

_REMEDY = "correct output.layout or class_names in the card, or export the model again"


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidates:
    """Boxes before suppression: ``corners_input`` (n, 4: left, top, right, bottom) in pixels of the model's input."""

    corners_input: Array
    scores: Array
    classes: NDArray[np.int64]


def expected_shape(card: ModelCard, layout: Layout) -> tuple[int | None, ...]:
    """The output's shape; None where any size will do."""
    classes = len(card.class_names)
    match layout:
        case Layout.YOLOX:
            return (1, len(_grid(card)[0]), 5 + classes)
        case Layout.YOLOV5:
            return (1, None, 5 + classes)
        case Layout.YOLOV8:
            return (1, 4 + classes, None)
        case Layout.NMS6:
            return (1, None, 6)


def candidates(output: Array, card: ModelCard) -> Candidates:
    """All boxes of an output, whatever their score; sizes and scores as the model gave them."""
    layout = card.output.layout
    _check_shape(output, card)
    if layout is Layout.NMS6:
        return Candidates(
            corners_input=output[0, :, :4], scores=output[0, :, 4], classes=output[0, :, 5].astype(np.int64)
        )
    table = output[0].T if layout is Layout.YOLOV8 else output[0]
    centres, sizes = table[:, :2], table[:, 2:4]
    if layout is Layout.YOLOX:
        # Raw outputs: YOLOX, Ge et al. 2021, and its decode_outputs.
        cells, strides = _grid(card)
        with np.errstate(over="ignore"):
            centres, sizes = (centres + cells) * strides, np.exp(sizes) * strides
    by_class = table[:, 4:] if layout is Layout.YOLOV8 else table[:, 4:5] * table[:, 5:]
    best = by_class.argmax(axis=1) if len(by_class) else np.zeros(0, dtype=np.int64)
    return Candidates(
        corners_input=np.column_stack([centres - sizes / 2, centres + sizes / 2]),
        scores=by_class[np.arange(len(best)), best],
        classes=best.astype(np.int64),
    )


def verify_output(output: Array, card: ModelCard, model: str) -> None:
    """Raise ModelError where the output of a probe image is not of the declared layout, in shape or in values."""
    layout = card.output.layout
    try:
        found = candidates(output, card)
    except ModelError as error:
        raise ModelError(f"model {model}: {error}") from error
    if not len(found.scores):
        return
    low, high = float(found.scores.min()), float(found.scores.max())
    lowest = -1.0 if layout is Layout.NMS6 else -1e-3  # models after suppression pad their list with scores of -1
    if not (low >= lowest and high <= 1 + 1e-3):
        raise ModelError(
            f"model {model}: scores of a probe image run from {low:.3g} to {high:.3g}, not from 0 to 1; it gives "
            f"logits, or has not layout {layout}; export it with its sigmoid, or {_REMEDY}"
        )
    if layout is Layout.NMS6:
        return
    middles = (found.corners_input[:, :2] + found.corners_input[:, 2:]) / 2
    size = np.array([card.input.width_px, card.input.height_px], dtype=np.float64)
    # Every cell of the input has its candidate, so the boxes' middles must spread over the input and not beyond.
    reach = np.percentile(np.abs(middles), 95, axis=0) / size
    if not (np.isfinite(reach).all() and reach.min() >= 0.25 and reach.max() <= 2.0):
        other = Layout.YOLOV5 if layout is Layout.YOLOX else Layout.YOLOX
        hint = f"is it layout {other}" if layout is not Layout.YOLOV8 else "are they not pixels of the input"
        raise ModelError(
            f"model {model}: box centres of a probe image, read as layout {layout}, reach {reach.max():.3g} times the "
            f"input's size (0.25 to 2 expected); {hint}, or normalised to 0..1? {_REMEDY}"
        )


def _check_shape(output: Array, card: ModelCard) -> None:
    layout = card.output.layout
    if _fits(output.shape, expected_shape(card, layout)):
        return
    fitting = [str(other) for other in Layout if _fits(output.shape, expected_shape(card, other))]
    raise ModelError(
        f"its output has shape {output.shape}, layout {layout} with {len(card.class_names)} classes at "
        f"{card.input.width_px} x {card.input.height_px} px has {_shape_text(expected_shape(card, layout))}; "
        + (f"the shape fits layout {' or '.join(fitting)}; " if fitting else "")
        + _REMEDY
    )


def _fits(shape: tuple[int, ...], expected: tuple[int | None, ...]) -> bool:
    return len(shape) == len(expected) and all(b is None or a == b for a, b in zip(shape, expected, strict=True))


def _shape_text(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("N" if size is None else str(size) for size in shape) + ")"


def _grid(card: ModelCard) -> tuple[Array, Array]:
    """Cell indices (N, 2: x, y) and strides (N, 1) of every YOLOX candidate, row by row, finest grid first."""
    cells, strides = [], []
    for stride in card.output.strides:
        columns, rows = card.input.width_px // stride, card.input.height_px // stride
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        cells.append(np.column_stack([x.ravel(), y.ravel()]))
        strides.append(np.full((rows * columns, 1), stride))
    return np.concatenate(cells).astype(np.float64), np.concatenate(strides).astype(np.float64)
