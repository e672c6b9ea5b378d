"""Bootstrap intervals of figures: sites or photographs resampled with replacement (Efron and Tibshirani 1993)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64N
from facadelake.evaluation.detectors.labels.labels import LabelledImage

DRAWS = 500
GROUPS_FEW = 10  # with fewer groups the percentiles are rough


@dataclass(frozen=True, kw_only=True)
class BootstrapInterval:
    """Percentile interval of 95 % from ``groups`` resampled groups; ``unit``: site or photograph."""

    low: float
    high: float
    groups: int
    unit: str


def estimate_interval(
    images: Sequence[LabelledImage], figure: Callable[[Float64N], float], *, by_site: bool, draws: int = DRAWS
) -> BootstrapInterval | None:
    """Estimate the interval of a figure.

    Args:
        images: The photographs.
        figure: The figure as a function of the photographs' weights (n,).
        by_site: Resample sites, not photographs. A photograph without a site is a site of its own.
        draws: Number of resampled sets; the random seed is fixed.

    Returns:
        The interval; None with fewer than two groups, and where more than half of the values are not finite.
    """
    names = [image.site if by_site and image.site is not None else f"\0{i}" for i, image in enumerate(images)]
    _, group = np.unique(names, return_inverse=True)
    groups = int(group.max()) + 1 if len(group) else 0
    if groups < 2:
        return None
    random = np.random.default_rng(0)
    values = []
    for _ in range(draws):
        counts = np.bincount(random.integers(0, groups, groups), minlength=groups)
        values.append(figure(counts[group].astype(np.float64)))
    finite = np.array([value for value in values if np.isfinite(value)])
    if len(finite) < draws // 2:
        return None
    low, high = np.percentile(finite, [2.5, 97.5])
    return BootstrapInterval(low=float(low), high=float(high), groups=groups, unit="site" if by_site else "photograph")
