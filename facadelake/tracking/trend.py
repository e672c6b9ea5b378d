"""Trend of a size over three or more campaigns, and when it reaches a limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, Float64N

_DRAWS_MIN, _DRAWS_MAX, _SLOPES_MAX = 200, 1000, 20_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Trend:
    """Trend of a size: ``per_year`` with its 95 % interval (2,), in the size's unit, from ``campaigns`` sightings."""

    per_year: float
    interval_per_year: Float64Array
    campaigns: int
    draws_per_year: Float64Array
    draws_level: Float64Array


def fit_trend(year: Float64N, size: Float64N, sigma: Float64N) -> Trend | None:
    """Theil-Sen slope of a size over three or more campaigns, its interval from the sizes' own sigmas.

    Args:
        year: times (n,) in years.
        size: sizes (n,).
        sigma: one sigma of each (n,).

    Returns:
        The trend; None for fewer than three sizes or none between different times.
    """
    known = np.isfinite(size) & np.isfinite(sigma)
    year, size, sigma = year[known], size[known], sigma[known]
    first, second = np.triu_indices(len(year), 1)
    apart = year[second] != year[first]
    first, second = first[apart], second[apart]
    if len(year) < 3 or not len(first):
        return None
    # Many campaigns have many pairs; the interval of their trend is narrow, and fewer draws tell it as well.
    draws = max(_DRAWS_MIN, min(_DRAWS_MAX, _SLOPES_MAX // len(first)))
    drawn = size + sigma * np.random.default_rng(0).normal(size=(draws, len(year)))
    drawn[0] = size
    slopes = np.median((drawn[:, second] - drawn[:, first]) / (year[second] - year[first]), axis=1)
    level = np.median(drawn - slopes[:, None] * year, axis=1)
    return Trend(
        per_year=float(slopes[0]),
        interval_per_year=np.percentile(slopes, [2.5, 97.5]),
        campaigns=len(year),
        draws_per_year=slopes,
        draws_level=level,
    )


def predict_limit(trend: Trend, limit: float) -> Float64Array | None:
    """Earliest, most likely and latest year (3,) at which a size reaches a limit; None where that cannot be said.

    It cannot be said where the trend's interval includes no growth.
    """
    if trend.interval_per_year[0] <= 0:
        return None
    years = (limit - trend.draws_level) / trend.draws_per_year
    low, high = np.percentile(years, [2.5, 97.5])
    return np.array([low, years[0], high])
