"""Sightings whose class a detector got wrong: alone in their class where others agree on another.

Two defects of different classes may well lie at one place. Then each is seen by itself: in one photograph together, or
in several photographs each. A single sighting that meets no other of its class, where a group of two or more other
photographs sees one thing of the same extent at the same place, is taken for that thing, wrongly named.
"""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.deduplication.linkage import label_groups
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import ObservationPairs
from facadelake.deduplication.settings import MergeSettings

_HOST_OBSERVATIONS_MIN = 2  # sightings that outvote one
_OVERLAP_MIN = 0.5  # of the smaller patch


def assign_class_outliers(
    sightings: ObservationArrays, pairs: ObservationPairs, group: RowIndices, settings: MergeSettings
) -> RowIndices:
    """``group`` (n,) with strays in the groups that they belong to, numbered anew by first members."""
    size = np.bincount(group, minlength=1)
    alone = size[group] == 1
    other = sightings.defect_class[pairs.first] != sightings.defect_class[pairs.second]
    near = pairs.take(other & (pairs.sigmas <= settings.gate_sigma) & (pairs.overlap >= _OVERLAP_MIN))
    stray = np.r_[near.first, near.second]
    host = group[np.r_[near.second, near.first]]
    squared = np.r_[near.sigmas, near.sigmas] ** 2
    twin = size[group] == 2
    kept = (alone[stray] & (size[host] >= _HOST_OBSERVATIONS_MIN)) | (
        twin[stray] & (size[host] > _HOST_OBSERVATIONS_MIN)
    )
    stray, host, squared = stray[kept], host[kept], squared[kept]
    if len(stray) == 0:
        return group
    key, inverse, count = np.unique(stray * (group.max() + 1) + host, return_inverse=True, return_counts=True)
    mean = np.bincount(inverse, weights=squared) / count
    stray, host = np.divmod(key, group.max() + 1)
    several = int(sightings.photo.max()) + 1
    shown = np.isin(host * several + sightings.photo[stray], group * several + sightings.photo)
    free = np.flatnonzero((count >= settings.agreement * size[host]) & ~shown)
    # The nearest host of each stray, less twins that belong together; then the nearest stray of a host and photograph.
    free = free[np.lexsort((host[free], mean[free], stray[free]))]
    free = free[np.r_[True, np.diff(stray[free]) != 0][: len(free)]]
    free = free[~twin[stray[free]] | _find_split_pairs(pairs, group, stray[free], host[free], mean[free])]
    seat = host[free] * several + sightings.photo[stray[free]]
    order = np.lexsort((stray[free], mean[free], seat))
    free = free[order[np.r_[True, np.diff(seat[order]) != 0][: len(order)]]]
    # Those who agree stay the majority, however many strays there are.
    free = free[np.lexsort((stray[free], mean[free], host[free]))]
    starts = np.flatnonzero(np.r_[True, np.diff(host[free]) != 0][: len(free)])
    rank = np.arange(len(free)) - np.repeat(starts, np.diff(np.r_[starts, len(free)]))
    free = free[rank < size[host[free]] - 1]
    out = group.copy()
    out[stray[free]] = host[free]
    return label_groups(out)


def _find_split_pairs(
    pairs: ObservationPairs, group: RowIndices, stray: RowIndices, host: RowIndices, mean: Float64Array
) -> BoolArray:
    """Which strays (k,) are of a group of two that are nearer to two different hosts than to one another: neighbours
    of one class that were wrongly named alike."""
    count = int(group.max()) + 1
    inside = group[pairs.first] == group[pairs.second]
    apart = np.bincount(group[pairs.first[inside]], weights=pairs.sigmas[inside] ** 2, minlength=count)
    own = group[stray]
    nearer = mean < apart[own]
    low, high = np.full(count, count), np.full(count, -1)
    np.minimum.at(low, own[nearer], host[nearer])
    np.maximum.at(high, own[nearer], host[nearer])
    both = np.bincount(own[nearer], minlength=count) == 2
    parted: BoolArray = both[own] & (low[own] != high[own])
    return parted
