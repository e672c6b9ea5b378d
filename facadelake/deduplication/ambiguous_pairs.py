"""Comparison of ambiguous pairs of observations by appearance.

Ambiguous are pairs of one defect near the gate's edge, and nearby pairs of different groups that have no photograph in
common. As reading photographs is expensive, a few pairs of each case are compared and their majority decides: pairs
that differ count as outside the gate, groups that look the same as inside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, RowIndices
from facadelake.deduplication.appearance import AppearanceScore
from facadelake.deduplication.candidate_pairs import ObservationPairs, PositionNoise
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings

_GATE_EDGE = 0.75  # of the gate: joined pairs farther apart are ambiguous
_PAIRS_EACH = 3  # pairs compared per case: two groups, or one
_PAIRS_MAX = 10_000  # maximum number of pairs compared; the nearest first
_CONFIRMED_GATE = 0.5  # of the gate: distance assigned to pairs that look the same

Compare = Callable[[ObservationArrays, RowIndices, RowIndices, Float64Array], AppearanceScore]


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedPairs:
    """``pairs`` with distances as appearance corrects them.

    ``score`` (k,): correlation, NaN where not compared; ``differs`` (k,): they look different.
    """

    pairs: ObservationPairs
    score: Float64N
    differs: BoolArray


def build_uncompared_pairs(pairs: ObservationPairs) -> ComparedPairs:
    """The pairs with distances of position alone."""
    none_differ = np.zeros(len(pairs), dtype=bool)
    return ComparedPairs(pairs=pairs, score=np.full(len(pairs), np.nan), differs=none_differ)


def compare_ambiguous_pairs(
    observations: ObservationArrays,
    pairs: ObservationPairs,
    group: RowIndices,
    gate: PositionNoise,
    settings: MergeSettings,
    compare: Compare,
) -> ComparedPairs:
    """Compare the ambiguous pairs by appearance.

    Args:
        observations: the observations (n).
        pairs: candidate pairs of them.
        group: group (n,) of each observation, by position alone.
        gate: noise of the gate.
        settings: the gate.
        compare: scores pairs by appearance.

    Returns:
        The pairs, with infinite distance where they look different, and a small one where their groups look the same.
    """
    comparable = (observations.defect_class[pairs.first] == observations.defect_class[pairs.second]) & (
        observations.photo[pairs.first] != observations.photo[pairs.second]
    )
    a, b = group[pairs.first], group[pairs.second]
    case = np.minimum(a, b) * (int(group.max(initial=0)) + 1) + np.maximum(a, b)
    near_edge = comparable & (a == b) & (pairs.sigmas >= _GATE_EDGE * settings.gate_sigma)
    competing = np.flatnonzero(comparable & (a != b) & pairs.touching)
    competing = competing[~_share_photograph(observations.photo, group, a[competing], b[competing])]
    selected = np.r_[
        _select_first(case, np.flatnonzero(near_edge), -pairs.sigmas), _select_first(case, competing, pairs.sigmas)
    ]
    selected = np.sort(selected[np.argsort(pairs.sigmas[selected], kind="stable")][:_PAIRS_MAX])
    out = build_uncompared_pairs(pairs)
    if len(selected) == 0:
        return out
    extent = np.maximum(observations.width_m, observations.height_m)
    i, j = pairs.first[selected], pairs.second[selected]
    # Poses and relief do not affect the position of a defect in its boxes; only the boxes vary. Even a poor box
    # overlaps its defect, so one defect is found no farther from the centre than half the smaller box.
    box_sigma = settings.gate_sigma * np.sqrt(2) * gate.size_share * np.maximum(extent[i], extent[j])
    tolerance = np.maximum(box_sigma, np.minimum(extent[i], extent[j]) / 2)
    appearance = compare(observations, i, j, tolerance)
    _, case_number = np.unique(case[selected], return_inverse=True)
    same_count = np.bincount(case_number, weights=appearance.same)
    differs_count = np.bincount(case_number, weights=appearance.differs)
    score, differs = out.score.copy(), out.differs.copy()
    score[selected], differs[selected] = appearance.score, appearance.differs
    separated = np.zeros(len(pairs), dtype=bool)
    separated[selected] = appearance.differs & (differs_count > same_count)[case_number]
    confirmed = (
        np.isin(case, np.unique(case[selected[(same_count > differs_count)[case_number]]]))
        & (a != b)
        & comparable
        & ~separated
    )
    sigmas = np.where(separated, np.inf, pairs.sigmas)
    return ComparedPairs(
        pairs=replace(
            pairs,
            sigmas=np.where(confirmed, np.minimum(sigmas, _CONFIRMED_GATE * settings.gate_sigma), sigmas),
            touching=pairs.touching | confirmed,
        ),
        score=score,
        differs=differs,
    )


def _share_photograph(photo: RowIndices, group: RowIndices, a: RowIndices, b: RowIndices) -> BoolArray:
    """Whether two groups have a photograph in common.

    Args:
        photo: photograph (n,) of each observation.
        group: group (n,) of each observation.
        a: groups (k,).
        b: groups (k,).
    """
    shape = (int(group.max(initial=0)) + 1, int(photo.max(initial=0)) + 1)
    photos_of_group = csr_array((np.ones(len(group)), (group, photo)), shape=shape)
    common: BoolArray = np.asarray(photos_of_group[a].multiply(photos_of_group[b]).sum(axis=1)).ravel() > 0
    return common


def _select_first(case: RowIndices, rows: RowIndices, order: Float64Array) -> RowIndices:
    """The first ``_PAIRS_EACH`` of ``rows`` of each ``case``, in ascending ``order``."""
    ranked = rows[np.lexsort((rows, order[rows], case[rows]))]
    starts = np.flatnonzero(np.r_[True, np.diff(case[ranked]) != 0][: len(ranked)])
    rank = np.arange(len(ranked)) - np.repeat(starts, np.diff(np.r_[starts, len(ranked)]))
    return ranked[rank < _PAIRS_EACH]
