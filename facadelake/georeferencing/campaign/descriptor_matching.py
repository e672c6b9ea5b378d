"""Pairs of SIFT descriptors that are each other's nearest, by matrix products in tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float32Array, Float64Array, RowIndices, UInt8Array

# A tile of 2048 x 8192 similarities (64 MiB) is small beside the memory and large enough for the matrix product.
_TILE_ROWS, _TILE_COLUMNS = 2048, 8192


@dataclass(frozen=True, kw_only=True, eq=False)
class DescriptorPairs:
    """Mutual nearest neighbours, the surest first: rows ``a`` and ``b`` (k,) and ``ratio`` (k,), the distance to the
    nearest over that to the second nearest (0 sure, 1 one of several that look alike)."""

    a: RowIndices
    b: RowIndices
    ratio: Float64Array

    def __len__(self) -> int:
        return len(self.a)


def match_descriptors(a: UInt8Array, b: UInt8Array, *, largest_ratio: float) -> DescriptorPairs:
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
        here = np.arange(rows.stop - top)
        for left in range(0, len(b), _TILE_COLUMNS):
            columns = slice(left, min(left + _TILE_COLUMNS, len(b)))
            alike = tile[: rows.stop - top, : columns.stop - left]
            np.matmul(unit_a[rows], unit_b[columns].T, out=alike)
            np.maximum(best_of_b[columns], alike.max(axis=0), out=best_of_b[columns])
            found = alike.argmax(axis=1)
            best = alike[here, found]
            alike[here, found] = -1.0
            runner_up = alike.max(axis=1)
            better = best > first[rows]
            second[rows] = np.maximum(np.where(better, first[rows], best), np.maximum(second[rows], runner_up))
            nearest[rows] = np.where(better, left + found, nearest[rows])
            first[rows] = np.maximum(first[rows], best)
    # The very products of the tiles are compared, so equality says that the row is also the column's nearest.
    mutual = first == best_of_b[nearest]
    # What float32 leaves of 1 - cosine is 1e-6 and no distance: two equal copies are equally near.
    ratio = np.sqrt(np.maximum(1.0 - first, 1e-6) / np.maximum(1.0 - second, 1e-6)).astype(np.float64)
    kept = np.flatnonzero(mutual & (ratio <= largest_ratio))
    kept = kept[np.argsort(ratio[kept], kind="stable")]
    return DescriptorPairs(a=kept, b=nearest[kept], ratio=ratio[kept])


def _normalise(descriptors: UInt8Array) -> Float32Array:
    values = descriptors.astype(np.float32)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    unit: Float32Array = values / np.maximum(length, 1.0)
    return unit
