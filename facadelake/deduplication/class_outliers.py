"""Class outliers: observations whose class the detector got wrong.

Two defects of different classes may be at one position. Then each is observed independently: both in one photograph, or
each in several. A single observation without another of its class, where a group of two or more other photographs has
one defect of the same extent at the same position, is taken for an observation of that defect.
"""

from __future__ import annotations

import numpy as np

from facadelake.core.arrays import BoolArray, Float64N, RowIndices
from facadelake.deduplication.average_linkage import label_groups
from facadelake.deduplication.candidate_pairs import ObservationPairs
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings

_HOST_OBSERVATIONS_MIN = 2  # of the group that outvotes a single observation
_OVERLAP_MIN = 0.5  # of the smaller patch


def assign_class_outliers(
    observations: ObservationArrays, pairs: ObservationPairs, group: RowIndices, settings: MergeSettings
) -> RowIndices:
    """Assign class outliers to the groups that outvote them.

    Args:
        observations: the observations (n).
        pairs: their candidate pairs, of all classes.
        group: group (n,) of each observation.
        settings: gate and agreement.

    Returns:
        Groups (n,), labelled anew in the order of their first members.
    """
    size = np.bincount(group, minlength=1)
    is_single = size[group] == 1
    other_class = observations.defect_class[pairs.first] != observations.defect_class[pairs.second]
    near = pairs.take(other_class & (pairs.sigmas <= settings.gate_sigma) & (pairs.overlap >= _OVERLAP_MIN))
    outlier = np.r_[near.first, near.second]
    host = group[np.r_[near.second, near.first]]
    squared = np.r_[near.sigmas, near.sigmas] ** 2
    is_pair = size[group] == 2
    kept = (is_single[outlier] & (size[host] >= _HOST_OBSERVATIONS_MIN)) | (
        is_pair[outlier] & (size[host] > _HOST_OBSERVATIONS_MIN)
    )
    outlier, host, squared = outlier[kept], host[kept], squared[kept]
    if len(outlier) == 0:
        return group
    key, inverse, count = np.unique(outlier * (group.max() + 1) + host, return_inverse=True, return_counts=True)
    mean = np.bincount(inverse, weights=squared) / count
    outlier, host = np.divmod(key, group.max() + 1)
    photo_count = int(observations.photo.max()) + 1
    photo_taken = np.isin(host * photo_count + observations.photo[outlier], group * photo_count + observations.photo)
    candidate = np.flatnonzero((count >= settings.agreement * size[host]) & ~photo_taken)
    # The nearest host of each outlier, except pairs that belong together; then the nearest outlier of a host and
    # photograph.
    candidate = candidate[np.lexsort((host[candidate], mean[candidate], outlier[candidate]))]
    candidate = candidate[np.r_[True, np.diff(outlier[candidate]) != 0][: len(candidate)]]
    candidate = candidate[
        ~is_pair[outlier[candidate]]
        | _find_split_pairs(pairs, group, outlier[candidate], host[candidate], mean[candidate])
    ]
    host_photo = host[candidate] * photo_count + observations.photo[outlier[candidate]]
    order = np.lexsort((outlier[candidate], mean[candidate], host_photo))
    candidate = candidate[order[np.r_[True, np.diff(host_photo[order]) != 0][: len(order)]]]
    # The class of the host keeps the majority, however many outliers there are.
    candidate = candidate[np.lexsort((outlier[candidate], mean[candidate], host[candidate]))]
    starts = np.flatnonzero(np.r_[True, np.diff(host[candidate]) != 0][: len(candidate)])
    rank = np.arange(len(candidate)) - np.repeat(starts, np.diff(np.r_[starts, len(candidate)]))
    candidate = candidate[rank < size[host[candidate]] - 1]
    out = group.copy()
    out[outlier[candidate]] = host[candidate]
    return label_groups(out)


def _find_split_pairs(
    pairs: ObservationPairs, group: RowIndices, outlier: RowIndices, host: RowIndices, mean: Float64N
) -> BoolArray:
    """Which outliers are of a group of two whose members are nearer to two different hosts than to one another.

    They are neighbours of one class that were both given the same wrong class.

    Args:
        pairs: the candidate pairs of observations.
        group: group (n,) of each observation.
        outlier: rows (k,) of the outliers.
        host: groups (k,) that they are near.
        mean: mean squared Mahalanobis distances (k,) from the host.
    """
    count = int(group.max()) + 1
    inside = group[pairs.first] == group[pairs.second]
    pair_distance = np.bincount(group[pairs.first[inside]], weights=pairs.sigmas[inside] ** 2, minlength=count)
    own_group = group[outlier]
    nearer = mean < pair_distance[own_group]
    low, high = np.full(count, count), np.full(count, -1)
    np.minimum.at(low, own_group[nearer], host[nearer])
    np.maximum.at(high, own_group[nearer], host[nearer])
    both_nearer = np.bincount(own_group[nearer], minlength=count) == 2
    split: BoolArray = both_nearer[own_group] & (low[own_group] != high[own_group])
    return split
