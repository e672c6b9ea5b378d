"""Pairs of observations that may be of one defect, and their Mahalanobis distances.

The paper's Algorithm 1 has a fixed limit of 0.5 m per axis (0.71 m), which merges neighbouring cracks. Here the gate
follows from the extents of the patches, the residual error of the poses and the relief of the building: where the real
surface deviates from the model, each observation is shifted along its own ray, so two observations of one point are
separated in a known direction. An error that the poses of a block share shifts both observations alike and does not
widen the gate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64Nx3x3, Int64Array, RowIndices
from facadelake.core.parallel import map_blocks
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings
from facadelake.registration import compute_tangents

_GRAZING_COSINE = 0.15  # limits the shift by relief along rays at a larger incidence
_FACING_MIN = -0.2  # cosine of two normals; surfaces that face further apart do not show one defect
_SLAB_OBSERVATIONS = 40_000  # observations per search for pairs
_BATCH_PAIRS = 20_000  # pairs measured at once: fits the processor's cache
_BATCH_LARGE = 2_000  # large observations per search


@dataclass(frozen=True, kw_only=True)
class PositionNoise:
    """One sigma of an observation's position.

    ``size_share``: share of the patch's extents, along the surface; ``floor_m``: in all directions; ``relief_m``:
    distance of the real surface from the model, which all observations of a point share.
    """

    size_share: float
    floor_m: float
    relief_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservationPairs:
    """Pairs of observations near one another: rows ``first`` < ``second`` (k,).

    ``separation_m`` (k,); ``sigmas`` (k,): Mahalanobis distance; ``overlap`` (k,): common area of both patches over the
    area of the smaller one, after removing the shift by relief; ``touching`` (k,): the patches overlap, to the accuracy
    of the positions.
    """

    first: RowIndices
    second: RowIndices
    separation_m: Float64N
    sigmas: Float64N
    overlap: Float64N
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


def compute_observation_covariance(observations: ObservationArrays, noise: PositionNoise) -> Float64Nx3x3:
    """Covariance (n, 3, 3) in m2 of each observation's own error of position, without what poses and relief share."""
    across, upward = observations.compute_tangents()
    wide = (noise.size_share * observations.width_m)[:, None] * across
    high = (noise.size_share * observations.height_m)[:, None] * upward
    variance = noise.floor_m**2 + (0.29 * observations.gsd_m) ** 2  # rounding to a pixel is uniform
    covariance: Float64Array = (
        wide[:, :, None] * wide[:, None, :]
        + high[:, :, None] * high[:, None, :]
        + variance[:, None, None] * np.eye(3)[None]
    )
    return covariance


def find_pairs(
    observations: ObservationArrays, noise: PositionNoise, settings: MergeSettings, *, within_sigmas: float
) -> ObservationPairs:
    """All pairs of observations within a Mahalanobis distance, of any class and photograph; nearly linear in n.

    Args:
        observations: the observations (n).
        noise: their noise.
        settings: gate, ceiling and offset of the campaign.
        within_sigmas: limit of the Mahalanobis distance.
    """
    covariance = compute_observation_covariance(observations, noise)

    def measure_within(rows: Int64Array) -> ObservationPairs:
        pairs = measure_pairs(observations, rows, covariance, noise, settings)
        return pairs.take(pairs.sigmas <= within_sigmas)

    found = [
        part
        for rows in _find_candidates(observations, settings)
        for part in map_blocks(measure_within, _split_batches(rows))
    ]
    concatenated = concatenate_pairs(found)
    return concatenated.take(np.lexsort((concatenated.second, concatenated.first)))


def update_pairs(
    observations: ObservationArrays, pairs: ObservationPairs, noise: PositionNoise, settings: MergeSettings
) -> ObservationPairs:
    """The same pairs measured with another noise.

    Args:
        observations: the observations (n).
        pairs: pairs of them.
        noise: the new noise.
        settings: gate and offset of the campaign.
    """
    covariance = compute_observation_covariance(observations, noise)
    rows = np.column_stack([pairs.first, pairs.second])
    measured = map_blocks(
        lambda batch: measure_pairs(observations, batch, covariance, noise, settings), _split_batches(rows)
    )
    return concatenate_pairs(measured)


def find_pairs_in_gate(pairs: ObservationPairs, settings: MergeSettings) -> BoolArray:
    """Which pairs (k,) may be of one defect by position: their patches touch, and they are within the gate."""
    in_gate: BoolArray = pairs.touching & (pairs.sigmas <= settings.gate_sigma)
    return in_gate


def _split_batches(pairs: Int64Array) -> list[Int64Array]:
    """Rows of pairs (k, 2) in batches."""
    return [pairs[start : start + _BATCH_PAIRS] for start in range(0, len(pairs), _BATCH_PAIRS)]


