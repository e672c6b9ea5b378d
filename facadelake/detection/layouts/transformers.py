"""Transformers with boxes and logits for each query, normalised to the input: RT-DETR, D-FINE, RF-DETR."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from facadelake.core.arrays import Float32Array
from facadelake.detection.card import ModelCard
from facadelake.detection.layouts.masks import QueryMasks
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

_Q = SymbolicDimension(name="Q")
_NORMALISED = "normalised to 0..1 (pixels?)"


class RtdetrReader(OutputReader):
    """Boxes (1, Q, 4: centre and size normalised to 0..1) and logits (1, Q, nc) (RT-DETR, Zhao et al. 2024; D-FINE)."""

    needs_suppression: ClassVar[bool] = False
    boxes_names: ClassVar[frozenset[str]] = frozenset({"pred_boxes", "boxes"})
    logits_names: ClassVar[frozenset[str]] = frozenset({"logits", "pred_logits"})

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """Boxes and logits."""
        return (self._make_signature(len(card.class_names)),)

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Pairs of query and class with at least the threshold's score; the classes of a query are independent."""
        boxes, logits = outputs[0], outputs[1][:, : len(card.class_names)]
        queries, classes = np.nonzero(logits >= _logit(threshold))
        with np.errstate(over="ignore"):
            scores = np.float32(1) / (np.float32(1) + np.exp(-logits[queries, classes]))
        size = np.array([card.input.width_px, card.input.height_px] * 2, dtype=np.float32)
        corners = corners_from_centres(boxes[queries, :2], boxes[queries, 2:]) * size
        return DetectionCandidates(corners_input=corners, scores=scores, classes=classes, rows=queries)

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Probabilities instead of logits, sizes below 0, or boxes in pixels."""
        # The sigmoid of a probability lies between 0.5 and 0.731.
        if len(candidates.scores) and candidates.scores.min() >= 0.4999 and candidates.scores.max() <= 0.7312:
            return (
                "logits of a probe image run from 0 to 1: they are probabilities already; export the model without "
                "its sigmoid"
            )
        return check_corner_order(candidates) or check_box_centres(candidates, card, reach_min=0.0, units=_NORMALISED)

    def _make_signature(self, columns: int) -> tuple[OutputTensor, ...]:
        return (
            OutputTensor(name="boxes", usual_names=self.boxes_names, shape=(1, _Q, 4)),
            OutputTensor(name="logits", usual_names=self.logits_names, shape=(1, _Q, columns)),
        )


class RfdetrReader(RtdetrReader):
    """The same with outputs ``dets`` and ``labels``; a last column of logits without a class name means no object."""

    boxes_names: ClassVar[frozenset[str]] = frozenset({"dets"})
    logits_names: ClassVar[frozenset[str]] = frozenset({"labels"})

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """Boxes and logits, with or without the column for no object."""
        classes = len(card.class_names)
        return self._make_signature(classes + 1), self._make_signature(classes)


class RfdetrSegReader(RfdetrReader):
    """RF-DETR with mask logits (1, Q, h, w) for each query."""

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """Boxes, logits and masks."""
        masks = OutputTensor(
            name="masks",
            usual_names=frozenset({"masks"}),
            shape=(1, _Q, SymbolicDimension(name="h"), SymbolicDimension(name="w")),
        )
        return tuple((*signature, masks) for signature in super().list_signatures(card))

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """The boxes with the masks of their queries."""
        candidates = super().read_candidates(outputs, card, threshold)
        return DetectionCandidates(
            corners_input=candidates.corners_input,
            scores=candidates.scores,
            classes=candidates.classes,
            rows=candidates.rows,
            masks=QueryMasks(all_logits=outputs[2], queries=candidates.rows),
        )


class RtdetrTripleReader(OutputReader):
    """Labels (1, Q), boxes (1, Q, 4: corners) and scores (1, Q), as RT-DETR and D-FINE are exported.

    Boxes are scaled to their second input, ``orig_target_sizes``. It is set to ones, so boxes are normalised, and the
    export's order of width and height does not matter.
    """

    needs_suppression: ClassVar[bool] = False

    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """Labels, boxes and scores."""
        return (
            (
                OutputTensor(name="labels", usual_names=frozenset({"labels"}), shape=(1, _Q)),
                OutputTensor(name="boxes", usual_names=frozenset({"boxes"}), shape=(1, _Q, 4)),
                OutputTensor(name="scores", usual_names=frozenset({"scores"}), shape=(1, _Q)),
            ),
        )

    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """Queries with at least the threshold's score."""
        labels, boxes, scores = outputs
        queries = np.flatnonzero(scores >= threshold)
        size = np.array([card.input.width_px, card.input.height_px] * 2, dtype=np.float32)
        return DetectionCandidates(
            corners_input=boxes[queries] * size,
            scores=scores[queries],
            classes=parse_classes(labels, threshold)[queries],
            rows=queries,
        )

    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Scores outside 0..1, invalid corners, or boxes that are not scaled to the second input."""
        return (
            check_classes(outputs[0])
            or check_scores(candidates)
            or check_corner_order(candidates)
            or check_box_centres(candidates, card, reach_min=0.0, units="scaled to the model's second input")
        )


def _logit(probability: float) -> float:
    if probability <= 0:
        return -np.inf
    if probability >= 1:
        return np.inf
    return float(np.log(probability) - np.log1p(-probability))
