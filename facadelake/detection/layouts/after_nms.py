"""Lists of boxes from which the model itself has removed what overlaps: (1, N, 6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from facadelake.core.arrays import Float32Array
from facadelake.detection.card import ModelCard
from facadelake.detection.layouts.reader import Candidates, Free, Part, Reader, order_fault, reach_fault, score_fault
from facadelake.detection.layouts.yolo import corners_of


class Nms6Reader(Reader):
    """(1, N, 6): corners in pixels of the input, score, class."""

    overlapping: ClassVar[bool] = False

    def forms(self, card: ModelCard) -> tuple[tuple[Part, ...], ...]:
        """One output."""
        return ((Part(name="boxes", shape=(1, Free(name="N"), 6)),),)

    def candidates(self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float) -> Candidates:
        """Rows of enough score."""
        table = outputs[0]
        rows = np.flatnonzero(table[:, 4] >= threshold)
        return Candidates(
            corners_input=table[rows, :4],
            scores=table[rows, 4],
            classes=table[rows, 5].astype(np.int64),
            rows=rows,
        )

    def fault(self, outputs: Sequence[Float32Array], found: Candidates, card: ModelCard) -> str:
        """Scores beyond 0..1, corners that are none, or normalised ones."""
        # Models pad their list with rows of score 0 or -1, whose corners say nothing.
        real = _above_zero(found)
        fault = score_fault(found, lowest=-1.0) or order_fault(real)
        if fault or not len(real.scores):
            return fault
        if np.abs(real.corners_input).max() <= 1.5:
            return "boxes of a probe image lie within 0 to 1: they are normalised, not pixels of the input"
        return reach_fault(real, card, least=0.0, units="pixels of the input")


class RtdetrRowsReader(Reader):
    """(1, N, 6): centre and size normalised to 0..1, score, class, as RT-DETR is exported by Ultralytics since 2026."""

    overlapping: ClassVar[bool] = False

    def forms(self, card: ModelCard) -> tuple[tuple[Part, ...], ...]:
        """One output."""
        return ((Part(name="queries", shape=(1, Free(name="N"), 6)),),)

    def candidates(self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float) -> Candidates:
        """Rows of enough score."""
        table = outputs[0]
        rows = np.flatnonzero(table[:, 4] >= threshold)
        size = np.array([card.input.width_px, card.input.height_px] * 2, dtype=np.float32)
        return Candidates(
            corners_input=corners_of(table[rows, :2], table[rows, 2:4]) * size,
            scores=table[rows, 4],
            classes=table[rows, 5].astype(np.int64),
            rows=rows,
        )

    def fault(self, outputs: Sequence[Float32Array], found: Candidates, card: ModelCard) -> str:
        """Scores beyond 0..1, sizes below 0, or boxes in pixels."""
        return (
            score_fault(found)
            or order_fault(found)
            or reach_fault(found, card, least=0.0, units="normalised to 0..1 (pixels?)")
        )


def _above_zero(found: Candidates) -> Candidates:
    real = found.scores > 0
    return Candidates(
        corners_input=found.corners_input[real],
        scores=found.scores[real],
        classes=found.classes[real],
        rows=found.rows[real],
    )
