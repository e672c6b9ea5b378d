"""Semantic segmenters: a map for each class; what hangs together in it becomes a box with a mask."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array, Float64Array, Int64Array
from facadelake.detection.card import ModelCard
from facadelake.detection.layouts.masks import ComponentMasks
from facadelake.detection.layouts.output_reader import (
    DetectionCandidates,
    OutputReader,
    OutputTensor,
    SymbolicDimension,
)

_BACKGROUND = "background"
_LOGIT_MAX = 16.0  # float32 knows no probability nearer to 1


class MapReader(OutputReader):
    """(1, nc, h, w): probabilities; the grid covers the input. A class called ``background`` is none.

    A candidate is a connected part (8 neighbours) of more than 0.5; its score is the mean probability in it.
    """

    needs_suppression: ClassVar[bool] = False

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """One output."""
        return (
            (
                OutputTensor(
                    name="map",
                    shape=(
                        1,
                        len(card.class_names),
                        SymbolicDimension(name="h", least=1),
                        SymbolicDimension(name="w", least=1),
                    ),
                ),
            ),
        )

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Connected parts of enough mean probability."""
        return self._parts(self._probabilities(outputs[0], card), card, threshold)

    def explain_mismatch(self, outputs: Sequence[Float32Array], found: DetectionCandidates, card: ModelCard) -> str:
        """Probabilities beyond 0..1."""
        low, high = float(outputs[0].min()), float(outputs[0].max())
        if low >= -1e-3 and high <= 1 + 1e-3:
            return ""
        return (
            f"the map of a probe image runs from {low:.3g} to {high:.3g}, not from 0 to 1; it gives logits (layout "
            "map_logits) or is none"
        )

    def _probabilities(self, given: Float32Array, card: ModelCard) -> Float32Array:
        return given

    def _parts(self, probabilities: Float32Array, card: ModelCard, threshold: float) -> DetectionCandidates:
        classes, rows, columns = probabilities.shape
        cell = np.array([card.input.width_px / columns, card.input.height_px / rows] * 2)
        numbers = np.zeros(probabilities.shape, dtype=np.int32)
        corners: list[Float64Array] = [np.zeros((0, 4))]
        scores: list[Float64Array] = [np.zeros(0)]
        parts: list[Int64Array] = [np.zeros((0, 2), dtype=np.int64)]
        for of_class in range(classes):
            if card.class_names[of_class].casefold() == _BACKGROUND:
                continue
            inside = (probabilities[of_class] > 0.5).astype(np.uint8)
            count, numbers[of_class], stats, _ = cv2.connectedComponentsWithStats(inside, connectivity=8)
            sums = np.bincount(numbers[of_class].ravel(), weights=probabilities[of_class].ravel(), minlength=count)[1:]
            left, top, width, height, cells = (stats[1:, column].astype(np.float64) for column in range(5))
            corners.append(np.column_stack([left, top, left + width, top + height]) * cell)
            scores.append(sums / cells)
            parts.append(np.column_stack([np.full(count - 1, of_class), np.arange(1, count)]))
        all_scores, all_parts = np.concatenate(scores).astype(np.float32), np.concatenate(parts)
        enough = np.flatnonzero(all_scores >= threshold)
        with np.errstate(divide="ignore", invalid="ignore"):
            logits = np.log(probabilities) - np.log1p(-probabilities)
        logits = np.clip(np.nan_to_num(logits, nan=-_LOGIT_MAX), -_LOGIT_MAX, _LOGIT_MAX)
        return DetectionCandidates(
            corners_input=np.concatenate(corners)[enough].astype(np.float32),
            scores=all_scores[enough],
            classes=all_parts[enough, 0],
            rows=enough,
            masks=ComponentMasks(class_logits=logits, labels=numbers, component=all_parts[enough]),
        )


class MapLogitsReader(MapReader):
    """The same before its activation: softmax where a class is called ``background``, else a sigmoid for each class."""

    def explain_mismatch(self, outputs: Sequence[Float32Array], found: DetectionCandidates, card: ModelCard) -> str:
        """Logits that are probabilities."""
        low, high = float(outputs[0].min()), float(outputs[0].max())
        if low < 0 or high > 1:
            return ""
        return (
            f"the map of a probe image runs from {low:.3g} to {high:.3g}: it gives probabilities already (layout map)"
        )

    def _probabilities(self, given: Float32Array, card: ModelCard) -> Float32Array:
        if any(name.casefold() == _BACKGROUND for name in card.class_names):
            raised = np.exp(given - given.max(axis=0, keepdims=True))
            of_all: Float32Array = raised / raised.sum(axis=0, keepdims=True)
            return of_all
        with np.errstate(over="ignore"):
            each: Float32Array = np.float32(1) / (np.float32(1) + np.exp(-given))
        return each
