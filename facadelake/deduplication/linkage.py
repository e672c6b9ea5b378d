"""Sightings to defects: Algorithm 1 corrected, over all sightings at once.

The paper's Algorithm 1 walks through the detections and calls one new if it is far from *any* earlier defect; with two
defects on a wall every further sighting is far from one of them, so it becomes new again. A sighting is new only if it
is far from *all*. And as the result of a walk depends on its order, groups that are each other's nearest join, round
after round, whatever the order of the rows: average linkage by reciprocal neighbours (Murtagh 1983, Computer Journal
26(4)), with whole arrays a round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array, RowIndices


@dataclass(frozen=True, kw_only=True, eq=False)
class _GroupLinks:
    """Pairs of groups ``low`` < ``high`` (k,): sum of squared distances and number of the pairs of sightings between
    them that lie in the gate, and whether the two may never join."""

    low: RowIndices
    high: RowIndices
    squared: Float64Array
    count: Float64Array
    barred: BoolArray

    def merge_groups(self, group: RowIndices) -> _GroupLinks:
        """The links after groups were renamed to ``group[...]`` (n,): inside one group gone, parallel ones added up."""
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
    sigmas: Float64Array,
    photo: RowIndices,
    *,
    agreement: float,
    gate_sigma: float,
) -> Int64Array:
    """Group (n,) of each sighting, named by its first member's row.

    ``first``, ``second`` (k,): pairs of sightings that may be one, ``sigmas`` (k,) apart. Two groups join only if they
    share no photograph (``photo`` (n,)) and at least ``agreement`` of the pairs between them are among those given, so
    that a chain of neighbours does not become one defect. A pair that is not given counts as twice the gate apart.
    """
    group = np.arange(len(photo))
    size = np.ones(len(photo))
    apart = photo[first] == photo[second]
    links = _GroupLinks(
        low=first, high=second, squared=sigmas**2, count=np.where(apart, 0.0, 1.0), barred=apart
    ).merge_groups(group)
    while True:
        pairs = size[links.low] * size[links.high]
        mean = (links.squared + (pairs - links.count) * (2 * gate_sigma) ** 2) / pairs
        free = np.flatnonzero(~links.barred & (links.count >= agreement * pairs))
        chosen = free[_find_reciprocal_neighbours(links.low[free], links.high[free], mean[free], len(photo))]
        if len(chosen) == 0:
            return group
        clashing = _find_photo_conflicts(group, photo, links.low[chosen], links.high[chosen])
        links.barred[chosen[clashing]] = True
        joining = chosen[~clashing]
        into = np.arange(len(photo))
        into[links.high[joining]] = links.low[joining]
        size[links.low[joining]] += size[links.high[joining]]
        group = into[group]
        links = links.merge_groups(into)


def label_groups(group: RowIndices) -> Int64Array:
    """Groups (n,) as numbers from 0, in the order of their first members."""
    _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
    place = np.empty(len(first), dtype=np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    return np.asarray(place[inverse], dtype=np.int64)


def _find_reciprocal_neighbours(low: RowIndices, high: RowIndices, mean: Float64Array, count: int) -> BoolArray:
    """Which links (k,) are the nearest of both their groups; of equally near ones the first by name."""
    nearest, best = np.full(count, np.inf), np.full(count, count, dtype=np.int64)
    np.minimum.at(nearest, low, mean)
    np.minimum.at(nearest, high, mean)
    for node, other in ((low, high), (high, low)):
        leads = mean == nearest[node]
        np.minimum.at(best, node[leads], other[leads])
    mutual: BoolArray = (best[low] == high) & (best[high] == low)
    return mutual


def _find_photo_conflicts(group: RowIndices, photo: RowIndices, low: RowIndices, high: RowIndices) -> BoolArray:
    """Which of the joins (k,) would bring two sightings of one photograph together; each group joins once."""
    join = np.full(len(group), -1, dtype=np.int64)
    join[low], join[high] = np.arange(len(low)), np.arange(len(low))
    of_row = join[group]
    rows = np.flatnonzero(of_row >= 0)
    rows = rows[np.lexsort((photo[rows], of_row[rows]))]
    twice = (np.diff(of_row[rows]) == 0) & (np.diff(photo[rows]) == 0)
    clashing = np.zeros(len(low), dtype=bool)
    clashing[of_row[rows[1:][twice]]] = True
    return clashing
