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

from facadelake.core.arrays import BoolArray, Float64N, RowIndices

_RATE = 0.02  # of false discoveries among the changes called significant
_SINGLE_SIGMA = 0.10  # of the logarithm of an extent seen once, where a campaign has no repeated sightings
_MAD_TO_SIGMA = 1.4826
_PAIRS_MIN = 8
_CHANGED_SIGMA = 0.35  # of the logarithm of the change of those that changed
_PRIOR_PAIRS = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectSizes:
    """A size of each defect (n,) as a logarithm, with one sigma; NaN where it was not measured."""

    log_size: Float64N
    sigma: Float64N


def summarise_sizes(log_size: Float64N, defect: RowIndices, count: int) -> DefectSizes:
    """The median size of each defect's sightings, with one sigma from their scatter.

    The scatter is pooled over the campaign, since most defects have few sightings.

    Args:
        log_size: logarithm (n,) of the size of each sighting.
        defect: row (n,) of its defect.
        count: number of defects.

    Returns:
        The sizes (count,).
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
    sigma = efficiency * single / np.sqrt(np.maximum(sightings, 1))
    return DefectSizes(log_size=median, sigma=np.where(has, sigma, np.nan))


@dataclass(frozen=True, kw_only=True, eq=False)
class SizeChange:
    """Changes (k) of the logarithm of a size: ``log_change`` with ``sigma``, NaN where a size is missing.

    ``scale``: factor on the stated sigmas that the unchanged defects show; ``sigma`` has it.
    """

    log_change: Float64N
    sigma: Float64N
    scale: float

    @property
    def p_value(self) -> Float64N:
        """Probability (k,) of such a change, or a larger one, of a defect that did not change; NaN where unknown."""
        p: Float64N = 2 * norm.sf(np.abs(self.log_change) / self.sigma)
        return p


def compare_sizes(
    log_before: Float64N, sigma_before: Float64N, log_after: Float64N, sigma_after: Float64N
) -> SizeChange:
    """Changes of k defects between two campaigns.

    Args:
        log_before: logarithms (k,) of the sizes before.
        sigma_before: one sigma of each.
        log_after: of the sizes after.
        sigma_after: one sigma of each.
    """
    change = log_after - log_before
    sigma = np.hypot(sigma_before, sigma_after)
    known = np.isfinite(change) & np.isfinite(sigma) & (sigma > 0)
    scale = _estimate_scale(change[known], sigma[known]) if np.count_nonzero(known) >= _PAIRS_MIN else 1.0
    return SizeChange(
        log_change=np.where(known, change, np.nan), sigma=np.where(known, scale * sigma, np.nan), scale=scale
    )


def select_significant(p_value: Float64N) -> BoolArray:
    """The changes (k,) that are significant with 2 % false discoveries at most; NaN is not.

    Source: Benjamini and Hochberg 1995, JRSS B 57.
    """
    significant = np.zeros(len(p_value), dtype=bool)
    known = np.isfinite(p_value)
    if known.any():
        significant[known] = false_discovery_control(p_value[known]) <= _RATE
    return significant


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
