"""Statistics of groups of observations: most common value, weighted median, maximum."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import Float64N, RowIndices


def find_most_common(group: RowIndices, value: RowIndices, weight: Float64N, groups: int) -> RowIndices:
    """The most common value of each group.

    Args:
        group: group (n,) of each row.
        value: value (n,) of each row, from 0.
        weight: weight (n,) of each row, which decides among equally common values; then the lowest value is taken.
        groups: number of groups.

    Returns:
        Values (groups,); -1 for a group without rows.
    """
    key = group * (int(value.max(initial=0)) + 1) + value
    found, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    total = np.bincount(inverse, weights=weight, minlength=len(found))
    owner, found_value = np.divmod(found, int(value.max(initial=0)) + 1)
    order = np.lexsort((found_value, -total, -count, owner))
    selected = order[np.r_[True, np.diff(owner[order]) != 0][: len(order)]]
    out = np.full(groups, -1, dtype=np.int64)
    out[owner[selected]] = found_value[selected]
    return out


def compute_weighted_medians(group: RowIndices, value: Float64N, weight: Float64N, groups: int) -> Float64N:
    """The weighted median of each group.

    Args:
        group: group (n,) of each row.
        value: value (n,) of each row; NaN is left out.
        weight: weight (n,) of each row.
        groups: number of groups.

    Returns:
        Medians (groups,); NaN for a group without values.
    """
    rows = np.flatnonzero(np.isfinite(value))
    rows = rows[np.lexsort((value[rows], group[rows]))]
    out = np.full(groups, np.nan)
    if len(rows) == 0:
        return out
    owner, cumulative = group[rows], np.cumsum(weight[rows])
    starts = np.flatnonzero(np.r_[True, np.diff(owner) != 0])
    ends = np.r_[starts[1:], len(rows)] - 1
    before = np.r_[0.0, cumulative][starts]
    half = before + (cumulative[ends] - before) / 2
    # The first value at which half the weight is reached; where it is reached exactly, the mean with the next value.
    lower = np.clip(np.searchsorted(cumulative, half * (1 - 1e-12)), starts, ends)
    is_tie = np.abs(cumulative[lower] - half) <= 1e-9 * half
    upper = np.where(is_tie, np.minimum(lower + 1, ends), lower)
    out[owner[starts]] = (value[rows[lower]] + value[rows[upper]]) / 2
    return out


def compute_maxima(group: RowIndices, value: Float64N, groups: int) -> Float64N:
    """The largest ``value`` (n,) of each of ``groups``; -inf for a group without rows."""
    out = np.full(groups, -np.inf)
    np.maximum.at(out, group, value)
    return out
