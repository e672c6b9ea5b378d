"""Triangulation of defects from the rays of all their observations, with the model's surface as prior.

Each observation is a ray with its own error across. A defect is on the model's surface to the relief of the building;
intersecting rays determine the deviation from it. Residuals are weighted by Student's t distribution, so that one wrong
box of several has little influence. The noise of the boxes and the distance of the building from its model are
estimated from the campaign itself (variance components), with those of the settings as prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64Nx3x3, RowIndices
from facadelake.core.parallel import map_blocks
from facadelake.deduplication.candidate_pairs import PositionNoise, compute_observation_covariance
from facadelake.deduplication.observations import ObservationArrays
from facadelake.registration import compute_tangents

_ITERATIONS = 12
_STUDENT_T_DOF = 4.0  # 2 % of the residuals are beyond 3.5 sigmas, instead of 0.05 %
_CHI2_MEDIAN = (0.4549, 1.3863)  # of chi-square with one and two degrees of freedom
_RELIEF_MIN_M = 0.005  # unevenness of plaster
_VARIANCE_RATIO_MIN = 1e-4  # of an estimate to its prior: a sigma is at least a hundredth of its prior
_BATCH_GROUPS = 4000
_FREE_SIGMA_M = 10.0  # one sigma of a surface that does not constrain the position


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePlanes:
    """The model's surface at g defects: a point (g, 3) and its unit outward normal (g, 3)."""

    xyz_site_m: Float64Nx3
    normal_site: Float64Nx3


@dataclass(frozen=True, kw_only=True, eq=False)
class TriangulatedPoints:
    """Positions of g defects.

    ``xyz_site_m`` (g, 3); ``covariance_m2`` (g, 3, 3); ``cost`` (g,): of rays and surface, in squared sigmas;
    ``normal_sigma_m`` (g,): one sigma along the normal by the rays alone, inf where they do not intersect.
    """

    xyz_site_m: Float64Nx3
    covariance_m2: Float64Nx3x3
    cost: Float64N
    normal_sigma_m: Float64N


class GroupRays:
    """The rays of observations in groups.

    Args:
        observations: the observations.
        rows: rows (n,) of the observations, group after group.
        group: group (n,) of each ray, ascending from 0 without gaps.
        noise: noise of the observations, which gives the information matrices (n, 3, 3) of the rays.
    """

    def __init__(
        self, observations: ObservationArrays, rows: RowIndices, group: RowIndices, noise: PositionNoise
    ) -> None:
        self.rows, self.group = rows, group
        self.starts: RowIndices = np.flatnonzero(np.r_[True, np.diff(group) != 0][: len(group)])
        self.count: RowIndices = np.diff(np.r_[self.starts, len(group)])
        self.hit_site_m, ray = observations.xyz_site_m[rows], observations.ray_site[rows]
        across, upward = compute_tangents(ray)
        basis = np.stack([across, upward], axis=2)
        covariance = basis.transpose(0, 2, 1) @ compute_observation_covariance(observations, noise)[rows] @ basis
        # Information of a ray on the position: none along itself.
        self.information: Float64Array = basis @ np.linalg.inv(covariance) @ basis.transpose(0, 2, 1)
        self.information_vector: Float64Array = (self.information @ self.hit_site_m[:, :, None])[:, :, 0]

    def select_groups(self, groups: slice) -> GroupRays:
        """The rays of consecutive groups."""
        selected = object.__new__(GroupRays)
        start = int(self.starts[groups.start])
        stop = int(self.starts[groups.stop]) if groups.stop < len(self.starts) else len(self.group)
        selected.rows, selected.group = self.rows[start:stop], self.group[start:stop] - groups.start
        selected.starts, selected.count = self.starts[groups] - start, self.count[groups]
        selected.hit_site_m, selected.information, selected.information_vector = (
            self.hit_site_m[start:stop],
            self.information[start:stop],
            self.information_vector[start:stop],
        )
        return selected

    def sum_groups(self, values: Float64Array) -> Float64Array:
        """Sums (g, ...) over the rays of each group."""
        total: Float64Array = np.add.reduceat(values, self.starts, axis=0)
        return total

    def compute_squared_residuals(self, xyz_site_m: Float64Nx3) -> Float64N:
        """Squared residuals (n,) of the rays from positions (g, 3), in sigmas."""
        difference = np.repeat(xyz_site_m, self.count, axis=0) - self.hit_site_m
        squares: Float64Array = (difference * (self.information @ difference[:, :, None])[:, :, 0]).sum(axis=1)
        return squares

    def find_nearest(self, xyz_site_m: Float64Nx3) -> RowIndices:
        """The ray (g,) of each group whose hit is nearest to the position ``xyz_site_m`` (g, 3)."""
        distance = np.linalg.norm(np.repeat(xyz_site_m, self.count, axis=0) - self.hit_site_m, axis=1)
        order = np.lexsort((np.arange(len(distance)), distance, self.group))
        return order[self.starts]

    def compute_medians(self) -> Float64Nx3:
        """Medians (g, 3) of the hits, per axis: initial positions."""
        median = np.empty((len(self.starts), 3))
        low, high = self.starts + (self.count - 1) // 2, self.starts + self.count // 2
        for axis in range(3):
            ordered = self.hit_site_m[np.lexsort((self.hit_site_m[:, axis], self.group)), axis]
            median[:, axis] = (ordered[low] + ordered[high]) / 2
        return median


