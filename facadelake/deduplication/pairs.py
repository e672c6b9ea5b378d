"""Which two sightings may be of one defect: normalised distances between sightings.

The paper's Algorithm 1 takes a fixed 0.5 m an axis (0.71 m), which merges neighbouring cracks. Here the gate follows
from the patches' extents, from what is left of the poses, and from the building's relief: a real surface that stands
off the model's shifts each sighting along its own ray, so two sightings of one place part in a known direction. What
the poses of a block share moves both sightings alike and widens no gate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array, RowIndices
from facadelake.core.parallel import map_blocks
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings
from facadelake.registration import compute_tangents

_GRAZING_COSINE = 0.15  # a ray flatter than this says nothing more of relief
_FACING_MIN = -0.2  # surfaces that turn further from one another do not show one defect
_SLAB_OBSERVATIONS = 40_000  # sightings whose pairs are found at a time
_BATCH_PAIRS = 20_000  # pairs measured at a time: what fits the processor's cache
_BATCH_LARGE = 2_000


@dataclass(frozen=True, kw_only=True)
class PositionNoise:
    """One sigma of a sighting's place: ``size_share`` of its extents along the surface, ``floor_m`` in all directions,
    and ``relief_m`` of the real surface off the model's, which all sightings of a place share."""

    size_share: float
    floor_m: float
    relief_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationPairs:
    """Pairs of sightings near one another: ``first`` < ``second`` (k,) rows.

    ``separation_m`` (k,), ``sigmas`` (k,): the Mahalanobis distance; ``overlap`` (k,): area both patches share over the
    smaller one's, with the relief's shift taken out; ``touching`` (k,): they share some, to the accuracy of the places.
    """

    first: RowIndices
    second: RowIndices
    separation_m: Float64Array
    sigmas: Float64Array
    overlap: Float64Array
    touching: BoolArray

    def __len__(self) -> int:
        return len(self.first)

    def take(self, rows: Int64Array | BoolArray) -> ObservationPairs:
        """Some of the pairs."""
        return ObservationPairs(
            first=self.first[rows],
            second=self.second[rows],
            separation_m=self.separation_m[rows],
            sigmas=self.sigmas[rows],
            overlap=self.overlap[rows],
            touching=self.touching[rows],
        )


def compute_observation_covariance(sightings: ObservationArrays, noise: PositionNoise) -> Float64Array:
    """Covariance (n, 3, 3) in m2 of each sighting's place for itself, beside what the poses and the relief share."""
    across, upward = sightings.compute_tangents()
    wide = (noise.size_share * sightings.width_m)[:, None] * across
    high = (noise.size_share * sightings.height_m)[:, None] * upward
    floor = noise.floor_m**2 + (0.29 * sightings.gsd_m) ** 2  # a pixel's rounding is uniform
    spread: Float64Array = (
        wide[:, :, None] * wide[:, None, :]
        + high[:, :, None] * high[:, None, :]
        + floor[:, None, None] * np.eye(3)[None]
    )
    return spread


def find_pairs(
    sightings: ObservationArrays, noise: PositionNoise, settings: MergeSettings, *, within_sigmas: float
) -> ObservationPairs:
    """Every pair of sightings within ``within_sigmas``, whatever their class or photograph; nearly linear in n."""
    placing = compute_observation_covariance(sightings, noise)

    def near(rows: Int64Array) -> ObservationPairs:
        pairs = measure_pairs(sightings, rows, placing, noise, settings)
        return pairs.take(pairs.sigmas <= within_sigmas)

    found = [part for rows in _find_candidates(sightings, settings) for part in map_blocks(near, _split_batches(rows))]
    whole = concatenate_pairs(found)
    return whole.take(np.lexsort((whole.second, whole.first)))


def update_pairs(
    sightings: ObservationArrays, pairs: ObservationPairs, noise: PositionNoise, settings: MergeSettings
) -> ObservationPairs:
    """The same pairs by another noise."""
    placing = compute_observation_covariance(sightings, noise)
    rows = np.column_stack([pairs.first, pairs.second])
    parts = map_blocks(lambda part: measure_pairs(sightings, part, placing, noise, settings), _split_batches(rows))
    return concatenate_pairs(parts)


def _split_batches(pairs: Int64Array) -> list[Int64Array]:
    return [pairs[start : start + _BATCH_PAIRS] for start in range(0, len(pairs), _BATCH_PAIRS)]


