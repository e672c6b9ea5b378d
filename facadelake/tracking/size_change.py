"""Change of size between campaigns, with its standard error, and whether it is significant.

Sizes are compared as logarithms: a box's error is a share of its extent. The standard error has two sources, and the
larger counts: the scatter of a defect's sightings within a campaign, and the scatter of the change over all defects
seen in both campaigns, most of which did not change; errors that all sightings of a campaign share (light, detector,
distance) show in the latter alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import false_discovery_control, norm

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, RowIndices

_RATE = 0.02  # of false discoveries among the changes called significant
_SINGLE_SIGMA = 0.10  # of the logarithm of an extent seen once, where a campaign has no repeated sightings
_MAD_TO_SIGMA = 1.4826
_PAIRS_MIN = 8
_CHANGED_SIGMA = 0.35  # of the logarithm of the change of those that changed
_PRIOR_PAIRS = 4.0


def estimate_size_sigmas(log_size: Float64N, defect: RowIndices, count: int) -> Float64N:
    """One sigma of the logarithm of each defect's median size, from the scatter of its sightings.

    The scatter is pooled over the campaign, since most defects have few sightings.

    Args:
        log_size: logarithm (n,) of the size of each sighting.
        defect: row (n,) of its defect.
        count: number of defects.

    Returns:
        The sigmas (count,).
    """
    sightings = np.bincount(defect, minlength=count)
    order = np.lexsort((log_size, defect))
    first = np.concatenate([[0], np.cumsum(sightings)[:-1]])
    median = np.full(count, np.nan)
    has = sightings > 0
    low, high = first + (sightings - 1) // 2, first + sightings // 2
    median[has] = (log_size[order][low[has]] + log_size[order][high[has]]) / 2
    repeated = sightings[defect] >= 3
    single = _SINGLE_SIGMA
    if np.count_nonzero(repeated) >= _PAIRS_MIN:
        share = np.sqrt(sightings[defect] / np.maximum(sightings[defect] - 1.0, 1.0))
        single = _MAD_TO_SIGMA * float(np.median(np.abs(log_size - median[defect])[repeated] * share[repeated]))
    # The median of n has pi / 2 times the variance of the mean; of two it is the mean.
    efficiency = np.where(sightings >= 3, np.sqrt(np.pi / 2), 1.0)
    sigma: Float64N = efficiency * single / np.sqrt(np.maximum(sightings, 1))
    return sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class SizeChange:
    """Changes (k) of the logarithm of a size: ``log_change`` with ``sigma``; ``significant`` after control of the
    false discovery rate."""

    log_change: Float64N
    sigma: Float64N
    significant: BoolArray


def compare_sizes(log_before: Float64N, sigma_before: Float64N, log_after: Float64N, sigma_after: Float64N) -> SizeChange:
    """Changes of k defects between two campaigns; NaN where a size is missing.

    Source: Benjamini and Hochberg 1995, JRSS B 57, for the control of the false discovery rate.
    """
    change = log_after - log_before
    sigma = np.hypot(sigma_before, sigma_after)
    known = np.isfinite(change) & np.isfinite(sigma) & (sigma > 0)
    if np.count_nonzero(known) >= _PAIRS_MIN:
        sigma = sigma * _estimate_scale(change[known], sigma[known])
    significant = np.zeros(len(change), dtype=bool)
    if known.any():
        p = 2 * norm.sf(np.abs(change[known]) / sigma[known])
        significant[known] = false_discovery_control(p) <= _RATE
    return SizeChange(log_change=change, sigma=np.where(known, sigma, np.nan), significant=significant)


def _estimate_scale(change: Float64N, sigma: Float64N) -> float:
    """Factor on ``sigma`` (k,), at least 1, that the changes of the unchanged defects show.

    The changes are a mixture of unchanged defects and of changed ones; expectation-maximisation tells them apart.
    """
    scale, unchanged = 1.0, 0.8
    for _ in range(20):
        narrow = unchanged * norm.pdf(change, scale=scale * sigma)
        wide = (1 - unchanged) * norm.pdf(change, scale=np.hypot(scale * sigma, _CHANGED_SIGMA))
        share = narrow / np.maximum(narrow + wide, 1e-300)
        # A handful of pseudo-counts keeps few pairs near the stated sigmas.
        scale = float(np.sqrt((np.sum(share * (change / sigma) ** 2) + _PRIOR_PAIRS) / (share.sum() + _PRIOR_PAIRS)))
        unchanged = float((share.sum() + 4) / (len(change) + 5))
    return max(1.0, scale)


@dataclass(frozen=True, kw_only=True, eq=False)
class Trend:
    """Trend of a size: ``per_year`` with its 95 % interval (2,), in the size's unit, from ``campaigns`` sightings."""

    per_year: float
    interval_per_year: Float64Array
    campaigns: int
    draws_per_year: Float64Array
    draws_level: Float64Array


def fit_trend(year: Float64N, size: Float64N, sigma: Float64N, *, draws: int = 1000) -> Trend | None:
    """Theil-Sen slope of a size over three or more campaigns, its interval from the sizes' own sigmas.

    Args:
        year: times (n,) in years.
        size: sizes (n,).
        sigma: one sigma of each (n,).
        draws: number of draws of the sizes' errors.

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
