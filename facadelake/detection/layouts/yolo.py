"""The YOLO families (YOLOX, YOLOv5, v8 and 11): one candidate per cell of the input; masks from prototypes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from facadelake.core.arrays import Float32Array, Int64Array
from facadelake.detection.card import ModelCard
from facadelake.detection.layouts.masks import PrototypeMasks
from facadelake.detection.layouts.output_reader import (
    DetectionCandidates,
    OutputReader,
    OutputTensor,
    SymbolicDimension,
    check_box_centres,
    check_scores,
    check_sizes_beside_centres,
)

_N = SymbolicDimension(name="N")
# Every cell of the input has a candidate, so the box centres must be spread over the input.
_REACH_MIN = 0.25


class YoloxReader(OutputReader):
    """(1, N, 5+nc): raw offsets in grid cells, log sizes, objectness, class scores (YOLOX, Ge et al. 2021)."""

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """A single output; its candidates are the cells of all strides."""
        count = len(_list_cells(card.input.width_px, card.input.height_px, card.output.strides))
        return ((OutputTensor(name="candidates", shape=(1, count, 5 + len(card.class_names))),),)

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Cells whose objectness times best class score is at least the threshold."""
        table = outputs[0]
        rows, scores, classes = _score_candidates(table, threshold)
        cells = _list_cells(card.input.width_px, card.input.height_px, card.output.strides)[rows]
        strides = cells[:, 2:]
        with np.errstate(over="ignore"):
            centres, sizes = (table[rows, :2] + cells[:, :2]) * strides, np.exp(table[rows, 2:4]) * strides
        return DetectionCandidates(
            corners_input=corners_from_centres(centres, sizes), scores=scores, classes=classes, rows=rows
        )

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Scores outside 0..1, or boxes that are not spread over the input."""
        return check_scores(candidates) or check_box_centres(
            candidates, card, reach_min=_REACH_MIN, units="offsets in grid cells (decoded boxes are layout yolov5)"
        )


class Yolov5Reader(OutputReader):
    """(1, N, 5+nc): centre and size in pixels of the input, objectness, class scores."""

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """A single output."""
        return ((OutputTensor(name="candidates", shape=(1, _N, 5 + len(card.class_names))),),)

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Candidates whose objectness times best class score is at least the threshold."""
        table = outputs[0]
        rows, scores, classes = _score_candidates(table, threshold)
        corners = corners_from_centres(table[rows, :2], table[rows, 2:4])
        return DetectionCandidates(corners_input=corners, scores=scores, classes=classes, rows=rows)

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Scores outside 0..1, corners, or boxes that are not spread over the input."""
        return (
            check_scores(candidates)
            or check_sizes_beside_centres(candidates)
            or check_box_centres(
                candidates,
                card,
                reach_min=_REACH_MIN,
                units="pixels of the input (normalised to 0..1, or offsets in grid cells?)",
            )
        )


class Yolov8Reader(OutputReader):
    """(1, 4+nc, N): centre and size in pixels of the input, class scores."""

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """A single output."""
        return ((OutputTensor(name="candidates", shape=(1, 4 + len(card.class_names), _N)),),)

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Candidates whose best class score is at least the threshold."""
        table = outputs[0]
        by_class = table[4:]
        rows = np.flatnonzero(by_class.max(axis=0) >= threshold)
        by_class = by_class[:, rows]
        classes = by_class.argmax(axis=0)
        return DetectionCandidates(
            corners_input=corners_from_centres(table[:2, rows].T, table[2:4, rows].T),
            scores=by_class[classes, np.arange(len(rows))],
            classes=classes,
            rows=rows,
        )

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Scores outside 0..1, corners, or boxes that are not spread over the input."""
        return (
            check_scores(candidates)
            or check_sizes_beside_centres(candidates)
            or check_box_centres(
                candidates, card, reach_min=_REACH_MIN, units="pixels of the input (normalised to 0..1?)"
            )
        )


def corners_from_centres(centres: Float32Array, sizes: Float32Array) -> Float32Array:
    """Corners (n, 4: left, top, right, bottom) from centres (n, 2) and sizes (n, 2)."""
    corners: Float32Array = np.concatenate([centres - sizes / 2, centres + sizes / 2], axis=1)
    return corners


def _score_candidates(table: Float32Array, threshold: float) -> tuple[Int64Array, Float32Array, Int64Array]:
    """Rows with at least the threshold's score, their scores and classes.

    Class scores are at most 1, so objectness alone rejects most rows.
    """
    # The factor allows for class scores slightly above 1 in half precision.
    rows = np.flatnonzero(table[:, 4] >= threshold * 0.999) if threshold > 0 else np.arange(len(table))
    by_class = table[rows, 5:] * table[rows, 4:5]
    classes = by_class.argmax(axis=1)
    scores = by_class[np.arange(len(rows)), classes]
    kept = scores >= threshold
    return rows[kept], scores[kept], classes[kept]


@lru_cache(maxsize=8)
def _list_cells(width_px: int, height_px: int, strides: tuple[int, ...]) -> Float32Array:
    """Column, row and stride (N, 3) of every YOLOX candidate, row by row, finest grid first."""
    grids = []
    for stride in strides:
        x, y = np.meshgrid(np.arange(width_px // stride), np.arange(height_px // stride))
        grids.append(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, stride)]))
    cells: Float32Array = np.concatenate(grids).astype(np.float32)
    cells.flags.writeable = False
    return cells


class PrototypeReader(OutputReader):
    """The layout of ``boxes`` with k mask coefficients per candidate, and prototypes (1, k, h, w)."""

    def __init__(self, boxes: OutputReader, *, axis: int) -> None:
        """``axis`` (0 or 1, without the batch axis) of ``boxes``' output holds the numbers of a candidate."""
        self._boxes = boxes
        self._axis = axis
        self.needs_suppression = boxes.needs_suppression  # type: ignore[misc]

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """Boxes with coefficients, and prototypes."""
        ((tensor,),) = self._boxes.list_signatures(card)
        count = tensor.shape[self._axis + 1]
        assert isinstance(count, int)
        shape = list(tensor.shape)
        shape[self._axis + 1] = SymbolicDimension(name="k", plus=count, minimum=1)
        prototypes = (
            1,
            SymbolicDimension(name="k", minimum=1),
            SymbolicDimension(name="h"),
            SymbolicDimension(name="w"),
        )
        return (
            (
                OutputTensor(name=tensor.name, usual_names=frozenset({"output0"}), shape=tuple(shape)),
                OutputTensor(name="prototypes", usual_names=frozenset({"output1"}), shape=prototypes),
            ),
        )

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """The boxes with their coefficients."""
        table, prototypes = outputs
        count = table.shape[self._axis] - len(prototypes)
        boxes, coefficients = np.split(table, [count], axis=self._axis)
        candidates = self._boxes.read_candidates((boxes,), card, threshold)
        selected = coefficients.take(candidates.rows, axis=1 - self._axis)
        masks = PrototypeMasks(coefficients=selected.T if self._axis == 0 else selected, prototypes=prototypes)
        return replace(candidates, masks=masks)

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Mismatch of the boxes; any number may be a coefficient."""
        return self._boxes.explain_mismatch(outputs[:1], candidates, card)