def measure_pairs(
    observations: ObservationArrays,
    pairs: Int64Array,
    covariance: Float64Nx3x3,
    noise: PositionNoise,
    settings: MergeSettings,
) -> ObservationPairs:
    """Mahalanobis distance and overlap of pairs.

    A surface at distance b from the model along its normal shifts an observation by ``b / (normal . ray) * ray``. Both
    observations have the same b, whose variance is that of the relief and of ``settings.offset_m``, so the variance of
    their difference is that of the difference of the two shifts. Surfaces that face apart are infinitely far.

    Args:
        observations: the observations (n).
        pairs: rows (k, 2).
        covariance: covariances (n, 3, 3) of the observations' own errors, as ``compute_observation_covariance`` gives
            them.
        noise: their noise.
        settings: gate and offset of the campaign.
    """
    i, j = pairs[:, 0], pairs[:, 1]
    normal = observations.normal_site[i] + observations.normal_site[j]
    facing = np.einsum("ij,ij->i", observations.normal_site[i], observations.normal_site[j])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-9)[:, None]
    shift = _compute_relief_shift(observations, i, normal) - _compute_relief_shift(observations, j, normal)
    difference = observations.xyz_site_m[i] - observations.xyz_site_m[j]
    pair_covariance = covariance[i] + covariance[j]
    solved = np.linalg.solve(pair_covariance, np.stack([difference, shift], axis=2))
    plain = np.einsum("ij,ij->i", difference, solved[:, :, 0])
    mixed = np.einsum("ij,ij->i", shift, solved[:, :, 0])
    along = np.einsum("ij,ij->i", shift, solved[:, :, 1])
    variance = noise.relief_m**2 + settings.offset_m**2
    surface_offset = (
        variance * mixed / (1 + variance * along)
    )  # the pair's estimate of the surface's distance (Woodbury identity)
    sigmas = np.sqrt(np.maximum(plain - mixed * surface_offset, 0.0))
    share, touching = _measure_overlap(
        observations, i, j, normal, difference - shift * surface_offset[:, None], noise, settings
    )
    return ObservationPairs(
        first=i,
        second=j,
        separation_m=np.linalg.norm(difference, axis=1),
        sigmas=np.where(facing > _FACING_MIN, sigmas, np.inf),
        overlap=share,
        touching=touching,
    )


def _compute_relief_shift(observations: ObservationArrays, rows: RowIndices, normal: Float64Nx3) -> Float64Nx3:
    """Shift (k, 3) of observations ``rows`` (k,) for a surface 1 m in front of the model along ``normal`` (k, 3)."""
    own_normal, ray = observations.normal_site[rows], observations.ray_site[rows]
    cosine = np.minimum(np.einsum("ij,ij->i", own_normal, ray), -_GRAZING_COSINE)
    shift: Float64Array = ray * (np.einsum("ij,ij->i", own_normal, normal) / cosine)[:, None]
    return shift


def _measure_overlap(
    observations: ObservationArrays,
    i: RowIndices,
    j: RowIndices,
    normal: Float64Nx3,
    difference: Float64Nx3,
    noise: PositionNoise,
    settings: MergeSettings,
) -> tuple[Float64N, BoolArray]:
    """Overlap of the patches of pairs, as rectangles along the surface.

    Args:
        observations: the observations (n).
        i: first rows (k,).
        j: second rows (k,).
        normal: unit normals (k, 3) of the pairs.
        difference: differences of position (k, 3) in m, after removing the shift by relief.
        noise: noise of the observations.
        settings: the gate.

    Returns:
        Common area over the area of the smaller patch (k,), and whether the patches touch (k,).
    """
    across, upward = compute_tangents(normal)
    tolerance = settings.gate_sigma * np.sqrt(2) * noise.floor_m
    common_area, touching = np.ones(len(i)), np.ones(len(i), dtype=bool)
    for axis, extent in ((across, observations.width_m), (upward, observations.height_m)):
        gap = np.abs(np.einsum("ij,ij->i", difference, axis)) - (extent[i] + extent[j]) / 2
        common_area *= np.clip(-gap, 0.0, np.minimum(extent[i], extent[j]))
        touching &= gap <= tolerance
    area = observations.width_m * observations.height_m
    share = np.divide(common_area, np.minimum(area[i], area[j]), out=np.zeros(len(i)), where=common_area > 0)
    return np.minimum(share, 1.0), touching


def _find_candidates(observations: ObservationArrays, settings: MergeSettings) -> Iterator[Int64Array]:
    """Pairs (k, 2), first < second, no farther apart than the ceiling or half their extents together; each once."""
    xyz = observations.xyz_site_m
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
        near = near[near.min(axis=1) < stop - start]  # others belong to a later slab
        yield np.sort(rows[near], axis=1)
    # Photographs may show different parts of a defect larger than the ceiling: these few are searched farther.
    half = observations.half_diagonal_m
    large = np.flatnonzero(2 * half > settings.reach_m)
    if len(large) == 0:
        return
    tree = cKDTree(xyz)
    for start in range(0, len(large), _BATCH_LARGE):
        rows = large[start : start + _BATCH_LARGE]
        lists = tree.query_ball_point(xyz[rows], 2 * half[rows])
        owner = np.repeat(rows, [len(found) for found in lists])
        other = np.concatenate([np.asarray(found, dtype=np.int64) for found in lists])
        gap = np.linalg.norm(xyz[owner] - xyz[other], axis=1)
        # A pair of two large observations is found twice; it is kept from the larger one, of equal ones from the first.
        unique = (half[owner] > half[other]) | ((half[owner] == half[other]) & (owner < other))
        kept = unique & (gap > settings.reach_m) & (gap <= half[owner] + half[other])
        yield np.sort(np.column_stack([owner[kept], other[kept]]), axis=1)


def concatenate_pairs(parts: list[ObservationPairs]) -> ObservationPairs:
    """Pairs one after the other."""
    no_values = np.zeros(0)
    no_rows = np.zeros(0, dtype=np.int64)
    empty = ObservationPairs(
        first=no_rows,
        second=no_rows,
        separation_m=no_values,
        sigmas=no_values,
        overlap=no_values,
        touching=np.zeros(0, dtype=bool),
    )
    with_empty = [empty, *parts]
    return ObservationPairs(
        first=np.concatenate([p.first for p in with_empty]),
        second=np.concatenate([p.second for p in with_empty]),
        separation_m=np.concatenate([p.separation_m for p in with_empty]),
        sigmas=np.concatenate([p.sigmas for p in with_empty]),
        overlap=np.concatenate([p.overlap for p in with_empty]),
        touching=np.concatenate([p.touching for p in with_empty]),
    )
