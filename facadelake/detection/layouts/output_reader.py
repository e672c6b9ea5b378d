"""The interface of all output layouts: their output tensors, and how these are read as candidates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from facadelake.core.arrays import Float32Array, Float32Nx4, Int64Array, RowIndices
from facadelake.core.errors import ModelError
from facadelake.detection.card import ModelCard
from facadelake.detection.layouts.masks import CandidateMasks

_CORNERS_MIN = 50  # candidates from which corners are told; a grid has one or more per cell
NO_THRESHOLD = -np.inf  # every candidate passes


@dataclass(frozen=True, kw_only=True)
class SymbolicDimension:
    """A dimension that the model chooses, ``plus`` a known number (ONNX ``dim_param``).

    The same name has the same size in all outputs; ``minimum`` is the smallest size, without ``plus``.
    """

    name: str
    plus: int = 0
    minimum: int = 0

    def __str__(self) -> str:
        return f"{self.plus}+{self.name}" if self.plus else self.name


@dataclass(frozen=True, kw_only=True)
class OutputTensor:
    """One output of a layout: its name here, its usual names in exported models, its shape for one image."""

    name: str
    usual_names: frozenset[str] = frozenset()
    shape: tuple[int | SymbolicDimension, ...]

    def __str__(self) -> str:
        return "(" + ", ".join(str(size) for size in self.shape) + ")"


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectionCandidates:
    """Boxes before suppression: ``corners_input`` (n, 4: left, top, right, bottom) in pixels of the model's input.

    ``scores`` (n,), not calibrated; ``classes`` (n,); ``rows`` (n,) of the model's output; ``masks`` if the layout has
    them.
    """

    corners_input: Float32Nx4
    scores: Float32Array
    classes: Int64Array
    rows: RowIndices
    masks: CandidateMasks | None = None


class OutputReader(ABC):
    """Reader of one layout. Outputs are in the order of its signature, each without the batch axis."""

    needs_suppression: ClassVar[bool] = True  # several candidates per object

    @abstractmethod
    def list_signatures(self, card: ModelCard) -> tuple[tuple[OutputTensor, ...], ...]:
        """The signatures (sets of output tensors) that fit ``card``; usually one."""

    @abstractmethod
    def read_candidates(
        self, outputs: Sequence[Float32Array], card: ModelCard, threshold: float
    ) -> DetectionCandidates:
        """The candidates whose uncalibrated score is at least ``threshold``."""

    @abstractmethod
    def explain_mismatch(
        self, outputs: Sequence[Float32Array], candidates: DetectionCandidates, card: ModelCard
    ) -> str:
        """Why outputs of a probe image and their candidates cannot be of this layout; empty if they can."""


def match_shapes(shapes: Sequence[tuple[int, ...]], tensors: Sequence[OutputTensor]) -> bool:
    """Whether ``shapes`` are those of the tensors, in their order."""
    sizes: dict[str, int] = {}
    for shape, tensor in zip(shapes, tensors, strict=True):
        if len(shape) != len(tensor.shape):
            return False
        for size, expected in zip(shape, tensor.shape, strict=True):
            if isinstance(expected, int):
                if size != expected:
                    return False
            elif size - expected.plus < expected.minimum or sizes.setdefault(expected.name, size - expected.plus) != (
                size - expected.plus
            ):
                return False
    return True


def parse_classes(column: Float32Array, threshold: float) -> Int64Array:
    """Class numbers (n,) of a column of them.

    Raises ModelError where they are not whole numbers: the columns of score and class are exchanged, and read as they
    are, the class would be the score. While a layout is verified (``NO_THRESHOLD``), ``check_classes`` says so.
    """
    if threshold != NO_THRESHOLD and (mismatch := check_classes(column)):
        raise ModelError(f"the model's {mismatch}")
    with np.errstate(invalid="ignore"):
        classes: Int64Array = column.astype(np.int64)
    return classes


def check_classes(column: Float32Array) -> str:
    """Why a column cannot be class numbers; empty if it can."""
    finite = column[np.isfinite(column)]
    broken = finite[np.abs(finite - np.round(finite)) > 1e-3]
    if not len(broken):
        return ""
    return (
        f"class column has {len(broken)} values that are not whole numbers, such as {float(broken[0]):.3g}: its rows "
        "seem to be box, class, score; export it with rows of box, score, class"
    )


def check_scores(candidates: DetectionCandidates, *, lowest: float = 0.0) -> str:
    """Why scores are not probabilities; empty if they are."""
    if not len(candidates.scores):
        return ""
    low, high = float(candidates.scores.min()), float(candidates.scores.max())
    if low >= lowest - 1e-3 and high <= 1 + 1e-3:
        return ""
    return (
        f"scores of a probe image run from {low:.3g} to {high:.3g}, not from 0 to 1: they are logits, or "
        "the layout is another one; export the model with its sigmoid"
    )


def check_box_centres(candidates: DetectionCandidates, card: ModelCard, *, reach_min: float, units: str) -> str:
    """Check that box centres lie within the input.

    The reach is the 95th percentile of their coordinates, as a multiple of the input's size.

    Args:
        candidates: All candidates of a probe image.
        card: The model's card.
        reach_min: Smallest reach on both axes; the largest is 2.
        units: What the coordinates should be, for the message.

    Returns:
        The reason why they are not ``units``; empty if they can be.
    """
    if not len(candidates.scores):
        return ""
    with np.errstate(over="ignore", invalid="ignore"):
        centres = (candidates.corners_input[:, :2] + candidates.corners_input[:, 2:]) / 2
    size = np.array([card.input.width_px, card.input.height_px], dtype=np.float32)
    reach = np.percentile(np.abs(centres), 95, axis=0) / size
    if np.isfinite(reach).all() and reach.min() >= reach_min and reach.max() <= 2.0:
        return ""
    return (
        f"box centres of a probe image, read as layout {card.output.layout}, reach {reach.max():.3g} times the input's "
        f"size ({reach_min:g} to 2 expected): they are not {units}"
    )


def check_sizes_beside_centres(candidates: DetectionCandidates) -> str:
    """Why numbers read as centre and size must be corners; empty if they need not be.

    The lower right corner lies beyond the upper left one in every row; a size is larger than its centre's coordinates,
    on both axes, only for the few boxes at the upper left that reach beyond the input.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        size = candidates.corners_input[:, 2:] - candidates.corners_input[:, :2]
        centre = (candidates.corners_input[:, 2:] + candidates.corners_input[:, :2]) / 2
    drawn = (size > 0).all(axis=1)
    if drawn.sum() < _CORNERS_MIN or not (size[drawn] > centre[drawn]).all():
        return ""
    return (
        f"all {drawn.sum()} boxes of a probe image, read as centre and size, are wider and higher than their centres "
        "are from the upper left: they seem to be corners; export it with centres and sizes"
    )


def check_corner_order(candidates: DetectionCandidates) -> str:
    """Why corners are invalid (left beyond right, or top beyond bottom); empty if they are valid."""
    inverted = np.flatnonzero((candidates.corners_input[:, 2:] < candidates.corners_input[:, :2]).any(axis=1))
    if not len(inverted):
        return ""
    return (
        f"{len(inverted)} of {len(candidates.scores)} boxes of a probe image have left > right or "
        "top > bottom: they are not corners"
    )
