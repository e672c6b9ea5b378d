"""Masks of a model: logits on a coarse grid over the model's input, computed box by box."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import Float32Array, Int64Array, RowIndices


class CandidateMasks(ABC):
    """Mask logits of each candidate; above 0 is inside. The grid covers the whole input."""

    @property
    @abstractmethod
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""

    @abstractmethod
    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A window of one candidate's grid."""

    @abstractmethod
    def take(self, candidates: RowIndices) -> CandidateMasks:
        """The masks of a selection of candidates."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PrototypeMasks(CandidateMasks):
    """``coefficients`` (n, k) weight the ``prototypes`` (k, rows, columns) of each mask (YOLACT, Bolya et al. 2019)."""

    coefficients: Float32Array
    prototypes: Float32Array

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.prototypes.shape[1], self.prototypes.shape[2]

    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A window of one candidate's grid."""
        return np.asarray(np.tensordot(self.coefficients[candidate], self.prototypes[:, rows, columns], axes=1))

    def take(self, candidates: RowIndices) -> PrototypeMasks:
        """The masks of a selection of candidates."""
        return PrototypeMasks(coefficients=self.coefficients[candidates], prototypes=self.prototypes)


@dataclass(frozen=True, kw_only=True, eq=False)
class ComponentMasks(CandidateMasks):
    """Connected components of class maps: ``labels`` (nc, rows, columns), ``component`` (n, 2): class and label.

    ``class_logits``: (nc, rows, columns).
    """

    class_logits: Float32Array
    labels: NDArray[np.int32]
    component: Int64Array

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.class_logits.shape[1], self.class_logits.shape[2]

    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A window of one candidate's grid; other components are outside."""
        class_index, label = self.component[candidate]
        logits, labels = self.class_logits[class_index, rows, columns], self.labels[class_index, rows, columns]
        return np.where((labels == label) | (labels == 0), logits, -np.abs(logits))

    def take(self, candidates: RowIndices) -> ComponentMasks:
        """The masks of a selection of candidates."""
        return ComponentMasks(class_logits=self.class_logits, labels=self.labels, component=self.component[candidates])


@dataclass(frozen=True, kw_only=True, eq=False)
class QueryMasks(CandidateMasks):
    """A mask (rows, columns) for each query of a transformer; ``queries`` (n,): the query of each candidate."""

    all_logits: Float32Array
    queries: RowIndices

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.all_logits.shape[1], self.all_logits.shape[2]

    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A window of one candidate's grid."""
        return self.all_logits[self.queries[candidate], rows, columns]

    def take(self, candidates: RowIndices) -> QueryMasks:
        """The masks of a selection of candidates."""
        return QueryMasks(all_logits=self.all_logits, queries=self.queries[candidates])
