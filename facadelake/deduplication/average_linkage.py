"""Average linkage of observations, with the constraint that a group has one observation per photograph.

The paper's Algorithm 1 visits the detections in order and counts one as new if it is far from *any* earlier defect;
with two defects on a wall every further observation is far from one of them and counts as new again. An observation is
new only if it is far from *all*. As the result of a sequential algorithm depends on the order, groups that are
reciprocal nearest neighbours are joined, iteration by iteration, independently of the order of the rows (Murtagh 1983,
Computer Journal 26(4)), on whole arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64N, RowIndices


@dataclass(frozen=True, kw_only=True, eq=False)
class _GroupLinks:
    """Links between groups ``low`` < ``high`` (k,).

    ``squared`` (k,) and ``count`` (k,): sum of squared Mahalanobis distances and number of the pairs of observations
    between the two groups that are in the gate; ``barred`` (k,): the two may not join.
    """

    low: RowIndices
    high: RowIndices
    squared: Float64N
    count: Float64N
    barred: BoolArray

    def merge_groups(self, group: RowIndices) -> _GroupLinks:
        """The links after groups are replaced by ``group`` (n,).

        Links inside one group are removed, parallel ones added up.
        """
        low, high = group[self.low], group[self.high]
        low, high = np.minimum(low, high), np.maximum(low, high)
        kept = np.flatnonzero(low != high)
        key = low[kept] * len(group) + high[kept]
        order = np.argsort(key, kind="stable")
        kept, key = kept[order], key[order]
        low, high = low[kept], high[kept]
        starts = np.flatnonzero(np.r_[True, np.diff(key) != 0][: len(key)])
        if len(starts) == 0:
            return _GroupLinks(
                low=low, high=high, squared=np.zeros(0), count=np.zeros(0), barred=np.zeros(0, dtype=bool)
            )
        return _GroupLinks(
            low=low[starts],
            high=high[starts],
            squared=np.add.reduceat(self.squared[kept], starts),
            count=np.add.reduceat(self.count[kept], starts),
            barred=np.logical_or.reduceat(self.barred[kept], starts),
        )


def cluster_by_average_linkage(
    first: RowIndices,
    second: RowIndices,
    sigmas: Float64N,
    photo: RowIndices,
    *,
    agreement: float,
    gate_sigma: float,
) -> RowIndices:
    """Group observations by average linkage.

    Two groups join only if they have no photograph in common and at least ``agreement`` of the pairs between them are
    given, so that a chain of neighbours does not become one defect. A pair that is not given counts as twice the gate.

    Args:
        first: first rows (k,) of pairs in the gate.
        second: their second rows (k,).
        sigmas: their Mahalanobis distances (k,).
        photo: photograph (n,) of each observation.
        agreement: share of the pairs between two groups that must be in the gate.
        gate_sigma: the gate.

    Returns:
        Group (n,) of each observation, named by the row of its first member.
    """
    group = np.arange(len(photo))
    size = np.ones(len(photo))
    same_photo = photo[first] == photo[second]
    links = _GroupLinks(
        low=first, high=second, squared=sigmas**2, count=np.where(same_photo, 0.0, 1.0), barred=same_photo
    ).merge_groups(group)
    while True:
        pairs = size[links.low] * size[links.high]
        mean = (links.squared + (pairs - links.count) * (2 * gate_sigma) ** 2) / pairs
        allowed = np.flatnonzero(~links.barred & (links.count >= agreement * pairs))
        selected = allowed[
            _find_reciprocal_neighbours(links.low[allowed], links.high[allowed], mean[allowed], len(photo))
        ]
        if len(selected) == 0:
            return group
        conflicting = _find_photo_conflicts(group, photo, links.low[selected], links.high[selected])
        links.barred[selected[conflicting]] = True
        accepted = selected[~conflicting]
        target = np.arange(len(photo))
        target[links.high[accepted]] = links.low[accepted]
        size[links.low[accepted]] += size[links.high[accepted]]
        group = target[group]
        links = links.merge_groups(target)


def label_groups(group: RowIndices) -> RowIndices:
    """Groups (n,) as labels from 0, in the order of their first members."""
    _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
    label = np.empty(len(first), dtype=np.int64)
    label[np.argsort(first)] = np.arange(len(first))
    return np.asarray(label[inverse], dtype=np.int64)


def _find_reciprocal_neighbours(low: RowIndices, high: RowIndices, mean: Float64N, count: int) -> BoolArray:
    """Which links are the nearest of both their groups; of equally near ones that of the lowest group.

    Args:
        low: first groups (k,) of the links.
        high: second groups (k,).
        mean: mean squared distances (k,).
        count: number of groups.
    """
    nearest, best = np.full(count, np.inf), np.full(count, count, dtype=np.int64)
    np.minimum.at(nearest, low, mean)
    np.minimum.at(nearest, high, mean)
    for node, other in ((low, high), (high, low)):
        is_nearest = mean == nearest[node]
        np.minimum.at(best, node[is_nearest], other[is_nearest])
    reciprocal: BoolArray = (best[low] == high) & (best[high] == low)
    return reciprocal


def _find_photo_conflicts(group: RowIndices, photo: RowIndices, low: RowIndices, high: RowIndices) -> BoolArray:
    """Which joins of groups would have two observations of one photograph; a group is in one join at most.

    Args:
        group: group (n,) of each observation.
        photo: photograph (n,) of each observation.
        low: first groups (k,) of the joins.
        high: second groups (k,).
    """
    join = np.full(len(group), -1, dtype=np.int64)
    join[low], join[high] = np.arange(len(low)), np.arange(len(low))
    join_of_row = join[group]
    rows = np.flatnonzero(join_of_row >= 0)
    rows = rows[np.lexsort((photo[rows], join_of_row[rows]))]
    repeated = (np.diff(join_of_row[rows]) == 0) & (np.diff(photo[rows]) == 0)
    conflicting = np.zeros(len(low), dtype=bool)
    conflicting[join_of_row[rows[1:][repeated]]] = True
    return conflicting