def find_planes(observations: ObservationArrays, rays: GroupRays) -> SurfacePlanes:
    """The surface at each group: where the ray nearest to the median position hit it."""
    rows = rays.rows[rays.find_nearest(rays.compute_medians())]
    return SurfacePlanes(xyz_site_m=observations.xyz_site_m[rows], normal_site=observations.normal_site[rows])


def triangulate_groups(rays: GroupRays, planes: SurfacePlanes, plane_sigma_m: float) -> TriangulatedPoints:
    """The position of each group nearest to all its rays and to the plane, whose one sigma is ``plane_sigma_m``.

    Iteratively reweighted least squares, with the weights of Student's t for the rays and for the plane. Groups are
    processed in batches that fit the processor's cache, in parallel.
    """
    count = len(rays.starts)
    parts = [slice(start, min(start + _BATCH_GROUPS, count)) for start in range(0, count, _BATCH_GROUPS)]

    def triangulate(groups: slice) -> TriangulatedPoints:
        batch_planes = SurfacePlanes(xyz_site_m=planes.xyz_site_m[groups], normal_site=planes.normal_site[groups])
        return _triangulate_batch(rays.select_groups(groups), batch_planes, plane_sigma_m)

    found = map_blocks(triangulate, parts)
    return TriangulatedPoints(
        xyz_site_m=np.concatenate([f.xyz_site_m for f in found]),
        covariance_m2=np.concatenate([f.covariance_m2 for f in found]),
        cost=np.concatenate([f.cost for f in found]),
        normal_sigma_m=np.concatenate([f.normal_sigma_m for f in found]),
    )


