"""Change of size between campaigns, with its standard error, and whether it is significant.

Sizes are compared as logarithms. Their sigmas come from what is known of a sighting (its pixels, and the jitter of
boxes by the scatter within a campaign) and of a campaign's views of a wall. How far these errors repeat in the next
campaign they do not tell: most defects did not change between two campaigns, and the scatter of their changes scales
the sigmas, up or down, as the variance factor does in an adjustment. Blur that no photograph tells is common to the
campaigns: it changes a width by the difference of the sizes of their pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.stats import false_discovery_control, norm, t

from facadelake.core.arrays import BoolArray, Float64N, RowIndices

_RATE = 0.02  # of false discoveries among the changes called significant
_SINGLE_SIGMA = 0.10  # of the logarithm of an extent seen once, where a campaign has no repeated sightings
_MAD_TO_SIGMA = 1.4826
_PAIRS_MIN = 8
_CHANGED_SIGMA = 0.35  # of the logarithm of the change of those that changed
_PRIOR_PAIRS = 10.0  # that the stated sigmas count for: few defects move the scale little
_SCALE_MIN = 0.5  # the stated sigmas are not wrong by more than a factor of two, however well a few defects repeat


@dataclass(frozen=True, kw_only=True, eq=False)
class DefectSizes:
    """A size of each defect (n,) as a logarithm, with one sigma; NaN where it was not measured.

    ``per_blur_px``: by how much, in the size's unit, each grows with one pixel of blur that the photographs do not tell
    (a width: the size of the pixel on the wall), and ``blur_px`` one sigma of that blur. They are no part of ``sigma``:
    the blur is common to the campaigns of a building.
    """

    log_size: Float64N
    sigma: Float64N
    per_blur_px: Float64N
    blur_px: Float64N

    @property
    def common(self) -> Float64N:
        """One sigma (n,) of each size, in its unit, by the blur."""
        return self.per_blur_px * self.blur_px

    def take(self, rows: RowIndices) -> DefectSizes:
        """Some of the defects."""
        return DefectSizes(**{field.name: getattr(self, field.name)[rows] for field in fields(DefectSizes)})


def concatenate_sizes(parts: Sequence[DefectSizes]) -> DefectSizes:
    """The sizes of all parts, at least one, in their order."""
    return DefectSizes(**{f.name: np.concatenate([getattr(one, f.name) for one in parts]) for f in fields(DefectSizes)})


def summarise_sizes(log_size: Float64N, pixel_sigma: Float64N, defect: RowIndices, count: int) -> DefectSizes:
    """The median size of each defect's sightings, with one sigma.

    A sighting's error has a part that is known, from its pixels, and the jitter of its box as a share of the extent.
    The jitter is what the scatter within defects has beyond the pixels, pooled over the campaign, since most defects
    have few sightings.

    Args:
        log_size: logarithm (n,) of the size of each sighting.
        pixel_sigma: one sigma (n,) of it by the sighting's pixels.
        defect: row (n,) of its defect.
        count: number of defects.

    Returns:
        The sizes (count,).
    """
    sightings = np.bincount(defect, minlength=count)
    median = compute_medians(log_size, defect, count)
    repeated = sightings[defect] >= 3
    jitter_variance = _SINGLE_SIGMA**2
    if np.count_nonzero(repeated) >= _PAIRS_MIN:
        share = np.sqrt(sightings[defect] / np.maximum(sightings[defect] - 1.0, 1.0))
        scatter = _MAD_TO_SIGMA * float(np.median(np.abs(log_size - median[defect])[repeated] * share[repeated]))
        jitter_variance = max(scatter**2 - float(np.median(pixel_sigma[repeated] ** 2)), 0.0)
    variance = np.bincount(defect, weights=pixel_sigma**2 + jitter_variance, minlength=count)
    # The median of n has pi / 2 times the variance of the mean; of two it is the mean.
    efficiency = np.where(sightings >= 3, np.sqrt(np.pi / 2), 1.0)
    sigma = efficiency * np.sqrt(variance) / np.maximum(sightings, 1)
    return DefectSizes(
        log_size=median,
        sigma=np.where(sightings > 0, sigma, np.nan),
        per_blur_px=np.zeros(count),
        blur_px=np.zeros(count),
    )


def compute_medians(value: Float64N, defect: RowIndices, count: int) -> Float64N:
    """Median (count,) of the values (n,) of each defect; NaN where it has none."""
    number = np.bincount(defect, minlength=count)
    ordered = value[np.lexsort((value, defect))]
    first = np.concatenate([[0], np.cumsum(number)[:-1]])
    median = np.full(count, np.nan)
    has = number > 0
    low, high = first + (number - 1) // 2, first + number // 2
    median[has] = (ordered[low[has]] + ordered[high[has]]) / 2
    return median


@dataclass(frozen=True, kw_only=True, eq=False)
class SizeChange:
    """Changes (k) of the logarithm of a size: ``log_change`` with ``sigma``, NaN where a size is missing.

    ``sigma_before``, ``sigma_after``: the parts of it that are errors of either size, ``sigma_common`` the part that
    both have in common. ``scale``: factor on the stated sigmas that the unchanged defects show, from ``freedom``
    degrees of freedom; all sigmas have it.
    """

    log_change: Float64N
    sigma: Float64N
    sigma_before: Float64N
    sigma_after: Float64N
    sigma_common: Float64N
    scale: float
    freedom: float

    @property
    def p_value(self) -> Float64N:
        """Probability (k,) of such a change, or a larger one, of a defect that did not change; NaN where unknown."""
        p: Float64N = 2 * t.sf(np.abs(self.log_change) / self.sigma, self.freedom)
        return p


def compare_sizes(before: DefectSizes, after: DefectSizes) -> SizeChange:
    """Changes of k defects between two campaigns, of which the larger unknown blur counts."""
    change = after.log_size - before.log_size
    mean = (np.exp(before.log_size) + np.exp(after.log_size)) / 2
    common = np.maximum(before.blur_px, after.blur_px) * np.abs(after.per_blur_px - before.per_blur_px) / mean
    sigma = np.sqrt(before.sigma**2 + after.sigma**2 + common**2)
    known = np.isfinite(change) & np.isfinite(sigma) & (sigma > 0)
    scale = _estimate_scale(change[known], sigma[known]) if np.count_nonzero(known) >= _PAIRS_MIN else 1.0
    factor = np.where(known, scale, np.nan)
    return SizeChange(
        log_change=np.where(known, change, np.nan),
        sigma=factor * sigma,
        sigma_before=factor * before.sigma,
        sigma_after=factor * after.sigma,
        sigma_common=factor * common,
        scale=scale,
        freedom=_PRIOR_PAIRS + np.count_nonzero(known),
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
    """Factor on ``sigma`` (k,) that the changes of the unchanged defects show.

    The changes are a mixture of unchanged defects and of changed ones; expectation-maximisation tells them apart.
    """
    scale, unchanged = 1.0, 0.8
    for _ in range(20):
        narrow = unchanged * norm.pdf(change, scale=scale * sigma)
        wide = (1 - unchanged) * norm.pdf(change, scale=np.hypot(scale * sigma, _CHANGED_SIGMA))
        share = narrow / np.maximum(narrow + wide, 1e-300)
        scale = float(np.sqrt((np.sum(share * (change / sigma) ** 2) + _PRIOR_PAIRS) / (share.sum() + _PRIOR_PAIRS)))
        unchanged = float((share.sum() + 4) / (len(change) + 5))
    return max(_SCALE_MIN, scale)
