"""Whether the pairs that agree on a placement are the same surface, or one that looks like it a window to the side.

Where the two campaigns show different parts of a facade, the true partners are missing and the windows of one part
agree with those of the other, without a rival. Two things give that away: windows are built alike to centimetres, while
the same window is found again to millimetres; and between the windows the walls do not look the same.
"""

from __future__ import annotations

import numpy as np

from facadelake.core.frames import Array

_CELL_M = 1.0
# A cell counts as seen by a campaign with so many tie points in it.
_POINTS_IN_CELL = 3
# Chi-square of three coordinates that half of the right pairs exceed.
_MEDIAN_CHI_SQUARE = 2.366


def cells(xyz_m: Array, *, at_least: int = 1) -> set[tuple[int, ...]]:
    """The 1 m cells that hold ``at_least`` so many of the points (n, 3)."""
    found, count = np.unique(np.floor(xyz_m / _CELL_M).astype(np.int64), axis=0, return_counts=True)
    return {tuple(cell) for cell in found[count >= at_least].tolist()}


def shared_places(later_m: Array, earlier_m: Array, agreeing_m: Array) -> tuple[int, int]:
    """In how many 1 m cells where both campaigns have tie points some agree, and how many such cells there are."""
    both = cells(later_m, at_least=_POINTS_IN_CELL) & cells(earlier_m, at_least=_POINTS_IN_CELL)
    return len(both & cells(agreeing_m)), len(both)


def chi_square(residual_m: Array, covariance_m2: Array) -> Array:
    """Squared length (n,) of the residuals (n, 3) in their own sigmas."""
    squared: Array = np.einsum("ki,ki->k", residual_m, np.linalg.solve(covariance_m2, residual_m[:, :, None])[:, :, 0])
    return squared


def misfit(squared: Array) -> float:
    """How many times farther apart pairs are than their covariances say (1: as they say), by their chi-squares (n,)."""
    return float(np.sqrt(np.median(squared) / _MEDIAN_CHI_SQUARE))
