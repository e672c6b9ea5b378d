"""Pairs of a known defect and a defect of the next campaign that may be the same, and how well each pair agrees.

Two statements decide between "the same defect" and "two unrelated defects": the displacement on the surface, in
proportion to its covariance, and the change of class and size. What both campaigns' frames share cancels beforehand
(``frame_offsets``).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Int64Array, RowIndices
from facadelake.registration import compute_tangents
from facadelake.tracking.campaign_defects import CLASSES, DefectArrays

EXTENT_NOISE = 0.08  # one sigma of a box's edges as a share of its extent (a detector's jitter)
GROWTH_SHARE = 0.25  # one sigma of the centre's shift by growth at one end, as a share of the extent
_NORMAL_GATE_M = 0.25  # relief of a facade that one campaign may have seen and the other not
_FACING_MIN = -0.2  # cosine of two normals; surfaces that face further apart do not show one defect
_GATE_SIGMAS = 4.0
_REACH_MAX_M = 3.0
_CLASS_KEPT = 0.95  # probability that a defect has the same class next time (detector's confusion, spalled cracks)
_LOG_SIZE_SIGMA, _LOG_GROWTH_SIGMA, _GROWN_SHARE = 0.15, 0.5, 0.25  # of the same defect: repeated, or changed


@dataclass(frozen=True, kw_only=True, eq=False)
class CandidatePairs:
    """Pairs (k): rows ``known`` and ``found``; ``displacement_m`` (k, 3): found minus known, without the offset.

    ``mahalanobis`` (k,): distance on the surface in proportion to its covariance. ``log_ratio`` (k,): log of the
    density of this displacement, class and size for one defect, over that of two unrelated ones of which there are one
    in a square metre.
    """

    known: RowIndices
    found: RowIndices
    displacement_m: Float64Nx3
    mahalanobis: Float64N
    log_ratio: Float64N

    def __len__(self) -> int:
        return len(self.known)


def find_candidates(known: DefectArrays, found: DefectArrays, offset_m: Float64Nx3, reach_m: float) -> CandidatePairs:
    """Pairs within the gate of position, with their likelihood ratios.

    Args:
        known: known defects, as last seen.
        found: defects of the next campaign.
        offset_m: offset (n, 3) of the next campaign's frame at each of its defects, which is subtracted.
        reach_m: one sigma of the offset that remains.

    Returns:
        The pairs, ordered by ``known`` and ``found``.
    """
    rows = _find_near(known, found, offset_m, reach_m)
    i, j = rows.T
    displacement = found.xyz_site_m[j] - offset_m[j] - known.xyz_site_m[i]
    across, upward = compute_tangents(known.normal_site[i])
    plane = np.stack([across, upward], axis=1)
    residual = np.einsum("kij,kj->ki", plane, displacement)
    covariance = (
        np.einsum("kij,kjl,kml->kim", plane, known.covariance_m2[i] + found.covariance_m2[j], plane)
        + reach_m**2 * np.eye(2)
        + _compute_extent_variance(known, i, found, j)
    )
    squared = np.einsum("ki,ki->k", residual, np.linalg.solve(covariance, residual[:, :, None])[:, :, 0])
    along_normal = np.abs(np.einsum("ki,ki->k", known.normal_site[i], displacement))
    sigma_normal = np.sqrt(
        np.einsum(
            "ki,kij,kj->k", known.normal_site[i], known.covariance_m2[i] + found.covariance_m2[j], known.normal_site[i]
        )
        + reach_m**2
    )
    facing = np.einsum("ki,ki->k", known.normal_site[i], found.normal_site[j])
    inside = (
        (squared <= _GATE_SIGMAS**2)
        & (along_normal <= _NORMAL_GATE_M + _GATE_SIGMAS * sigma_normal)
        & (facing >= _FACING_MIN)
    )
    log_position = -0.5 * squared - np.log(2 * np.pi) - 0.5 * np.log(np.linalg.det(covariance))
    log_ratio = log_position + _compute_class_ratio(known, i, found, j) + _compute_size_ratio(known, i, found, j)
    return CandidatePairs(
        known=i[inside],
        found=j[inside],
        displacement_m=displacement[inside],
        mahalanobis=np.sqrt(squared[inside]),
        log_ratio=log_ratio[inside],
    )


def _find_near(known: DefectArrays, found: DefectArrays, offset_m: Float64Nx3, reach_m: float) -> Int64Array:
    """Rows (k, 2) of pairs that can lie within the gate."""
    if not len(known) or not len(found):
        return np.zeros((0, 2), dtype=np.int64)
    radius = _compute_radius(known, reach_m)[:, None]
    limit = _compute_radius(found, reach_m)
    tree = cKDTree(found.xyz_site_m - offset_m)
    near = tree.query_ball_point(known.xyz_site_m, np.minimum(radius[:, 0] + limit.max(), _REACH_MAX_M * 2))
    counts = [len(others) for others in near]
    found_rows = np.fromiter(chain.from_iterable(near), dtype=np.int64, count=sum(counts))
    pairs = np.column_stack([np.repeat(np.arange(len(counts)), counts), found_rows])
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    distance = np.linalg.norm(
        found.xyz_site_m[pairs[:, 1]] - offset_m[pairs[:, 1]] - known.xyz_site_m[pairs[:, 0]], axis=1
    )
    inside: Int64Array = pairs[distance <= radius[pairs[:, 0], 0] + limit[pairs[:, 1]]]
    return inside


def _compute_radius(defects: DefectArrays, reach_m: float) -> Float64N:
    """Distance (n,) within which the other defect of a pair must lie."""
    largest = np.sqrt(np.linalg.eigvalsh(defects.covariance_m2)[:, -1])
    radius: Float64N = _GATE_SIGMAS * (largest + reach_m + (EXTENT_NOISE + GROWTH_SHARE) * defects.extent_m)
    return np.minimum(radius + _NORMAL_GATE_M, _REACH_MAX_M)


def _compute_extent_variance(known: DefectArrays, i: RowIndices, found: DefectArrays, j: RowIndices) -> Float64Array:
    """Variance (k, 2, 2) of the centre due to jitter of the box, and to growth at one end."""
    out = np.zeros((len(i), 2, 2))
    for axis, name in enumerate(("width_m", "height_m")):
        first, second = getattr(known, name)[i], getattr(found, name)[j]
        jitter = EXTENT_NOISE**2 / 2 * (first**2 + second**2)
        # A part that was added at one end moves the centre by half of it.
        out[:, axis, axis] = jitter + (GROWTH_SHARE * (second - first)) ** 2
    return out


def _compute_class_ratio(known: DefectArrays, i: RowIndices, found: DefectArrays, j: RowIndices) -> Float64N:
    """Log ratio (k,) of the classes: kept with a fixed probability, or those of unrelated defects by their shares."""
    counts = np.bincount(np.concatenate([known.defect_class, found.defect_class]), minlength=len(CLASSES)) + 1.0
    share = counts / counts.sum()
    same = known.defect_class[i] == found.defect_class[j]
    kept = np.where(same, _CLASS_KEPT, (1 - _CLASS_KEPT) / (len(CLASSES) - 1))
    ratio: Float64N = np.log(kept / share[found.defect_class[j]])
    return ratio


def _compute_size_ratio(known: DefectArrays, i: RowIndices, found: DefectArrays, j: RowIndices) -> Float64N:
    """Log ratio (k,) of the sizes: of one defect repeated or changed, against two drawn from the population."""
    logs = np.log(np.maximum(np.concatenate([known.extent_m, found.extent_m]), 1e-3))
    spread = max(float(np.std(logs)), 0.3) * np.sqrt(2)
    change = np.log(np.maximum(found.extent_m[j], 1e-3) / np.maximum(known.extent_m[i], 1e-3))
    one = (1 - _GROWN_SHARE) * _evaluate_normal(change, _LOG_SIZE_SIGMA) + _GROWN_SHARE * _evaluate_normal(
        change, _LOG_GROWTH_SIGMA
    )
    ratio: Float64N = np.log(np.maximum(one, 1e-12)) - np.log(_evaluate_normal(change, spread))
    return ratio


def _evaluate_normal(value: Float64N, sigma: float) -> Float64N:
    density: Float64N = np.exp(-0.5 * (value / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    return density
