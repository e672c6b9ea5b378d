"""The second word on doubtful pairs: what the pictures say where places alone leave it open.

Doubtful are pairs of one defect near the gate's edge, and pairs near one another that the places left apart though no
photograph shows both. A few of each are compared, for reading photographs is dear, and the majority of them decides:
pairs that differ count as outside the gate, groups that show the same as well inside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.deduplication.appearance import AppearanceScore
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import ObservationPairs, PositionNoise
from facadelake.deduplication.settings import MergeSettings

_GATE_EDGE = 0.75  # of the gate: joined pairs further apart are looked at
_PAIRS_EACH = 3  # pairs compared between two groups, and in one
_PAIRS_MAX = 10_000  # compared at most, the nearest first
_CONFIRMED_GATE = 0.5  # of the gate: how near those count whose pictures say that they are one

Compare = Callable[[ObservationArrays, RowIndices, RowIndices, Float64Array], AppearanceScore]


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedPairs:
    """``pairs`` as the pictures have them, and of each its ``score`` (k,), NaN where not compared, and whether it
    ``differs`` (k,)."""

    pairs: ObservationPairs
    score: Float64Array
    differs: BoolArray


def build_uncompared_pairs(pairs: ObservationPairs) -> ComparedPairs:
    """The pairs by their places alone."""
    no = np.zeros(len(pairs), dtype=bool)
    return ComparedPairs(pairs=pairs, score=np.full(len(pairs), np.nan), differs=no)


def compare_ambiguous_pairs(
    sightings: ObservationArrays,
    pairs: ObservationPairs,
    group: RowIndices,
    gate: PositionNoise,
    settings: MergeSettings,
    compare: Compare,
) -> ComparedPairs:
    """The pairs of sightings in ``group`` (n,), the doubtful ones compared."""
    alike = (sightings.defect_class[pairs.first] == sightings.defect_class[pairs.second]) & (
        sightings.photo[pairs.first] != sightings.photo[pairs.second]
    )
    a, b = group[pairs.first], group[pairs.second]
    case = np.minimum(a, b) * (int(group.max(initial=0)) + 1) + np.maximum(a, b)
    edge = alike & (a == b) & (pairs.sigmas >= _GATE_EDGE * settings.gate_sigma)
    rival = np.flatnonzero(alike & (a != b) & pairs.touching)
    rival = rival[~_share_photograph(sightings.photo, group, a[rival], b[rival])]
    looked = np.r_[_select_first(case, np.flatnonzero(edge), -pairs.sigmas), _select_first(case, rival, pairs.sigmas)]
    looked = np.sort(looked[np.argsort(pairs.sigmas[looked], kind="stable")][:_PAIRS_MAX])
    out = build_uncompared_pairs(pairs)
    if len(looked) == 0:
        return out
    extent = np.maximum(sightings.width_m, sightings.height_m)
    i, j = pairs.first[looked], pairs.second[looked]
    # Where a defect lies in its boxes is not touched by poses and relief: boxes alone vary. A bad box still meets its
    # defect, so one thing is found no further aside than half the smaller box.
    vary = settings.gate_sigma * np.sqrt(2) * gate.size_share * np.maximum(extent[i], extent[j])
    tolerance = np.maximum(vary, np.minimum(extent[i], extent[j]) / 2)
    found = compare(sightings, i, j, tolerance)
    _, number = np.unique(case[looked], return_inverse=True)
    same = np.bincount(number, weights=found.same)
    other = np.bincount(number, weights=found.differs)
    score, differs = out.score.copy(), out.differs.copy()
    score[looked], differs[looked] = found.score, found.differs
    away = np.zeros(len(pairs), dtype=bool)
    away[looked] = found.differs & (other > same)[number]
    welcome = np.isin(case, np.unique(case[looked[(same > other)[number]]])) & (a != b) & alike & ~away
    sigmas = np.where(away, np.inf, pairs.sigmas)
    return ComparedPairs(
        pairs=replace(
            pairs,
            sigmas=np.where(welcome, np.minimum(sigmas, _CONFIRMED_GATE * settings.gate_sigma), sigmas),
            touching=pairs.touching | welcome,
        ),
        score=score,
        differs=differs,
    )


def _share_photograph(photo: RowIndices, group: RowIndices, a: RowIndices, b: RowIndices) -> BoolArray:
    """Whether the groups ``a`` and ``b`` (k,) have a photograph in common."""
    shape = (int(group.max(initial=0)) + 1, int(photo.max(initial=0)) + 1)
    shown = csr_array((np.ones(len(group)), (group, photo)), shape=shape)
    common: BoolArray = np.asarray(shown[a].multiply(shown[b]).sum(axis=1)).ravel() > 0
    return common


def _select_first(case: RowIndices, rows: RowIndices, order: Float64Array) -> RowIndices:
    """Of ``rows``, the first ``_PAIRS_EACH`` of each case by ``order``."""
    ranked = rows[np.lexsort((rows, order[rows], case[rows]))]
    starts = np.flatnonzero(np.r_[True, np.diff(case[ranked]) != 0][: len(ranked)])
    rank = np.arange(len(ranked)) - np.repeat(starts, np.diff(np.r_[starts, len(ranked)]))
    return ranked[rank < _PAIRS_EACH]
