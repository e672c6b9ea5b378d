"""Consistency of matched pairs: the same surface or a similar one elsewhere, and the bending of a free block."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64Nx3x3

_CELL_M = 1.0
# A campaign covers a cell with so many tie points in it.
_MIN_POINTS_PER_CELL = 3
# Median of the chi-square distribution with three degrees of freedom.
_MEDIAN_CHI_SQUARE = 2.366
# A quadratic on fewer 1 m cells would absorb the offset of single windows; so small a part hardly domes.
_MIN_CELLS_FOR_DOMING = 50
_ITERATIONS = 8


def find_occupied_cells(xyz_m: Float64Nx3, *, at_least: int = 1) -> set[tuple[int, ...]]:
    """The 1 m cells that hold ``at_least`` so many of the points (n, 3)."""
    cells, count = np.unique(np.floor(xyz_m / _CELL_M).astype(np.int64), axis=0, return_counts=True)
    return {tuple(cell) for cell in cells[count >= at_least].tolist()}


def count_shared_cells(later_m: Float64Nx3, earlier_m: Float64Nx3, agreeing_m: Float64Nx3) -> tuple[int, int]:
    """Among the 1 m cells that both campaigns cover, the number with agreeing points, and the number of all.

    ``later_m``, ``earlier_m``, ``agreeing_m`` (n, 3): tie points of the campaigns, and those that agree.
    """
    both = find_occupied_cells(later_m, at_least=_MIN_POINTS_PER_CELL) & find_occupied_cells(
        earlier_m, at_least=_MIN_POINTS_PER_CELL
    )
    return len(both & find_occupied_cells(agreeing_m)), len(both)


def compute_chi_square(residual_m: Float64Nx3, covariance_m2: Float64Nx3x3) -> Float64N:
    """Squared Mahalanobis length (n,) of the residuals (n, 3)."""
    squared: Float64Array = np.einsum(
        "ki,ki->k", residual_m, np.linalg.solve(covariance_m2, residual_m[:, :, None])[:, :, 0]
    )
    return squared


def compute_misfit(squared: Float64N) -> float:
    """Ratio of the residuals to their covariances (1: consistent), by the median of their chi-squares (n,)."""
    return float(np.sqrt(np.median(squared) / _MEDIAN_CHI_SQUARE))


def extend_agreement_by_bending(
    xyz_m: Float64Nx3, residual_m: Float64Nx3, agrees: BoolArray, tolerance_m: Float64N
) -> BoolArray:
    """Which pairs agree when the block may also stretch and dome.

    Args:
        xyz_m: points (n, 3).
        residual_m: their residuals (n, 3) after a similarity.
        agrees: the pairs (n,) that agree with the similarity; the bending is fitted to them and extends to neighbours.
        tolerance_m: tolerance (n,) of the residuals.

    Returns:
        the pairs (n,) that agree after the bending is removed.
    """
    for _ in range(_ITERATIONS):
        columns = _build_design_matrix(xyz_m, domes=len(find_occupied_cells(xyz_m[agrees])) >= _MIN_CELLS_FOR_DOMING)
        bending = _fit_bending(columns[agrees], residual_m[agrees], 1.0 / tolerance_m[agrees])
        extended = np.linalg.norm(residual_m - columns @ bending, axis=1) < tolerance_m
        if extended.sum() < agrees.sum() or (extended == agrees).all():
            break
        agrees = extended
    return agrees


def remove_bending(xyz_m: Float64Nx3, residual_m: Float64Nx3, covariance_m2: Float64Nx3x3) -> Float64Nx3:
    """Residuals (n, 3) less the bending: a robust quadratic in the coordinates, for each axis (Cauchy weights).

    On fewer than 50 cells of 1 m the residuals are returned unchanged.
    """
    if len(find_occupied_cells(xyz_m)) < _MIN_CELLS_FOR_DOMING:
        return residual_m
    columns, remaining = _build_design_matrix(xyz_m, domes=True), residual_m
    for _ in range(_ITERATIONS):
        weight = 1.0 / np.sqrt(
            (1.0 + compute_chi_square(remaining, covariance_m2)) * np.trace(covariance_m2, axis1=1, axis2=2)
        )
        remaining = residual_m - columns @ _fit_bending(columns, residual_m, weight)
    return remaining


def _build_design_matrix(xyz_m: Float64Nx3, *, domes: bool) -> Float64Array:
    """Linear and, with ``domes``, quadratic terms (n, 4 or 10) of the coordinates, scaled to the points' extent."""
    low, high = np.percentile(xyz_m, [2, 98], axis=0)
    x, y, z = ((xyz_m - (low + high) / 2) / max(float((high - low).max()), 1e-9)).T
    linear = [np.ones_like(x), x, y, z]
    return np.column_stack([*linear, x * x, y * y, z * z, x * y, x * z, y * z] if domes else linear)


def _fit_bending(columns: Float64Array, residual_m: Float64Nx3, weight: Float64N) -> Float64Array:
    bending = np.linalg.lstsq(columns * weight[:, None], residual_m * weight[:, None], rcond=1e-9)[0]
    return np.asarray(bending, dtype=np.float64)
