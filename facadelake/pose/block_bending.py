"""What a free block's bending does to pairs of its points with another block's, once a similarity has joined the two.

Wrong focal lengths and distortion stretch and dome a block that nothing holds: by centimetres where it is strong, by
decimetres where it has few photographs. The adjustment that follows takes that out; here it must not hide right pairs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facadelake.core.frames import Array
from facadelake.pose.reference_evidence import cells, chi_square

# A quadratic on fewer 1 m cells would explain away what single windows are off by; so small a part hardly domes.
_CELLS_THAT_DOME = 50
_ROUNDS = 8


def agreeing_when_bent(
    xyz_m: Array, residual_m: Array, agrees: NDArray[np.bool_], tolerance_m: Array
) -> NDArray[np.bool_]:
    """Which pairs (n,) agree within ``tolerance_m`` (n,) when the block may also stretch and dome.

    ``xyz_m`` (n, 3) are the places, ``residual_m`` (n, 3) what a similarity left and ``agrees`` (n,) whom it joined:
    from these the bending is learnt, and spreads to their neighbours as far as it holds.
    """
    for _ in range(_ROUNDS):
        columns = _columns(xyz_m, domes=len(cells(xyz_m[agrees])) >= _CELLS_THAT_DOME)
        bending = _least_squares(columns[agrees], residual_m[agrees], 1.0 / tolerance_m[agrees])
        now = np.linalg.norm(residual_m - columns @ bending, axis=1) < tolerance_m
        if now.sum() < agrees.sum() or (now == agrees).all():
            break
        agrees = now
    return agrees


def without_bending(xyz_m: Array, residual_m: Array, covariance_m2: Array) -> Array:
    """Residuals (n, 3) less what bending explains: the robust quadratic in the place, for each axis (Cauchy weights).

    On fewer than 50 cells of 1 m the residuals stay as they are.
    """
    if len(cells(xyz_m)) < _CELLS_THAT_DOME:
        return residual_m
    columns, left = _columns(xyz_m, domes=True), residual_m
    for _ in range(_ROUNDS):
        weight = 1.0 / np.sqrt((1.0 + chi_square(left, covariance_m2)) * np.trace(covariance_m2, axis1=1, axis2=2))
        left = residual_m - columns @ _least_squares(columns, residual_m, weight)
    return left


def _columns(xyz_m: Array, *, domes: bool) -> Array:
    low, high = np.percentile(xyz_m, [2, 98], axis=0)
    x, y, z = ((xyz_m - (low + high) / 2) / max(float((high - low).max()), 1e-9)).T
    stretched = [np.ones_like(x), x, y, z]
    return np.column_stack([*stretched, x * x, y * y, z * z, x * y, x * z, y * z] if domes else stretched)


def _least_squares(columns: Array, residual_m: Array, weight: Array) -> Array:
    bending = np.linalg.lstsq(columns * weight[:, None], residual_m * weight[:, None], rcond=1e-9)[0]
    return np.asarray(bending, dtype=np.float64)