def measure_pairs(
    sightings: ObservationArrays,
    pairs: Int64Array,
    placing: Float64Array,
    noise: PositionNoise,
    settings: MergeSettings,
) -> ObservationPairs:
    """Distance and overlap of ``pairs`` (k, 2).

    A surface that stands b off the model along its normal moves a sighting by ``b / (normal . ray) * ray``; both see
    the same b, of the relief and of ``offset_m`` (one sigma), so their difference varies by the difference of those
    two shifts alone. Surfaces that face away from one another are infinitely far apart.
    """
    i, j = pairs[:, 0], pairs[:, 1]
    normal = sightings.normal_site[i] + sightings.normal_site[j]
    facing = np.einsum("ij,ij->i", sightings.normal_site[i], sightings.normal_site[j])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-9)[:, None]
    part = _compute_relief_shift(sightings, i, normal) - _compute_relief_shift(sightings, j, normal)
    difference = sightings.xyz_site_m[i] - sightings.xyz_site_m[j]
    total = placing[i] + placing[j]
    solved = np.linalg.solve(total, np.stack([difference, part], axis=2))
    plain = np.einsum("ij,ij->i", difference, solved[:, :, 0])
    mixed = np.einsum("ij,ij->i", part, solved[:, :, 0])
    along = np.einsum("ij,ij->i", part, solved[:, :, 1])
    variance = noise.relief_m**2 + settings.offset_m**2
    off = variance * mixed / (1 + variance * along)  # how far the pair says that the surface stands off (Woodbury)
    sigmas = np.sqrt(np.maximum(plain - mixed * off, 0.0))
    share, touching = _measure_overlap(sightings, i, j, normal, difference - part * off[:, None], noise, settings)
    return ObservationPairs(
        first=i,
        second=j,
        separation_m=np.linalg.norm(difference, axis=1),
        sigmas=np.where(facing > _FACING_MIN, sigmas, np.inf),
        overlap=share,
        touching=touching,
    )


def _compute_relief_shift(sightings: ObservationArrays, rows: RowIndices, normal: Float64Array) -> Float64Array:
    own, ray = sightings.normal_site[rows], sightings.ray_site[rows]
    cosine = np.minimum(np.einsum("ij,ij->i", own, ray), -_GRAZING_COSINE)
    shift: Float64Array = ray * (np.einsum("ij,ij->i", own, normal) / cosine)[:, None]
    return shift


def _measure_overlap(
    sightings: ObservationArrays,
    i: RowIndices,
    j: RowIndices,
    normal: Float64Array,
    apart: Float64Array,
    noise: PositionNoise,
    settings: MergeSettings,
) -> tuple[Float64Array, BoolArray]:
    """Share of the smaller patch that both cover (k,), and whether they touch, as rectangles along the surface."""
    across, upward = compute_tangents(normal)
    slack = settings.gate_sigma * np.sqrt(2) * noise.floor_m
    common, touching = np.ones(len(i)), np.ones(len(i), dtype=bool)
    for axis, extent in ((across, sightings.width_m), (upward, sightings.height_m)):
        gap = np.abs(np.einsum("ij,ij->i", apart, axis)) - (extent[i] + extent[j]) / 2
        common *= np.clip(-gap, 0.0, np.minimum(extent[i], extent[j]))
        touching &= gap <= slack
    area = sightings.width_m * sightings.height_m
    share = np.divide(common, np.minimum(area[i], area[j]), out=np.zeros(len(i)), where=common > 0)
    return np.minimum(share, 1.0), touching


def _find_candidates(sightings: ObservationArrays, settings: MergeSettings) -> Iterator[Int64Array]:
    """Pairs (k, 2), first < second, no further apart than the ceiling or half their extents together; each once."""
    xyz = sightings.xyz_site_m
    if len(xyz) < 2:
        return
    axis = int(np.argmax(np.ptp(xyz, axis=0)))
    order = np.argsort(xyz[:, axis], kind="stable")
    along = xyz[order, axis]
    for start in range(0, len(order), _SLAB_OBSERVATIONS):
        stop = min(start + _SLAB_OBSERVATIONS, len(order))
        last = int(np.searchsorted(along, along[stop - 1] + settings.reach_m, side="right"))
        rows = order[start:last]
        near = cKDTree(xyz[rows]).query_pairs(settings.reach_m, output_type="ndarray")
        near = near[near.min(axis=1) < stop - start]  # the others belong to a later slab
        yield np.sort(rows[near], axis=1)
    # A defect larger than the ceiling may be cut differently by each photograph: those few look further.
    half = sightings.half_diagonal_m
    large = np.flatnonzero(2 * half > settings.reach_m)
    if len(large) == 0:
        return
    tree = cKDTree(xyz)
    for start in range(0, len(large), _BATCH_LARGE):
        rows = large[start : start + _BATCH_LARGE]
        lists = tree.query_ball_point(xyz[rows], 2 * half[rows])
        mine = np.repeat(rows, [len(found) for found in lists])
        other = np.concatenate([np.asarray(found, dtype=np.int64) for found in lists])
        gap = np.linalg.norm(xyz[mine] - xyz[other], axis=1)
        # A pair of two large ones is met twice: from the larger, of equals from the first.
        once = (half[mine] > half[other]) | ((half[mine] == half[other]) & (mine < other))
        kept = once & (gap > settings.reach_m) & (gap <= half[mine] + half[other])
        yield np.sort(np.column_stack([mine[kept], other[kept]]), axis=1)


def concatenate_pairs(parts: list[ObservationPairs]) -> ObservationPairs:
    """Pairs one after the other."""
    none = np.zeros(0)
    rows = np.zeros(0, dtype=np.int64)
    empty = ObservationPairs(
        first=rows, second=rows, separation_m=none, sigmas=none, overlap=none, touching=np.zeros(0, dtype=bool)
    )
    whole = [empty, *parts]
    return ObservationPairs(
        first=np.concatenate([p.first for p in whole]),
        second=np.concatenate([p.second for p in whole]),
        separation_m=np.concatenate([p.separation_m for p in whole]),
        sigmas=np.concatenate([p.sigmas for p in whole]),
        overlap=np.concatenate([p.overlap for p in whole]),
        touching=np.concatenate([p.touching for p in whole]),
    )
