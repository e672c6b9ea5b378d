"""Instance segmenters of the YOLO families: a detector's output with mask coefficients, and prototypes beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from facadelake.detect.card import ModelCard
from facadelake.detect.layouts.reader import Candidates, Free, Numbers, Part, Reader
from facadelake.detect.masks import PrototypeMasks


class PrototypeReader(Reader):
    """``boxes``' own layout with k more numbers along its axis of numbers, and prototypes (1, k, h, w)."""

    def __init__(self, boxes: Reader, *, axis: int) -> None:
        """``axis`` (0 or 1) of ``boxes``' output, without the batch's, is that of a candidate's numbers."""
        self._boxes = boxes
        self._axis = axis
        self.overlapping = boxes.overlapping  # type: ignore[misc]

    def forms(self, card: ModelCard) -> tuple[tuple[Part, ...], ...]:
        """Two outputs."""
        ((part,),) = self._boxes.forms(card)
        known = part.shape[self._axis + 1]
        assert isinstance(known, int)
        shape = list(part.shape)
        shape[self._axis + 1] = Free(name="k", plus=known, least=1)
        prototypes = (1, Free(name="k", least=1), Free(name="h"), Free(name="w"))
        return (
            (
                Part(name=part.name, known_as=frozenset({"output0"}), shape=tuple(shape)),
                Part(name="prototypes", known_as=frozenset({"output1"}), shape=prototypes),
            ),
        )

    def candidates(self, outputs: Sequence[Numbers], card: ModelCard, threshold: float) -> Candidates:
        """The boxes with their coefficients."""
        table, prototypes = outputs
        numbers = table.shape[self._axis] - len(prototypes)
        boxes, coefficients = np.split(table, [numbers], axis=self._axis)
        found = self._boxes.candidates((boxes,), card, threshold)
        own = coefficients.take(found.rows, axis=1 - self._axis)
        masks = PrototypeMasks(coefficients=own.T if self._axis == 0 else own, prototypes=prototypes)
        return replace(found, masks=masks)

    def fault(self, outputs: Sequence[Numbers], found: Candidates, card: ModelCard) -> str:
        """What is wrong with the boxes; any number may be a coefficient."""
        return self._boxes.fault(outputs[:1], found, card)
