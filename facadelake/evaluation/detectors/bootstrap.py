"""How sure a figure is: whole sites, or photographs, drawn again with replacement (Efron's bootstrap, percentiles)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array
from facadelake.evaluation.detectors.labels.labels import LabelledImage

DRAWS = 500
GROUPS_FEW = 10  # of fewer groups the percentiles say little


@dataclass(frozen=True, kw_only=True)
class BootstrapInterval:
    """95 % of the resampled values lie from ``low`` to ``high``; drawn: ``groups`` of ``unit`` (site or photograph)."""

    low: float
    high: float
    groups: int
    unit: str


def estimate_interval(
    images: Sequence[LabelledImage], figure: Callable[[Float64Array], float], *, by_site: bool, draws: int = DRAWS
) -> BootstrapInterval | None:
    """The interval of ``figure``, a function of the photographs' weights; None with one group, or where it has none.

    A photograph without a site is a site of its own.
    """
    names = [image.site if by_site and image.site is not None else f"\0{i}" for i, image in enumerate(images)]
    _, group = np.unique(names, return_inverse=True)
    groups = int(group.max()) + 1 if len(group) else 0
    if groups < 2:
        return None
    random = np.random.default_rng(0)
    values = []
    for _ in range(draws):
        times = np.bincount(random.integers(0, groups, groups), minlength=groups)
        values.append(figure(times[group].astype(np.float64)))
    usable = np.array([value for value in values if np.isfinite(value)])
    if len(usable) < draws // 2:
        return None
    low, high = np.percentile(usable, [2.5, 97.5])
    return BootstrapInterval(low=float(low), high=float(high), groups=groups, unit="site" if by_site else "photograph")
