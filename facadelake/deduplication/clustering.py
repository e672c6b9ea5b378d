"""Which sightings are one defect: candidates, groups, the campaign's own noise, and what is left to the picture."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.deduplication.ambiguous_pairs import (
    Compare,
    ComparedPairs,
    build_uncompared_pairs,
    compare_ambiguous_pairs,
)
from facadelake.deduplication.class_outliers import assign_class_outliers
from facadelake.deduplication.linkage import cluster_by_average_linkage, label_groups
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import ObservationPairs, PositionNoise, find_pairs, update_pairs
from facadelake.deduplication.seams import find_units, merge_units
from facadelake.deduplication.settings import MergeSettings
from facadelake.deduplication.triangulation import GroupRays, VarianceEstimate, estimate_variances

_log = logging.getLogger(__name__)
_CANDIDATE_GATES = 1.5  # gates: pairs further apart than that are not worth a word
_PRIOR_OBSERVATIONS = 20.0  # how many sightings the noise in the settings is worth
_PRIOR_DEFECTS = 10.0  # how many defects the relief in the settings is worth


@dataclass(frozen=True, kw_only=True, eq=False)
class Clustering:
    """``group`` (n,) of each sighting, 0 on; ``unit`` (n,): detections of one photograph that a seam cut have one.

    ``unit_observations`` are the units as sightings, ``unit_group`` their groups. ``pairs`` that were looked at (of sightings, all
    classes), with the ``score`` (k,) of their pictures, NaN where they were not compared, and ``differs`` (k,): they
    look different. ``noise`` of the rays, ``gate`` of the gate.
    """

    group: RowIndices
    unit: RowIndices
    unit_observations: ObservationArrays
    unit_group: RowIndices
    pairs: ObservationPairs
    score: Float64Array
    differs: BoolArray
    noise: PositionNoise
    gate: PositionNoise


def cluster_observations(
    sightings: ObservationArrays, settings: MergeSettings, compare: Compare | None = None
) -> Clustering:
    """Groups of ``sightings`` in a fixed order of rows.

    First by the noise that the settings know, then by the campaign's own, no narrower than the poses allow. Where
    ``compare`` is given, pairs near the gate's edge or with rivals are compared by their pictures, and those that look
    different are not joined. Last, a sighting that stands alone in its class joins a group that others agree on.
    """
    before = PositionNoise(size_share=settings.size_share, floor_m=settings.floor_m, relief_m=settings.relief_m)
    found = find_pairs(sightings, before, settings, within_sigmas=_CANDIDATE_GATES * settings.gate_sigma)
    unit = find_units(sightings, found)
    whole = merge_units(sightings, unit)
    if len(whole) < len(sightings):
        near = find_pairs(whole, before, settings, within_sigmas=_CANDIDATE_GATES * settings.gate_sigma)
    else:
        near = found
    first = _cluster_pairs(whole, build_uncompared_pairs(near), settings)
    noise, gate = _estimate_noise(whole, first, settings)
    near = update_pairs(whole, near, gate, settings)
    seen = build_uncompared_pairs(near)
    group = _cluster_pairs(whole, seen, settings)
    if compare is not None:
        seen = compare_ambiguous_pairs(whole, near, group, gate, settings, compare)
        group = _cluster_pairs(whole, seen, settings)
    group = assign_class_outliers(whole, near, group, settings)
    score, differs = seen.score, seen.differs
    if len(whole) < len(sightings):
        found = update_pairs(sightings, found, gate, settings)
        score, differs = (
            _expand_unit_values(unit, near, found, score),
            _expand_unit_values(unit, near, found, differs) > 0,
        )
    else:
        found = near
    return Clustering(
        group=group[unit],
        unit=unit,
        unit_observations=whole,
        unit_group=group,
        pairs=found,
        score=score,
        differs=differs,
        noise=noise,
        gate=gate,
    )


def _expand_unit_values(
    unit: RowIndices, near: ObservationPairs, found: ObservationPairs, values: Float64Array | BoolArray
) -> Float64Array:
    """What pairs ``near`` of units have, for the pairs ``found`` of their parts; NaN where there is no such pair."""
    count = int(unit.max()) + 1
    a, b = unit[found.first], unit[found.second]
    key, known = np.minimum(a, b) * count + np.maximum(a, b), near.first * count + near.second
    at = np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))
    out = np.full(len(found), np.nan)
    there = known[at] == key if len(known) else np.zeros(len(found), dtype=bool)
    out[there] = values[at[there]]
    return out


def _cluster_pairs(sightings: ObservationArrays, seen: ComparedPairs, settings: MergeSettings) -> RowIndices:
    pairs = seen.pairs
    alike = sightings.defect_class[pairs.first] == sightings.defect_class[pairs.second]
    may = alike & pairs.touching & (pairs.sigmas <= settings.gate_sigma)
    group = cluster_by_average_linkage(
        pairs.first[may],
        pairs.second[may],
        pairs.sigmas[may],
        sightings.photo,
        agreement=settings.agreement,
        gate_sigma=settings.gate_sigma,
    )
    return label_groups(group)


def _estimate_noise(
    sightings: ObservationArrays, group: RowIndices, settings: MergeSettings
) -> tuple[PositionNoise, PositionNoise]:
    """The campaign's noise of rays that show the same part of a defect, and that of the gate, which allows for others
    and is no narrower than the poses are known."""
    same = PositionNoise(size_share=settings.centre_share, floor_m=settings.floor_m, relief_m=settings.relief_m)
    gate = replace(same, size_share=settings.size_share)
    if len(group) == 0:
        return same, gate
    order = np.argsort(group, kind="stable")
    boxes, relief = estimate_variances(sightings, GroupRays(sightings, order, group[order], same), settings.relief_m)
    scale = boxes.combine_with_prior(1.0, _PRIOR_OBSERVATIONS) ** 0.5
    if settings.offset_m > 0:
        relief = (
            VarianceEstimate()
        )  # where the whole campaign may stand off, what it shows is not the building's relief
    noise = PositionNoise(
        size_share=same.size_share * scale,
        floor_m=same.floor_m * scale,
        relief_m=relief.combine_with_prior(settings.relief_m**2, _PRIOR_DEFECTS) ** 0.5,
    )
    share = replace(boxes, value=boxes.value * same.size_share**2).combine_with_prior(
        settings.size_share**2, _PRIOR_OBSERVATIONS
    )
    _log.info(
        "boxes vary by %.1f %% of their size and %.1f mm; the building stands %.1f cm off its model (one sigma each)",
        100 * noise.size_share,
        1000 * noise.floor_m,
        100 * noise.relief_m,
    )
    gate = replace(
        gate,
        size_share=float(np.clip(share**0.5, settings.centre_share, settings.size_share)),
        floor_m=max(settings.floor_m, noise.floor_m),
    )
    return noise, gate
