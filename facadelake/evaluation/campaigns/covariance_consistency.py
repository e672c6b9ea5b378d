"""Whether stated uncertainties are honest: true errors against the covariances that came with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from facadelake.core.arrays import Float64Array

# Quantiles of chi-square with 3 degrees of freedom: half, and 95 %, of normal errors lie inside ellipsoids this large.
CHI_SQUARE_50 = 2.366
CHI_SQUARE_95 = 7.815
_DEGREES_OF_FREEDOM = 3


@dataclass(frozen=True, kw_only=True)
class CovarianceConsistency:
    """``n`` errors with a covariance; the others are None where there are none.

    ``inside_2sigma``: share inside the stated 95 % ellipsoid. ``nees``: mean of the normalised squared error over its 3
    degrees of freedom (Bar-Shalom): 1 is honest, more is too sure, less too cautious. ``median_ratio``, ``p95_ratio``:
    quantiles of the normalised squared error over those of chi-square, which single blunders leave alone.
    """

    n: int
    inside_2sigma: float | None = None
    nees: float | None = None
    median_ratio: float | None = None
    p95_ratio: float | None = None

    def to_json(self) -> dict[str, float | int | None]:
        """The fields as keys."""
        return asdict(self)


def compute_normalised_squared_errors(
    errors_m: Float64Array, covariance_m2: Sequence[Float64Array | None]
) -> Float64Array:
    """``e^T C^-1 e`` (m,) of the errors (n, 3) that have a covariance (3, 3), in their order."""
    return np.array(
        [
            float(error @ np.linalg.solve(covariance, error))
            for error, covariance in zip(errors_m, covariance_m2, strict=True)
            if covariance is not None
        ],
        dtype=np.float64,
    )


def compute_covariance_consistency(
    errors_m: Float64Array, covariance_m2: Sequence[Float64Array | None]
) -> CovarianceConsistency:
    """The figures of errors (n, 3) and their covariances (3, 3; None: none stated)."""
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
