"""Which sightings are one defect: candidates, groups, the campaign's own noise, and what is left to the picture."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.deduplication.class_outliers import with_strays
from facadelake.deduplication.cluster import clusters_of, numbered
from facadelake.deduplication.gate import Noise, Pairs, measured_again, pairs_of
from facadelake.deduplication.observations import Sightings
from facadelake.deduplication.seams import united, units_of
from facadelake.deduplication.settings import MergeSettings
from facadelake.deduplication.triangulate import Estimate, Rays, estimated
from facadelake.deduplication.verify import Compare, Verified, unverified, verified

_log = logging.getLogger(__name__)
_NEAR_MISS = 1.5  # gates: pairs further apart than that are not worth a word
_PRIOR_SIGHTINGS = 20.0  # how many sightings the noise in the settings is worth
_PRIOR_DEFECTS = 10.0  # how many defects the relief in the settings is worth


@dataclass(frozen=True, kw_only=True, eq=False)
class Grouping:
    """``group`` (n,) of each sighting, 0 on; ``unit`` (n,): detections of one photograph that a seam cut have one.

    ``whole`` are the units as sightings, ``whole_group`` their groups. ``pairs`` that were looked at (of sightings, all
    classes), with the ``score`` (k,) of their pictures, NaN where they were not compared, and ``differs`` (k,): they
    look different. ``noise`` of the rays, ``gate`` of the gate.
    """

    group: RowIndices
    unit: RowIndices
    whole: Sightings
    whole_group: RowIndices
    pairs: Pairs
    score: Float64Array
    differs: BoolArray
    noise: Noise
    gate: Noise


def grouped(sightings: Sightings, settings: MergeSettings, compare: Compare | None = None) -> Grouping:
    """Groups of ``sightings`` in a fixed order of rows.

    First by the noise that the settings know, then by the campaign's own, no narrower than the poses allow. Where
    ``compare`` is given, pairs near the gate's edge or with rivals are compared by their pictures, and those that look
    different are not joined. Last, a sighting that stands alone in its class joins a group that others agree on.
    """
    before = Noise(size_share=settings.size_share, floor_m=settings.floor_m, relief_m=settings.relief_m)
    found = pairs_of(sightings, before, settings, within_sigmas=_NEAR_MISS * settings.gate_sigma)
    unit = units_of(sightings, found)
    whole = united(sightings, unit)
    if len(whole) < len(sightings):
        near = pairs_of(whole, before, settings, within_sigmas=_NEAR_MISS * settings.gate_sigma)
    else:
        near = found
    first = _clusters(whole, unverified(near), settings)
    noise, gate = _own_noise(whole, first, settings)
    near = measured_again(whole, near, gate, settings)
    seen = unverified(near)
    group = _clusters(whole, seen, settings)
    if compare is not None:
        seen = verified(whole, near, group, gate, settings, compare)
        group = _clusters(whole, seen, settings)
    group = with_strays(whole, near, group, settings)
    score, differs = seen.score, seen.differs
    if len(whole) < len(sightings):
        found = measured_again(sightings, found, gate, settings)
        score, differs = _of_units(unit, near, found, score), _of_units(unit, near, found, differs) > 0
    else:
        found = near
    return Grouping(
        group=group[unit],
        unit=unit,
        whole=whole,
        whole_group=group,
        pairs=found,
        score=score,
        differs=differs,
        noise=noise,
        gate=gate,
    )


def _of_units(unit: RowIndices, near: Pairs, found: Pairs, values: Float64Array | BoolArray) -> Float64Array:
    """What pairs ``near`` of units have, for the pairs ``found`` of their parts; NaN where there is no such pair."""
    count = int(unit.max()) + 1
    a, b = unit[found.first], unit[found.second]
    key, known = np.minimum(a, b) * count + np.maximum(a, b), near.first * count + near.second
    at = np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))
    out = np.full(len(found), np.nan)
    there = known[at] == key if len(known) else np.zeros(len(found), dtype=bool)
    out[there] = values[at[there]]
    return out


def _clusters(sightings: Sightings, seen: Verified, settings: MergeSettings) -> RowIndices:
    pairs = seen.pairs
    alike = sightings.defect_class[pairs.first] == sightings.defect_class[pairs.second]
    may = alike & pairs.touching & (pairs.sigmas <= settings.gate_sigma)
    group = clusters_of(
        pairs.first[may],
        pairs.second[may],
        pairs.sigmas[may],
        sightings.photo,
        agreement=settings.agreement,
        gate_sigma=settings.gate_sigma,
    )
    return numbered(group)


def _own_noise(sightings: Sightings, group: RowIndices, settings: MergeSettings) -> tuple[Noise, Noise]:
    """The campaign's noise of rays that show the same part of a defect, and that of the gate, which allows for others
    and is no narrower than the poses are known."""
    same = Noise(size_share=settings.centre_share, floor_m=settings.floor_m, relief_m=settings.relief_m)
    gate = replace(same, size_share=settings.size_share)
    if len(group) == 0:
        return same, gate
    order = np.argsort(group, kind="stable")
    boxes, relief = estimated(sightings, Rays(sightings, order, group[order], same), settings.relief_m)
    scale = boxes.blended(1.0, _PRIOR_SIGHTINGS) ** 0.5
    if settings.offset_m > 0:
        relief = Estimate()  # where the whole campaign may stand off, what it shows is not the building's relief
    noise = Noise(
        size_share=same.size_share * scale,
        floor_m=same.floor_m * scale,
        relief_m=relief.blended(settings.relief_m**2, _PRIOR_DEFECTS) ** 0.5,
    )
    share = replace(boxes, value=boxes.value * same.size_share**2).blended(settings.size_share**2, _PRIOR_SIGHTINGS)
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
