"""Masks as a model gives them: logits on a coarse grid over the model's input, asked for box by box."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import Float32Array, Int64Array


class CandidateMasks(ABC):
    """Logits of masks, one for each candidate; above 0 is inside. The grid covers the whole input."""

    @property
    @abstractmethod
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns."""

    @abstractmethod
    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A part of one candidate's grid."""

    @abstractmethod
    def take(self, candidates: Int64Array) -> CandidateMasks:
        """The masks of these candidates."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PrototypeMasks(CandidateMasks):
    """``coefficients`` (n, k) are each mask's weights of the ``prototypes`` (k, rows, columns) (YOLACT, Bolya 2019)."""

    coefficients: Float32Array
    prototypes: Float32Array

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.prototypes.shape[1], self.prototypes.shape[2]

    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A part of one candidate's grid."""
        return np.asarray(np.tensordot(self.coefficients[candidate], self.prototypes[:, rows, columns], axes=1))

    def take(self, candidates: Int64Array) -> PrototypeMasks:
        """The masks of these candidates."""
        return PrototypeMasks(coefficients=self.coefficients[candidates], prototypes=self.prototypes)


@dataclass(frozen=True, kw_only=True, eq=False)
class ComponentMasks(CandidateMasks):
    """Connected parts of class maps, told apart by ``labels`` (nc, rows, columns); ``component`` (n, 2): class, number."""

    class_logits: Float32Array
    labels: NDArray[np.int32]
    component: Int64Array

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.class_logits.shape[1], self.class_logits.shape[2]

    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A part of one candidate's grid, in which other connected parts are outside."""
        of_class, number = self.component[candidate]
        logits, numbers = self.class_logits[of_class, rows, columns], self.labels[of_class, rows, columns]
        return np.where((numbers == number) | (numbers == 0), logits, -np.abs(logits))

    def take(self, candidates: Int64Array) -> ComponentMasks:
        """The masks of these candidates."""
        return ComponentMasks(class_logits=self.class_logits, labels=self.labels, component=self.component[candidates])


@dataclass(frozen=True, kw_only=True, eq=False)
class QueryMasks(CandidateMasks):
    """A whole mask (rows, columns) for each query of a transformer; ``queries`` (n) says which is a candidate's."""

    all_logits: Float32Array
    queries: Int64Array

    @property
    def grid_shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.all_logits.shape[1], self.all_logits.shape[2]

    def get_logits(self, candidate: int, rows: slice, columns: slice) -> Float32Array:
        """A part of one candidate's grid."""
        return self.all_logits[self.queries[candidate], rows, columns]

    def take(self, candidates: Int64Array) -> QueryMasks:
        """The masks of these candidates."""
        return QueryMasks(all_logits=self.all_logits, queries=self.queries[candidates])
