"""Semantic segmenters: a map for each class; each connected component becomes a box with a mask."""

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
_LOGIT_MAX = 16.0  # no float32 probability is nearer to 1


class MapReader(OutputReader):
    """(1, nc, h, w): probabilities; the grid covers the input. A class called ``background`` is ignored.

    A candidate is a connected component (8 neighbours) above 0.5; its score is its mean probability.
    """

    needs_suppression: ClassVar[bool] = False

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """A single output."""
        return (
            (
                OutputTensor(
                    name="map",
                    shape=(
                        1,
                        len(card.class_names),
                        SymbolicDimension(name="h", minimum=1),
                        SymbolicDimension(name="w", minimum=1),
                    ),
                ),
            ),
        )

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Connected components with at least the threshold's mean probability."""
        return self._find_components(self._compute_probabilities(outputs[0], card), card, threshold)

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Probabilities outside 0..1."""
        low, high = float(outputs[0].min()), float(outputs[0].max())
        if low >= -1e-3 and high <= 1 + 1e-3:
            return ""
        return (
            f"the map of a probe image runs from {low:.3g} to {high:.3g}, not from 0 to 1: it holds logits (layout "
            "map_logits), or it is not a map"
        )

    def _compute_probabilities(self, values: Float32Array, card: ModelCard) -> Float32Array:
        return values

    def _find_components(self, probabilities: Float32Array, card: ModelCard, threshold: float) -> DetectionCandidates:
        classes, rows, columns = probabilities.shape
        cell = np.array([card.input.width_px / columns, card.input.height_px / rows] * 2)
        labels = np.zeros(probabilities.shape, dtype=np.int32)
        corners: list[Float64Array] = [np.zeros((0, 4))]
        scores: list[Float64Array] = [np.zeros(0)]
        components: list[Int64Array] = [np.zeros((0, 2), dtype=np.int64)]
        for class_index in range(classes):
            if card.class_names[class_index].casefold() == _BACKGROUND:
                continue
            inside = (probabilities[class_index] > 0.5).astype(np.uint8)
            count, labels[class_index], stats, _ = cv2.connectedComponentsWithStats(inside, connectivity=8)
            sums = np.bincount(
                labels[class_index].ravel(), weights=probabilities[class_index].ravel(), minlength=count
            )[1:]
            left, top, width, height, cells = (stats[1:, column].astype(np.float64) for column in range(5))
            corners.append(np.column_stack([left, top, left + width, top + height]) * cell)
            scores.append(sums / cells)
            components.append(np.column_stack([np.full(count - 1, class_index), np.arange(1, count)]))
        all_scores, all_components = np.concatenate(scores).astype(np.float32), np.concatenate(components)
        kept = np.flatnonzero(all_scores >= threshold)
        with np.errstate(divide="ignore", invalid="ignore"):
            logits = np.log(probabilities) - np.log1p(-probabilities)
        logits = np.clip(np.nan_to_num(logits, nan=-_LOGIT_MAX), -_LOGIT_MAX, _LOGIT_MAX)
        return DetectionCandidates(
            corners_input=np.concatenate(corners)[kept].astype(np.float32),
            scores=all_scores[kept],
            classes=all_components[kept, 0],
            rows=kept,
            masks=ComponentMasks(class_logits=logits, labels=labels, component=all_components[kept]),
        )


class MapLogitsReader(MapReader):
    """The same before the activation: softmax if a class is called ``background``, else a sigmoid of each class."""

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Probabilities instead of logits."""
        low, high = float(outputs[0].min()), float(outputs[0].max())
        if low < 0 or high > 1:
            return ""
        return (
            f"the map of a probe image runs from {low:.3g} to {high:.3g}: it holds probabilities already (layout map)"
        )

    def _compute_probabilities(self, values: Float32Array, card: ModelCard) -> Float32Array:
        if any(name.casefold() == _BACKGROUND for name in card.class_names):
            exponentials = np.exp(values - values.max(axis=0, keepdims=True))
            softmax: Float32Array = exponentials / exponentials.sum(axis=0, keepdims=True)
            return softmax
        with np.errstate(over="ignore"):
            sigmoid: Float32Array = np.float32(1) / (np.float32(1) + np.exp(-values))
        return sigmoid
