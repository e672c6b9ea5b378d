"""Table ``merges``: why sightings near one another are one defect, or are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.core.tables import check_table, get_stage_schema
from facadelake.deduplication.clustering import Clustering
from facadelake.deduplication.group_statistics import find_most_common
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import compute_observation_covariance, concatenate_pairs, measure_pairs
from facadelake.deduplication.settings import MergeSettings
from schemas.vocabulary import MergeDecision, MergeReason

_JOINED_PAIRS = 1  # pairs that are kept for each sighting: its nearest companion in the defect
_APART_PAIRS = 2  # and the nearest of other defects


def build_merges_table(
    detection_ids: pa.Array,
    defect_ids: pa.Array,
    sightings: ObservationArrays,
    grouping: Clustering,
    settings: MergeSettings,
) -> pa.Table:
    """Table ``merges`` of the pairs nearest to each sighting: in its own defect, and in others.

    ``detection_ids`` and ``defect_ids`` (n,) are the sightings'. Not every pair, of which there are many more than
    sightings. A pair of one defect that lies outside the gate is there by its group.
    """
    grouping = _add_unpaired(sightings, grouping, settings)
    pairs = grouping.pairs
    joined = grouping.group[pairs.first] == grouping.group[pairs.second]
    kept = np.flatnonzero(_select_nearest_pairs(pairs.first, pairs.second, pairs.sigmas, joined))
    first, second = pairs.first[kept], pairs.second[kept]
    words = np.array([str(word) for word in MergeReason])
    reason = _assign_reasons(sightings, grouping, settings)[kept]
    score = grouping.score[kept]
    values = {
        "detection_id": detection_ids.take(pa.array(first)),
        "other_detection_id": detection_ids.take(pa.array(second)),
        "defect_id": defect_ids.take(pa.array(first)),
        "other_defect_id": defect_ids.take(pa.array(second)),
        "merge_decision": pa.array([str(MergeDecision.APART), str(MergeDecision.JOINED)]).take(
            pa.array(joined[kept].astype(np.int64))
        ),
        "merge_reason": pa.array(words.tolist()).take(pa.array(reason)),
        "separation_m": pa.array(pairs.separation_m[kept]),
        "mahalanobis_distance": pa.array(pairs.sigmas[kept]),
        "overlap_share": pa.array(pairs.overlap[kept]),
        "appearance_score": pa.array(np.clip(score, -1.0, 1.0), mask=np.isnan(score)),
    }
    schema = get_stage_schema("merges")
    return check_table("merges", pa.Table.from_arrays([values[field.name] for field in schema], schema=schema))


def _select_nearest_pairs(first: RowIndices, second: RowIndices, sigmas: Float64Array, joined: BoolArray) -> BoolArray:
    """Which pairs (k,) are among the nearest of one of their sightings."""
    kept = np.zeros(len(first), dtype=bool)
    for kind, each in ((joined, _JOINED_PAIRS), (~joined, _APART_PAIRS)):
        rows = np.flatnonzero(kind & np.isfinite(sigmas) | kind & joined)
        node = np.r_[first[rows], second[rows]]
        order = np.lexsort((np.r_[rows, rows], np.r_[sigmas[rows], sigmas[rows]], node))
        starts = np.flatnonzero(np.r_[True, np.diff(node[order]) != 0][: len(order)])
        rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
        kept[np.r_[rows, rows][order[rank < each]]] = True
    return kept


def _add_unpaired(sightings: ObservationArrays, grouping: Clustering, settings: MergeSettings) -> Clustering:
    """The grouping with a pair for each sighting that its group alone, and no pair, brought into its defect."""
    pairs, group = grouping.pairs, grouping.group
    joined = group[pairs.first] == group[pairs.second]
    paired = np.zeros(len(group), dtype=bool)
    paired[pairs.first[joined]] = paired[pairs.second[joined]] = True
    order = np.lexsort((np.arange(len(group)), ~paired, group))
    leads = order[np.r_[True, np.diff(group[order]) != 0][: len(order)]]
    lone = np.flatnonzero(~paired & (leads[group] != np.arange(len(group))))
    if len(lone) == 0:
        return grouping
    rows = np.sort(np.column_stack([leads[group[lone]], lone]), axis=1)
    added = measure_pairs(
        sightings, rows, compute_observation_covariance(sightings, grouping.gate), grouping.gate, settings
    )
    return replace(
        grouping,
        pairs=concatenate_pairs([pairs, added]),
        score=np.r_[grouping.score, np.full(len(lone), np.nan)],
        differs=np.r_[grouping.differs, np.zeros(len(lone), dtype=bool)],
    )


def _assign_reasons(sightings: ObservationArrays, grouping: Clustering, settings: MergeSettings) -> RowIndices:
    """Reason (k,) of each pair as a place in ``MergeReason``; the last that holds is the one that decided."""
    pairs = grouping.pairs
    first, second = pairs.first, pairs.second
    place = {word: number for number, word in enumerate(MergeReason)}
    joined = grouping.group[first] == grouping.group[second]
    compared = np.isfinite(grouping.score)
    alike = sightings.defect_class[first] == sightings.defect_class[second]
    reason = np.full(len(pairs), place[MergeReason.GROUP_DISAGREES], dtype=np.int64)
    for held, word in (
        (grouping.differs, MergeReason.LOOKS_DIFFERENT),
        (~pairs.touching, MergeReason.NO_OVERLAP),
        (pairs.sigmas > settings.gate_sigma, MergeReason.TOO_FAR),
        (~alike, MergeReason.OTHER_CLASS),
        (sightings.photo[first] == sightings.photo[second], MergeReason.SAME_PHOTOGRAPH),
    ):
        reason[held & ~joined] = place[word]
    reason[joined] = place[MergeReason.GEOGRAPHY]
    reason[joined & compared & ~grouping.differs] = place[MergeReason.GEOGRAPHY_AND_IMAGE]
    group, kind = grouping.group, sightings.defect_class
    wrong = kind != find_most_common(group, kind, np.ones(len(kind)), int(group.max(initial=-1)) + 1)[group]
    reason[joined & (wrong[first] | wrong[second])] = place[MergeReason.OUTVOTED]
    reason[joined & (grouping.unit[first] == grouping.unit[second])] = place[MergeReason.CUT_BY_SEAM]
    return reason
