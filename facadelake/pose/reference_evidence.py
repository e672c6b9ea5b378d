"""Whether the pairs that agree on a placement are the same surface, or one that looks like it a window to the side.

Where the two campaigns show different parts of a facade, the true partners are missing and the windows of one part
agree with those of the other, without a rival. Two things give that away: windows are built alike to centimetres, while
the same window is found again to millimetres; and between the windows the walls do not look the same.
"""

from __future__ import annotations

import numpy as np

from facadelake.frames import Array

_CELL_M = 1.0
# A cell counts as seen by a campaign with so many tie points in it.
_POINTS_IN_CELL = 3
# Chi-square of three coordinates that half of the right pairs exceed.
_MEDIAN_CHI_SQUARE = 2.366
# A quadratic on fewer places would explain away what single windows are off by; so small a part hardly bends.
_CELLS_THAT_BEND = 50
_ROUNDS = 5


def cells(xyz_m: Array, *, at_least: int = 1) -> set[tuple[int, ...]]:
    """The 1 m cells that hold ``at_least`` so many of the points (n, 3)."""
    found, count = np.unique(np.floor(xyz_m / _CELL_M).astype(np.int64), axis=0, return_counts=True)
    return {tuple(cell) for cell in found[count >= at_least].tolist()}


def shared_places(later_m: Array, earlier_m: Array, agreeing_m: Array) -> tuple[int, int]:
    """In how many 1 m cells where both campaigns have tie points some agree, and how many such cells there are."""
    both = cells(later_m, at_least=_POINTS_IN_CELL) & cells(earlier_m, at_least=_POINTS_IN_CELL)
    return len(both & cells(agreeing_m)), len(both)


def without_bending(xyz_m: Array, residual_m: Array, covariance_m2: Array) -> Array:
    """Residuals (n, 3) less what a block's bending explains: the robust quadratic in the place, for each axis.

    A free block domes; that is no fault of the single pair. Reweighted least squares (Cauchy). On fewer than 50 cells
    of 1 m the residuals stay as they are.
    """
    if len(cells(xyz_m)) < _CELLS_THAT_BEND:
        return residual_m
    low, high = np.percentile(xyz_m, [2, 98], axis=0)
    x, y, z = ((xyz_m - (low + high) / 2) / max(float((high - low).max()), 1e-9)).T
    columns = np.column_stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
    left = residual_m
    for _ in range(_ROUNDS):
        weight = 1.0 / np.sqrt((1.0 + chi_square(left, covariance_m2)) * np.trace(covariance_m2, axis1=1, axis2=2))
        bending = np.linalg.lstsq(columns * weight[:, None], residual_m * weight[:, None], rcond=1e-9)[0]
        left = residual_m - columns @ bending
    return left


def chi_square(residual_m: Array, covariance_m2: Array) -> Array:
    """Squared length (n,) of the residuals (n, 3) in their own sigmas."""
    squared: Array = np.einsum("ki,ki->k", residual_m, np.linalg.solve(covariance_m2, residual_m[:, :, None])[:, :, 0])
    return squared


def misfit(squared: Array) -> float:
    """How many times farther apart pairs are than their covariances say (1: as they say), by their chi-squares (n,)."""
    return float(np.sqrt(np.median(squared) / _MEDIAN_CHI_SQUARE))
