"""Whether matched pairs are the same surface or a look-alike of it, and what a block's bending does to them."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array

_CELL_M = 1.0
# A cell counts as seen by a campaign with so many tie points in it.
_MIN_POINTS_PER_CELL = 3
# Chi-square of three coordinates that half of the right pairs exceed.
_MEDIAN_CHI_SQUARE = 2.366


def find_occupied_cells(xyz_m: Float64Array, *, at_least: int = 1) -> set[tuple[int, ...]]:
    """The 1 m cells that hold ``at_least`` so many of the points (n, 3)."""
    found, count = np.unique(np.floor(xyz_m / _CELL_M).astype(np.int64), axis=0, return_counts=True)
    return {tuple(cell) for cell in found[count >= at_least].tolist()}


def count_shared_cells(later_m: Float64Array, earlier_m: Float64Array, agreeing_m: Float64Array) -> tuple[int, int]:
    """In how many 1 m cells where both campaigns have tie points some agree, and how many such cells there are."""
    both = find_occupied_cells(later_m, at_least=_MIN_POINTS_PER_CELL) & find_occupied_cells(
        earlier_m, at_least=_MIN_POINTS_PER_CELL
    )
    return len(both & find_occupied_cells(agreeing_m)), len(both)


def compute_chi_square(residual_m: Float64Array, covariance_m2: Float64Array) -> Float64Array:
    """Squared length (n,) of the residuals (n, 3) in their own sigmas."""
    squared: Float64Array = np.einsum(
        "ki,ki->k", residual_m, np.linalg.solve(covariance_m2, residual_m[:, :, None])[:, :, 0]
    )
    return squared


def compute_misfit(squared: Float64Array) -> float:
    """How many times farther apart pairs are than their covariances say (1: as they say), by their chi-squares (n,)."""
    return float(np.sqrt(np.median(squared) / _MEDIAN_CHI_SQUARE))


# A quadratic on fewer 1 m cells would explain away what single windows are off by; so small a part hardly domes.
_MIN_CELLS_FOR_DOMING = 50
_ITERATIONS = 8


def extend_agreement_by_bending(
    xyz_m: Float64Array, residual_m: Float64Array, agrees: BoolArray, tolerance_m: Float64Array
) -> BoolArray:
    """Which pairs (n,) agree within ``tolerance_m`` (n,) when the block may also stretch and dome.

    ``xyz_m`` (n, 3) are the places, ``residual_m`` (n, 3) what a similarity left and ``agrees`` (n,) whom it joined:
    from these the bending is learnt, and spreads to their neighbours as far as it holds.
    """
    for _ in range(_ITERATIONS):
        columns = _build_design_matrix(xyz_m, domes=len(find_occupied_cells(xyz_m[agrees])) >= _MIN_CELLS_FOR_DOMING)
        bending = _fit_bending(columns[agrees], residual_m[agrees], 1.0 / tolerance_m[agrees])
        now = np.linalg.norm(residual_m - columns @ bending, axis=1) < tolerance_m
        if now.sum() < agrees.sum() or (now == agrees).all():
            break
        agrees = now
    return agrees


def remove_bending(xyz_m: Float64Array, residual_m: Float64Array, covariance_m2: Float64Array) -> Float64Array:
    """Residuals (n, 3) less what bending explains: the robust quadratic in the place, for each axis (Cauchy weights).

    On fewer than 50 cells of 1 m the residuals stay as they are.
    """
    if len(find_occupied_cells(xyz_m)) < _MIN_CELLS_FOR_DOMING:
        return residual_m
    columns, left = _build_design_matrix(xyz_m, domes=True), residual_m
    for _ in range(_ITERATIONS):
        weight = 1.0 / np.sqrt(
            (1.0 + compute_chi_square(left, covariance_m2)) * np.trace(covariance_m2, axis1=1, axis2=2)
        )
        left = residual_m - columns @ _fit_bending(columns, residual_m, weight)
    return left


def _build_design_matrix(xyz_m: Float64Array, *, domes: bool) -> Float64Array:
    low, high = np.percentile(xyz_m, [2, 98], axis=0)
    x, y, z = ((xyz_m - (low + high) / 2) / max(float((high - low).max()), 1e-9)).T
    stretched = [np.ones_like(x), x, y, z]
    return np.column_stack([*stretched, x * x, y * y, z * z, x * y, x * z, y * z] if domes else stretched)


def _fit_bending(columns: Float64Array, residual_m: Float64Array, weight: Float64Array) -> Float64Array:
    bending = np.linalg.lstsq(columns * weight[:, None], residual_m * weight[:, None], rcond=1e-9)[0]
    return np.asarray(bending, dtype=np.float64)
