"""Layouts of models that include non-maximum suppression: (1, N, 6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from facadelake.core.arrays import Float32Array
from facadelake.detection.card import ModelCard
from facadelake.detection.layouts.output_reader import (
    DetectionCandidates,
    OutputReader,
    OutputTensor,
    SymbolicDimension,
    check_box_centres,
    check_classes,
    check_corner_order,
    check_scores,
    parse_classes,
)
from facadelake.detection.layouts.yolo import corners_from_centres


class Nms6Reader(OutputReader):
    """(1, N, 6): corners in pixels of the input, score, class."""

    needs_suppression: ClassVar[bool] = False

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """A single output."""
        return ((OutputTensor(name="boxes", shape=(1, SymbolicDimension(name="N"), 6)),),)

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Rows with at least the threshold's score."""
        table = outputs[0]
        rows = np.flatnonzero(table[:, 4] >= threshold)
        return DetectionCandidates(
            corners_input=table[rows, :4],
            scores=table[rows, 4],
            classes=parse_classes(table[:, 5], threshold)[rows],
            rows=rows,
        )

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Scores outside 0..1, invalid corners, or normalised corners."""
        # Models pad their list with rows of score 0 or -1, whose corners are meaningless.
        positive = _select_positive(candidates)
        mismatch = (
            check_classes(outputs[0][:, 5]) or check_scores(candidates, lowest=-1.0) or check_corner_order(positive)
        )
        if mismatch or not len(positive.scores):
            return mismatch
        if np.abs(positive.corners_input).max() <= 1.5:
            return "boxes of a probe image lie within 0 to 1: they are normalised, not pixels of the input"
        return check_box_centres(positive, card, reach_min=0.0, units="pixels of the input")


class RtdetrRowsReader(OutputReader):
    """(1, N, 6): centre and size normalised to 0..1, score, class; RT-DETR as exported by Ultralytics since 2026."""

    needs_suppression: ClassVar[bool] = False

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """A single output."""
        return ((OutputTensor(name="queries", shape=(1, SymbolicDimension(name="N"), 6)),),)

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Rows with at least the threshold's score."""
        table = outputs[0]
        rows = np.flatnonzero(table[:, 4] >= threshold)
        size = np.array([card.input.width_px, card.input.height_px] * 2, dtype=np.float32)
        return DetectionCandidates(
            corners_input=corners_from_centres(table[rows, :2], table[rows, 2:4]) * size,
            scores=table[rows, 4],
            classes=parse_classes(table[:, 5], threshold)[rows],
            rows=rows,
        )

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Scores outside 0..1, sizes below 0, or boxes in pixels."""
        return (
            check_classes(outputs[0][:, 5])
            or check_scores(candidates)
            or check_corner_order(candidates)
            or check_box_centres(candidates, card, reach_min=0.0, units="normalised to 0..1 (pixels?)")
        )


def _select_positive(candidates: DetectionCandidates) -> DetectionCandidates:
    positive = candidates.scores > 0
    return DetectionCandidates(
        corners_input=candidates.corners_input[positive],
        scores=candidates.scores[positive],
        classes=candidates.classes[positive],
        rows=candidates.rows[positive],
    )
