"""What the sightings of one crack say together about its width."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array, RowIndices
from facadelake.deduplication.group_statistics import compute_weighted_medians
from facadelake.deduplication.observations import read_column
from schemas.vocabulary import CrackWidthOutcome

_BLUR_SIGMAS = 2.0  # sigmas: a width so far above what a better photograph leaves room for is a coarse one's blur
_OUTCOMES = tuple(str(word) for word in CrackWidthOutcome)  # the best evidence first


@dataclass(frozen=True, kw_only=True, eq=False)
class CrackWidthEstimate:
    """Of g groups, in mm: width, largest, one sigma and limit (g,), NaN where there is none; ``outcome`` (g,) words."""

    width_mm: Float64Array
    width_max_mm: Float64Array
    sigma_mm: Float64Array
    limit_mm: Float64Array
    outcome: pa.Array


def estimate_crack_widths(seen: pa.Table, group: RowIndices, weight: Float64Array, groups: int) -> CrackWidthEstimate:
    """The widths of registered rows ``seen`` (n,) in ``group`` (n,), each sighting with ``weight`` (n,).

    What a person stated goes before what was measured. Measured widths are weighed by their variance; one that lies
    beyond the limit of a photograph that could not tell the width any more is left out, for it is no better than its
    blur. Where none is left, the smallest limit is the crack's upper bound. Sightings share what is wrong with blur and
    scale, so many of them are never surer than the best, and are less sure where they disagree.
    """
    names = ("crack_width_mm", "crack_width_max_mm", "crack_width_sigma_mm", "crack_width_limit_mm")
    width, largest, sigma, limit = (read_column(seen, name) for name in names)
    words = seen.column("crack_width_outcome").to_pylist()
    rank = np.array([_OUTCOMES.index(word) if word is not None else len(_OUTCOMES) for word in words], dtype=np.int64)
    stated, told, below = (
        rank == _OUTCOMES.index(word)
        for word in (CrackWidthOutcome.STATED, CrackWidthOutcome.MEASURED, CrackWidthOutcome.BELOW_LIMIT)
    )
    bound = _compute_minima(group, np.where(below, limit, np.nan), groups)
    with np.errstate(invalid="ignore"):
        coarse = told & (width - _BLUR_SIGMAS * sigma > bound[group])
    rank = np.where(coarse, len(_OUTCOMES), rank)
    told = told & ~coarse
    best = np.full(groups, len(_OUTCOMES), dtype=np.int64)
    np.minimum.at(best, group, rank)
    weighed = np.where(told, 1 / np.maximum(np.where(told, sigma, 1.0), 1e-6) ** 2, weight)
    counts = np.where(best[group] == rank, stated | told, False)
    chosen = np.where(counts, width, np.nan)
    middle = compute_weighted_medians(group, chosen, weighed, groups)
    return CrackWidthEstimate(
        width_mm=middle,
        width_max_mm=compute_weighted_medians(group, np.where(counts, largest, np.nan), weighed, groups),
        sigma_mm=_combine_sigmas(group, np.where(counts & told, width - middle[group], np.nan), sigma, weighed, groups),
        limit_mm=np.where(
            best == _OUTCOMES.index(CrackWidthOutcome.BELOW_LIMIT), bound, _compute_minima(group, limit, groups)
        ),
        outcome=pa.array([*_OUTCOMES, None], pa.string()).take(pa.array(best)),
    )


def _combine_sigmas(
    group: RowIndices, gap: Float64Array, sigma: Float64Array, weight: Float64Array, groups: int
) -> Float64Array:
    """One sigma (groups,): the smallest of the sightings', and their scatter over the root of their number."""
    used = np.isfinite(gap)
    owner = group[used]
    number = np.bincount(owner, minlength=groups)
    total = np.bincount(owner, weights=weight[used], minlength=groups)
    square = np.bincount(owner, weights=weight[used] * gap[used] ** 2, minlength=groups)
    with np.errstate(invalid="ignore", divide="ignore"):
        scatter = square / total / number
    out: Float64Array = np.sqrt(_compute_minima(group, np.where(used, sigma, np.nan), groups) ** 2 + scatter)
    return out


def _compute_minima(group: RowIndices, value: Float64Array, groups: int) -> Float64Array:
    """The smallest value (groups,) that is not NaN; NaN where there is none."""
    out = np.full(groups, np.inf)
    np.minimum.at(out, group, np.where(np.isfinite(value), value, np.inf))
    return np.where(np.isfinite(out), out, np.nan)