def _triangulate_batch(rays: GroupRays, planes: SurfacePlanes, plane_sigma_m: float) -> TriangulatedPoints:
    """``triangulate_groups`` for one batch."""
    normal = planes.normal_site
    outer = normal[:, :, None] * normal[:, None, :]
    position = rays.compute_medians()
    for _ in range(_ITERATIONS):
        weight: Float64Array = (_STUDENT_T_DOF + 2) / (_STUDENT_T_DOF + rays.compute_squared_residuals(position))
        offset = np.einsum("gi,gi->g", position - planes.xyz_site_m, normal) / plane_sigma_m
        plane_weight = (_STUDENT_T_DOF + 1) / (_STUDENT_T_DOF + offset**2) / plane_sigma_m**2
        information = rays.sum_groups(weight[:, None, None] * rays.information)
        right = rays.sum_groups(weight[:, None] * rays.information_vector)
        system = information + plane_weight[:, None, None] * outer
        right += (plane_weight * np.einsum("gi,gi->g", planes.xyz_site_m, normal))[:, None] * normal
        position = np.linalg.solve(system, right[:, :, None])[:, :, 0]
    # A residual smaller than expected does not increase the weight of a ray.
    capped_information = np.minimum(weight, 1.0)[:, None, None] * rays.information
    information = rays.sum_groups(capped_information)
    covariance = np.asarray(np.linalg.inv(information + outer / plane_sigma_m**2), dtype=np.float64)
    # Along the normal by the rays alone: the marginal variance with a plane that does not constrain.
    free_covariance = np.linalg.inv(information + outer / _FREE_SIGMA_M**2)
    variance = np.einsum("gi,gij,gj->g", normal, free_covariance, normal)
    normal_sigma = np.where(variance < 0.5 * _FREE_SIGMA_M**2, np.sqrt(np.maximum(variance, 0.0)), np.inf)
    cost = rays.sum_groups((_STUDENT_T_DOF + 2) * np.log1p(rays.compute_squared_residuals(position) / _STUDENT_T_DOF))
    cost += (_STUDENT_T_DOF + 1) * np.log1p(offset**2 / _STUDENT_T_DOF)
    return TriangulatedPoints(xyz_site_m=position, covariance_m2=covariance, cost=cost, normal_sigma_m=normal_sigma)


@dataclass(frozen=True, kw_only=True)
class VarianceEstimate:
    """A variance estimated from a campaign: ``value`` from ``count`` samples; 0 from 0 samples where it cannot be."""

    value: float = 0.0
    count: int = 0

    def combine_with_prior(self, prior: float, prior_count: float) -> float:
        """The variance combined with a ``prior`` that is worth ``prior_count`` samples.

        Their weighted geometric mean, as a variance may be off by any factor.
        """
        if self.count == 0:
            return prior
        share = self.count / (self.count + prior_count)
        return float(max(self.value, _VARIANCE_RATIO_MIN * prior) ** share * prior ** (1 - share))


def estimate_variances(
    observations: ObservationArrays, rays: GroupRays, relief_m: float
) -> tuple[VarianceEstimate, VarianceEstimate]:
    """Variance components of a campaign.

    The variance of the rays follows from the residuals of groups with three or more rays, that of the distance of the
    building from its model from the groups whose rays determine it better than ``relief_m``. Medians are robust against
    wrong groups.

    Returns:
        The factor on the variance of the rays that ``rays`` assume, and the variance of the distance in m2.
    """
    planes = find_planes(observations, rays)
    free = triangulate_groups(rays, planes, _FREE_SIGMA_M)
    redundant = rays.count >= 3
    if not redundant.any():
        return VarianceEstimate(), VarianceEstimate()
    # Two coordinates per ray, three unknowns per group: expected share of a squared residual that remains.
    squares = rays.compute_squared_residuals(free.xyz_site_m) / np.repeat(1 - 1.5 / rays.count, rays.count)
    used = squares[np.repeat(redundant, rays.count)]
    factor = VarianceEstimate(value=float(np.median(used)) / _CHI2_MEDIAN[1], count=len(used))
    distance = np.einsum("gi,gi->g", free.xyz_site_m - planes.xyz_site_m, planes.normal_site)
    variance = max(factor.value, _VARIANCE_RATIO_MIN) * free.normal_sigma_m**2
    determined = redundant & (variance < relief_m**2)
    if not determined.any():
        return factor, VarianceEstimate()
    relief_variance = float(np.median(distance[determined] ** 2)) / _CHI2_MEDIAN[0] - float(
        np.median(variance[determined])
    )
    return factor, VarianceEstimate(value=max(relief_variance, _RELIEF_MIN_M**2), count=int(determined.sum()))
