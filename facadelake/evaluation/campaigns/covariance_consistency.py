"""Consistency of covariances: true errors against the covariances stated with the estimates.

Normalised estimation error squared (NEES): Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, section 5.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx3, Float64x3x3

# Quantiles of chi-square with 3 degrees of freedom: 50 % and 95 % of normal errors are below.
CHI_SQUARE_50 = 2.366
CHI_SQUARE_95 = 7.815
_DEGREES_OF_FREEDOM = 3


@dataclass(frozen=True, kw_only=True)
class CovarianceConsistency:
    """Consistency of ``n`` errors with their covariances; the figures are None where ``n`` is 0.

    ``inside_2sigma``: share inside the stated 95 % ellipsoid. ``nees``: mean of the normalised squared error over its 3
    degrees of freedom; 1: consistent, above: the covariances are too small, below: too large. ``median_ratio``,
    ``p95_ratio``: quantiles of the normalised squared error over those of chi-square, robust against single blunders.
    """

    n: int
    inside_2sigma: float | None = None
    nees: float | None = None
    median_ratio: float | None = None
    p95_ratio: float | None = None

    def convert_to_json(self) -> dict[str, float | int | None]:
        """The fields as keys."""
        return asdict(self)


def compute_normalised_squared_errors(errors_m: Float64Nx3, covariance_m2: Sequence[Float64x3x3 | None]) -> Float64N:
    """``e^T C^-1 e`` (m,) of the errors (n, 3) that have a covariance C (3, 3), in their order."""
    return np.array(
        [
            float(error @ np.linalg.solve(covariance, error))
            for error, covariance in zip(errors_m, covariance_m2, strict=True)
            if covariance is not None
        ],
        dtype=np.float64,
    )


def compute_covariance_consistency(
    errors_m: Float64Nx3, covariance_m2: Sequence[Float64x3x3 | None]
) -> CovarianceConsistency:
    """Consistency of errors (n, 3), m, with their covariances (3, 3), m^2; None: no covariance is stated."""
    squares = compute_normalised_squared_errors(errors_m, covariance_m2)
    if not len(squares):
        return CovarianceConsistency(n=0)
    return CovarianceConsistency(
        n=len(squares),
        inside_2sigma=float(np.mean(squares <= CHI_SQUARE_95)),
        nees=float(np.mean(squares) / _DEGREES_OF_FREEDOM),
        median_ratio=float(np.median(squares) / CHI_SQUARE_50),
        p95_ratio=float(np.percentile(squares, 95) / CHI_SQUARE_95),
    )
