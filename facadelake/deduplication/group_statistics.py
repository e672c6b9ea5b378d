"""What the sightings of each group say together: the commonest word, the weighted median, the mean."""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import Float64Array, RowIndices


def find_most_common(group: RowIndices, word: RowIndices, weight: Float64Array, groups: int) -> RowIndices:
    """The commonest ``word`` (n,) of each of ``groups``; of equally common ones that with more ``weight``, then the
    lowest. A group without rows has -1."""
    key = group * (int(word.max(initial=0)) + 1) + word
    found, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    total = np.bincount(inverse, weights=weight, minlength=len(found))
    owner, name = np.divmod(found, int(word.max(initial=0)) + 1)
    order = np.lexsort((name, -total, -count, owner))
    leads = order[np.r_[True, np.diff(owner[order]) != 0][: len(order)]]
    out = np.full(groups, -1, dtype=np.int64)
    out[owner[leads]] = name[leads]
    return out


def compute_weighted_medians(group: RowIndices, value: Float64Array, weight: Float64Array, groups: int) -> Float64Array:
    """The weighted median (groups,) of the values (n,) that are not NaN; NaN for a group that has none."""
    rows = np.flatnonzero(np.isfinite(value))
    rows = rows[np.lexsort((value[rows], group[rows]))]
    out = np.full(groups, np.nan)
    if len(rows) == 0:
        return out
    owner, running = group[rows], np.cumsum(weight[rows])
    starts = np.flatnonzero(np.r_[True, np.diff(owner) != 0])
    ends = np.r_[starts[1:], len(rows)] - 1
    before = np.r_[0.0, running][starts]
    half = before + (running[ends] - before) / 2
    # The first value at which half the weight is reached; where it is reached exactly, the middle of it and the next.
    at = np.clip(np.searchsorted(running, half * (1 - 1e-12)), starts, ends)
    tie = np.abs(running[at] - half) <= 1e-9 * half
    beyond = np.where(tie, np.minimum(at + 1, ends), at)
    out[owner[starts]] = (value[rows[at]] + value[rows[beyond]]) / 2
    return out


def compute_maxima(group: RowIndices, value: Float64Array, groups: int) -> Float64Array:
    """The largest value (groups,) of each group; -inf for a group that has none."""
    out = np.full(groups, -np.inf)
    np.maximum.at(out, group, value)
    return out
