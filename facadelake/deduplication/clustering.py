"""Clustering of observations into defects: candidate pairs, groups, noise of the campaign, appearance."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, RowIndices
from facadelake.deduplication.ambiguous_pairs import (
    Compare,
    ComparedPairs,
    build_uncompared_pairs,
    compare_ambiguous_pairs,
)
from facadelake.deduplication.average_linkage import cluster_by_average_linkage, label_groups
from facadelake.deduplication.candidate_pairs import (
    ObservationPairs,
    PositionNoise,
    find_pairs,
    find_pairs_in_gate,
    update_pairs,
)
from facadelake.deduplication.class_outliers import assign_class_outliers
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.seams import find_units, merge_units
from facadelake.deduplication.settings import MergeSettings
from facadelake.deduplication.triangulation import GroupRays, VarianceEstimate, estimate_variances

_log = logging.getLogger(__name__)
_CANDIDATE_GATES = 1.5  # in gates: pairs farther apart are not recorded
_PRIOR_OBSERVATIONS = 20.0  # weight of the prior noise of the settings, as a number of observations
_PRIOR_DEFECTS = 10.0  # weight of the prior relief of the settings, as a number of defects


@dataclass(frozen=True, kw_only=True, eq=False)
class Clustering:
    """Groups of observations, and the pairs that decided them.

    ``group`` (n,): group of each observation, from 0. ``unit`` (n,): detections of one photograph that are parts of one
    (cut by a tile seam or an occluder) have the same unit. ``unit_observations``: the units as observations, in the
    groups ``unit_group``. ``pairs``: the candidate pairs of observations, of all classes, with the ``score`` (k,) of
    their appearance, NaN where not compared, and ``differs`` (k,): they look different. ``noise``: of the rays;
    ``gate``: of the gate.
    """

    group: RowIndices
    unit: RowIndices
    unit_observations: ObservationArrays
    unit_group: RowIndices
    pairs: ObservationPairs
    score: Float64N
    differs: BoolArray
    noise: PositionNoise
    gate: PositionNoise


def cluster_observations(
    observations: ObservationArrays, settings: MergeSettings, compare: Compare | None = None
) -> Clustering:
    """Cluster observations into defects.

    First with the noise of the settings, then with the campaign's own, which is no smaller than the poses allow. Where
    ``compare`` is given, pairs near the gate's edge or between competing groups are compared by appearance, and those
    that look different are not joined. Last, an observation that is alone in its class joins the group that others
    agree on.

    ``observations`` are in a fixed order, on which the labels depend.
    """
    prior = PositionNoise(size_share=settings.size_share, floor_m=settings.floor_m, relief_m=settings.relief_m)
    pairs = find_pairs(observations, prior, settings, within_sigmas=_CANDIDATE_GATES * settings.gate_sigma)
    unit = find_units(observations, pairs)
    unit_observations = merge_units(observations, unit)
    if len(unit_observations) < len(observations):
        unit_pairs = find_pairs(
            unit_observations, prior, settings, within_sigmas=_CANDIDATE_GATES * settings.gate_sigma
        )
    else:
        unit_pairs = pairs
    initial_group = _cluster_pairs(unit_observations, build_uncompared_pairs(unit_pairs), settings)
    noise, gate = _estimate_noise(unit_observations, initial_group, settings)
    unit_pairs = update_pairs(unit_observations, unit_pairs, gate, settings)
    compared = build_uncompared_pairs(unit_pairs)
    group = _cluster_pairs(unit_observations, compared, settings)
    if compare is not None:
        compared = compare_ambiguous_pairs(unit_observations, unit_pairs, group, gate, settings, compare)
        group = _cluster_pairs(unit_observations, compared, settings)
    group = assign_class_outliers(unit_observations, unit_pairs, group, settings)
    score, differs = compared.score, compared.differs
    if len(unit_observations) < len(observations):
        pairs = update_pairs(observations, pairs, gate, settings)
        score, differs = (
            _expand_unit_values(unit, unit_pairs, pairs, score),
            _expand_unit_values(unit, unit_pairs, pairs, differs) > 0,
        )
    else:
        pairs = unit_pairs
    return Clustering(
        group=group[unit],
        unit=unit,
        unit_observations=unit_observations,
        unit_group=group,
        pairs=pairs,
        score=score,
        differs=differs,
        noise=noise,
        gate=gate,
    )


def _expand_unit_values(
    unit: RowIndices, unit_pairs: ObservationPairs, pairs: ObservationPairs, values: Float64Array | BoolArray
) -> Float64Array:
    """Values of pairs of units, for the pairs of their parts.

    Args:
        unit: unit (n,) of each observation.
        unit_pairs: pairs of units.
        pairs: pairs of observations.
        values: value (k,) of each pair of units.

    Returns:
        Value of each pair of observations; NaN where their units are no pair.
    """
    count = int(unit.max()) + 1
    a, b = unit[pairs.first], unit[pairs.second]
    key, known_key = np.minimum(a, b) * count + np.maximum(a, b), unit_pairs.first * count + unit_pairs.second
    index = np.minimum(np.searchsorted(known_key, key), max(len(known_key) - 1, 0))
    out = np.full(len(pairs), np.nan)
    is_pair = known_key[index] == key if len(known_key) else np.zeros(len(pairs), dtype=bool)
    out[is_pair] = values[index[is_pair]]
    return out


def _cluster_pairs(observations: ObservationArrays, compared: ComparedPairs, settings: MergeSettings) -> RowIndices:
    """Groups (n,) of the observations by the pairs of one class that touch and are in the gate."""
    pairs = compared.pairs
    same_class = observations.defect_class[pairs.first] == observations.defect_class[pairs.second]
    joinable = same_class & find_pairs_in_gate(pairs, settings)
    group = cluster_by_average_linkage(
        pairs.first[joinable],
        pairs.second[joinable],
        pairs.sigmas[joinable],
        observations.photo,
        agreement=settings.agreement,
        gate_sigma=settings.gate_sigma,
    )
    return label_groups(group)


def _estimate_noise(
    observations: ObservationArrays, group: RowIndices, settings: MergeSettings
) -> tuple[PositionNoise, PositionNoise]:
    """The campaign's noise: of rays that show the same part of a defect, and of the gate.

    The gate allows for boxes that show different parts of a defect, and is no narrower than the accuracy of the poses.
    ``group`` (n,) is the group of each observation.
    """
    same = PositionNoise(size_share=settings.centre_share, floor_m=settings.floor_m, relief_m=settings.relief_m)
    gate = replace(same, size_share=settings.size_share)
    if len(group) == 0:
        return same, gate
    order = np.argsort(group, kind="stable")
    box_variance, relief_variance = estimate_variances(
        observations, GroupRays(observations, order, group[order], same), settings.relief_m
    )
    scale = box_variance.combine_with_prior(1.0, _PRIOR_OBSERVATIONS) ** 0.5
    if settings.offset_m > 0:
        relief_variance = VarianceEstimate()  # an offset of the campaign cannot be separated from relief
    noise = PositionNoise(
        size_share=same.size_share * scale,
        floor_m=same.floor_m * scale,
        relief_m=relief_variance.combine_with_prior(settings.relief_m**2, _PRIOR_DEFECTS) ** 0.5,
    )
    gate_variance = replace(box_variance, value=box_variance.value * same.size_share**2).combine_with_prior(
        settings.size_share**2, _PRIOR_OBSERVATIONS
    )
    _log.info(
        "estimated noise (one sigma): boxes %.1f %% of their size, poses %.1f mm, distance from the model %.1f cm",
        100 * noise.size_share,
        1000 * noise.floor_m,
        100 * noise.relief_m,
    )
    gate = replace(
        gate,
        size_share=float(np.clip(gate_variance**0.5, settings.centre_share, settings.size_share)),
        floor_m=max(settings.floor_m, noise.floor_m),
    )
    return noise, gate
