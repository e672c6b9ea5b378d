"""Matching of SIFT descriptors: mutual nearest neighbours by tiled matrix products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float32Array, Float64N, RowIndices, UInt8Array

# A tile of 2048 x 8192 similarities (64 MiB) is small beside the memory and large enough for the matrix product.
_TILE_ROWS, _TILE_COLUMNS = 2048, 8192


@dataclass(frozen=True, kw_only=True, eq=False)
class DescriptorPairs:
    """Mutual nearest neighbours, the most distinctive first.

    Rows ``a`` and ``b`` (k,), and ``ratio`` (k,): distance to the nearest over that to the second nearest (0:
    distinctive, 1: one of several alike).
    """

    a: RowIndices
    b: RowIndices
    ratio: Float64N

    def __len__(self) -> int:
        return len(self.a)


def match_descriptors(a: UInt8Array, b: UInt8Array, *, max_ratio: float) -> DescriptorPairs:
    """Pairs of ``a`` (n, 128) and ``b`` (m, 128) that are each other's nearest and pass the ratio test in ``b``.

    Angles between descriptors are compared, in float32; exact, not approximate: 100,000 against 100,000 take about a
    minute of processor time. Source: Lowe 2004, section 7.1.
    """
    if len(a) == 0 or len(b) < 2:
        empty = np.zeros(0, dtype=np.int64)
        return DescriptorPairs(a=empty, b=empty, ratio=np.zeros(0))
    unit_a, unit_b = _normalise(a), _normalise(b)
    best_of_b = np.full(len(b), -1.0, dtype=np.float32)
    nearest = np.zeros(len(a), dtype=np.int64)
    first, second = np.full((2, len(a)), -1.0, dtype=np.float32)
    tile = np.empty((min(_TILE_ROWS, len(a)), min(_TILE_COLUMNS, len(b))), dtype=np.float32)
    for top in range(0, len(a), _TILE_ROWS):
        rows = slice(top, min(top + _TILE_ROWS, len(a)))
        tile_rows = np.arange(rows.stop - top)
        for left in range(0, len(b), _TILE_COLUMNS):
            columns = slice(left, min(left + _TILE_COLUMNS, len(b)))
            cosine = tile[: rows.stop - top, : columns.stop - left]
            np.matmul(unit_a[rows], unit_b[columns].T, out=cosine)
            np.maximum(best_of_b[columns], cosine.max(axis=0), out=best_of_b[columns])
            column = cosine.argmax(axis=1)
            best = cosine[tile_rows, column]
            cosine[tile_rows, column] = -1.0
            runner_up = cosine.max(axis=1)
            better = best > first[rows]
            second[rows] = np.maximum(np.where(better, first[rows], best), np.maximum(second[rows], runner_up))
            nearest[rows] = np.where(better, left + column, nearest[rows])
            first[rows] = np.maximum(first[rows], best)
    # The same products are compared, so equality means that the row is also the column's nearest.
    mutual = first == best_of_b[nearest]
    # Below 1e-6, 1 - cosine is rounding of float32 and not a distance: two equal copies are equally near.
    ratio = np.sqrt(np.maximum(1.0 - first, 1e-6) / np.maximum(1.0 - second, 1e-6)).astype(np.float64)
    kept = np.flatnonzero(mutual & (ratio <= max_ratio))
    kept = kept[np.argsort(ratio[kept], kind="stable")]
    return DescriptorPairs(a=kept, b=nearest[kept], ratio=ratio[kept])


def _normalise(descriptors: UInt8Array) -> Float32Array:
    """The descriptors (n, 128) with unit length."""
    values = descriptors.astype(np.float32)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    unit: Float32Array = values / np.maximum(length, 1.0)
    return unit
