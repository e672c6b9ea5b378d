"""Table ``merges``: why nearby observations are one defect, or are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import BoolArray, Float64N, RowIndices
from facadelake.core.tables import check_table, get_stage_schema
from facadelake.deduplication.candidate_pairs import compute_observation_covariance, concatenate_pairs, measure_pairs
from facadelake.deduplication.clustering import Clustering
from facadelake.deduplication.group_statistics import find_most_common
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings
from schemas.vocabulary import MergeDecision, MergeReason

_JOINED_PAIRS = 1  # recorded per observation: the nearest of its defect
_APART_PAIRS = 2  # recorded per observation: the nearest of other defects


def build_merges_table(
    detection_ids: pa.Array,
    defect_ids: pa.Array,
    observations: ObservationArrays,
    clustering: Clustering,
    settings: MergeSettings,
) -> pa.Table:
    """Table ``merges`` of the pairs nearest to each observation, in its own defect and in others.

    A pair of one defect may be outside the gate: its group joined it. Other pairs, many more than observations, are not
    recorded.

    Args:
        detection_ids: detection (n,) of each observation.
        defect_ids: defect (n,) of each observation.
        observations: the observations (n).
        clustering: their groups and candidate pairs.
        settings: the gate.
    """
    clustering = _add_unpaired(observations, clustering, settings)
    pairs = clustering.pairs
    joined = clustering.group[pairs.first] == clustering.group[pairs.second]
    kept = np.flatnonzero(_select_nearest_pairs(pairs.first, pairs.second, pairs.sigmas, joined))
    first, second = pairs.first[kept], pairs.second[kept]
    reasons = np.array([str(reason) for reason in MergeReason])
    reason = _assign_reasons(observations, clustering, settings)[kept]
    score = clustering.score[kept]
    values = {
        "detection_id": detection_ids.take(pa.array(first)),
        "other_detection_id": detection_ids.take(pa.array(second)),
        "defect_id": defect_ids.take(pa.array(first)),
        "other_defect_id": defect_ids.take(pa.array(second)),
        "merge_decision": pa.array([str(MergeDecision.APART), str(MergeDecision.JOINED)]).take(
            pa.array(joined[kept].astype(np.int64))
        ),
        "merge_reason": pa.array(reasons.tolist()).take(pa.array(reason)),
        "separation_m": pa.array(pairs.separation_m[kept]),
        "mahalanobis_distance": pa.array(pairs.sigmas[kept]),
        "overlap_share": pa.array(pairs.overlap[kept]),
        "appearance_score": pa.array(np.clip(score, -1.0, 1.0), mask=np.isnan(score)),
    }
    schema = get_stage_schema("merges")
    return check_table("merges", pa.Table.from_arrays([values[field.name] for field in schema], schema=schema))


def _select_nearest_pairs(first: RowIndices, second: RowIndices, sigmas: Float64N, joined: BoolArray) -> BoolArray:
    """Which pairs are among the nearest of one of their observations, of joined and of separate pairs.

    Args:
        first: first rows (k,) of the pairs.
        second: their second rows (k,).
        sigmas: their Mahalanobis distances (k,).
        joined: which pairs (k,) are of one defect.
    """
    kept = np.zeros(len(first), dtype=bool)
    for of_kind, number in ((joined, _JOINED_PAIRS), (~joined, _APART_PAIRS)):
        rows = np.flatnonzero(of_kind & np.isfinite(sigmas) | of_kind & joined)
        node = np.r_[first[rows], second[rows]]
        order = np.lexsort((np.r_[rows, rows], np.r_[sigmas[rows], sigmas[rows]], node))
        starts = np.flatnonzero(np.r_[True, np.diff(node[order]) != 0][: len(order)])
        rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
        kept[np.r_[rows, rows][order[rank < number]]] = True
    return kept


def _add_unpaired(observations: ObservationArrays, clustering: Clustering, settings: MergeSettings) -> Clustering:
    """The clustering with a pair for each observation that only its group, and no pair, joined to its defect."""
    pairs, group = clustering.pairs, clustering.group
    joined = group[pairs.first] == group[pairs.second]
    paired = np.zeros(len(group), dtype=bool)
    paired[pairs.first[joined]] = paired[pairs.second[joined]] = True
    order = np.lexsort((np.arange(len(group)), ~paired, group))
    representative = order[np.r_[True, np.diff(group[order]) != 0][: len(order)]]
    unpaired = np.flatnonzero(~paired & (representative[group] != np.arange(len(group))))
    if len(unpaired) == 0:
        return clustering
    rows = np.sort(np.column_stack([representative[group[unpaired]], unpaired]), axis=1)
    added = measure_pairs(
        observations, rows, compute_observation_covariance(observations, clustering.gate), clustering.gate, settings
    )
    return replace(
        clustering,
        pairs=concatenate_pairs([pairs, added]),
        score=np.r_[clustering.score, np.full(len(unpaired), np.nan)],
        differs=np.r_[clustering.differs, np.zeros(len(unpaired), dtype=bool)],
    )


def _assign_reasons(observations: ObservationArrays, clustering: Clustering, settings: MergeSettings) -> RowIndices:
    """Reason (k,) of each pair as an index into ``MergeReason``; of several that hold, the last assigned decides."""
    pairs = clustering.pairs
    first, second = pairs.first, pairs.second
    index = {merge_reason: number for number, merge_reason in enumerate(MergeReason)}
    joined = clustering.group[first] == clustering.group[second]
    compared = np.isfinite(clustering.score)
    same_class = observations.defect_class[first] == observations.defect_class[second]
    reason = np.full(len(pairs), index[MergeReason.GROUP_DISAGREES], dtype=np.int64)
    for holds, merge_reason in (
        (clustering.differs, MergeReason.LOOKS_DIFFERENT),
        (~pairs.touching, MergeReason.NO_OVERLAP),
        (pairs.sigmas > settings.gate_sigma, MergeReason.TOO_FAR),
        (~same_class, MergeReason.OTHER_CLASS),
        (observations.photo[first] == observations.photo[second], MergeReason.SAME_PHOTOGRAPH),
    ):
        reason[holds & ~joined] = index[merge_reason]
    reason[joined] = index[MergeReason.GEOGRAPHY]
    reason[joined & compared & ~clustering.differs] = index[MergeReason.GEOGRAPHY_AND_IMAGE]
    group, defect_class = clustering.group, observations.defect_class
    is_outlier = (
        defect_class
        != find_most_common(group, defect_class, np.ones(len(defect_class)), int(group.max(initial=-1)) + 1)[group]
    )
    reason[joined & (is_outlier[first] | is_outlier[second])] = index[MergeReason.OUTVOTED]
    reason[joined & (clustering.unit[first] == clustering.unit[second])] = index[MergeReason.CUT_BY_SEAM]
    return reason
