"""What every layout says of itself: the outputs it is made of and how they become candidates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from facadelake.core.arrays import Float32Array, Int64Array
from facadelake.detection.card import ModelCard
from facadelake.detection.layouts.masks import CandidateMasks

NO_THRESHOLD = -np.inf  # the threshold that lets every candidate pass


@dataclass(frozen=True, kw_only=True)
class SymbolicDimension:
    """A size that the model chooses, ``plus`` a known number; the same name is the same size in all outputs."""

    name: str
    plus: int = 0
    least: int = 0

    def __str__(self) -> str:
        return f"{self.plus}+{self.name}" if self.plus else self.name


@dataclass(frozen=True, kw_only=True)
class OutputTensor:
    """One output of a layout: what it is called here, by which names exports know it, its shape for one image."""

    name: str
    usual_names: frozenset[str] = frozenset()
    shape: tuple[int | SymbolicDimension, ...]

    def __str__(self) -> str:
        return "(" + ", ".join(str(size) for size in self.shape) + ")"


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectionCandidates:
    """Boxes before suppression: ``corners_input`` (n, 4: left, top, right, bottom) in pixels of the model's input.

    ``rows`` (n) is where each stands in the model's output; ``masks`` are there where the layout has them.
    """

    corners_input: Float32Array
    scores: Float32Array
    classes: Int64Array
    rows: Int64Array
    masks: CandidateMasks | None = None


class OutputReader(ABC):
    """How one layout is read. Outputs come in the order of its parts, each without its batch axis."""

    needs_suppression: ClassVar[bool] = True  # several candidates for one thing: they need suppression

    @abstractmethod
    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """The sets of outputs that will do for ``card``; mostly one."""

    @abstractmethod
    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """The candidates whose score, as the model gives it, reaches ``threshold``."""

    @abstractmethod
    def explain_mismatch(self, outputs: Sequence[Float32Array], found: DetectionCandidates, card: ModelCard) -> str:
        """Why the outputs of a probe image, and all candidates of them, cannot be of this layout; empty: they can."""


def match_shapes(shapes: Sequence[tuple[int, ...]], parts: Sequence[OutputTensor]) -> bool:
    """Whether outputs of ``shapes`` are the parts, in their order."""
    chosen: dict[str, int] = {}
    for shape, part in zip(shapes, parts, strict=True):
        if len(shape) != len(part.shape):
            return False
        for size, wanted in zip(shape, part.shape, strict=True):
            if isinstance(wanted, int):
                if size != wanted:
                    return False
            elif size - wanted.plus < wanted.least or chosen.setdefault(wanted.name, size - wanted.plus) != (
                size - wanted.plus
            ):
                return False
    return True


def check_scores(found: DetectionCandidates, *, lowest: float = 0.0) -> str:
    """Why scores are no probabilities."""
    if not len(found.scores):
        return ""
    low, high = float(found.scores.min()), float(found.scores.max())
    if low >= lowest - 1e-3 and high <= 1 + 1e-3:
        return ""
    return (
        f"scores of a probe image run from {low:.3g} to {high:.3g}, not from 0 to 1; it gives logits, or has not this "
        "layout: export it with its sigmoid"
    )


def check_box_centres(found: DetectionCandidates, card: ModelCard, *, least: float, units: str) -> str:
    """Why the boxes' middles cannot lie in the input: how far they reach, in its sizes, from ``least`` to 2."""
    if not len(found.scores):
        return ""
    with np.errstate(over="ignore", invalid="ignore"):
        middles = (found.corners_input[:, :2] + found.corners_input[:, 2:]) / 2
    size = np.array([card.input.width_px, card.input.height_px], dtype=np.float32)
    reach = np.percentile(np.abs(middles), 95, axis=0) / size
    if np.isfinite(reach).all() and reach.min() >= least and reach.max() <= 2.0:
        return ""
    return (
        f"box centres of a probe image, read as layout {card.output.layout}, reach {reach.max():.3g} times the input's "
        f"size ({least:g} to 2 expected): they are not {units}"
    )


def check_corner_order(found: DetectionCandidates) -> str:
    """Why corners are none: left beyond right or top beyond bottom."""
    backwards = np.flatnonzero((found.corners_input[:, 2:] < found.corners_input[:, :2]).any(axis=1))
    if not len(backwards):
        return ""
    return (
        f"{len(backwards)} of {len(found.scores)} boxes of a probe image have their left beyond their right or "
        "their top beyond their bottom: they are not corners"
    )
