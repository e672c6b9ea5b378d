"""Where defects are: all their sightings' rays at once, with the model's surface as what is known beforehand.

Each sighting is a ray that is good to its own noise across. A defect lies on the model's surface to the building's
relief; rays that cross lift it off by what the model does not know. One wrong box of several pulls little: residuals
weigh as those of Student's t. How noisy the boxes are, and how far the building stands off its model, is estimated
from the campaign itself (variance components), with the settings as what is known before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, RowIndices
from facadelake.core.parallel import map_blocks
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import PositionNoise, compute_observation_covariance
from facadelake.registration import compute_tangents

_ITERATIONS = 12
_STUDENT_T_DOF = 4.0  # of Student's t: one residual in fifty lies beyond 3.5 sigmas instead of one in 2,000
_CHI2_MEDIAN = (0.4549, 1.3863)  # median of chi-square with one and two degrees of freedom
_RELIEF_MIN_M = 0.005  # no wall is flatter than its plaster
_VARIANCE_RATIO_MIN = 1e-4  # of what was known before: nothing is a hundred times better than that
_BATCH_GROUPS = 4000
_FREE_SIGMA_M = 10.0  # a surface that holds nothing


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePlanes:
    """The model's surface at g defects: a point (g, 3), its unit normal (g, 3) outward."""

    xyz_site_m: Float64Array
    normal_site: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TriangulatedPoints:
    """Places of g defects: ``xyz_site_m`` (g, 3), ``covariance_m2`` (g, 3, 3), ``cost`` (g,) of the rays and the
    surface in squared sigmas, ``normal_sigma_m`` (g,): along the normal, by the rays alone (inf: they do not cross)."""

    xyz_site_m: Float64Array
    covariance_m2: Float64Array
    cost: Float64Array
    normal_sigma_m: Float64Array


class GroupRays:
    """The rays of sightings in groups: ``rows`` (n,) of the sightings, group after group; ``group`` (n,) ascending from
    0 without gaps."""

    def __init__(self, sightings: ObservationArrays, rows: RowIndices, group: RowIndices, noise: PositionNoise) -> None:
        self.rows, self.group = rows, group
        self.starts: RowIndices = np.flatnonzero(np.r_[True, np.diff(group) != 0][: len(group)])
        self.count: RowIndices = np.diff(np.r_[self.starts, len(group)])
        self.hit_site_m, ray = sightings.xyz_site_m[rows], sightings.ray_site[rows]
        across, upward = compute_tangents(ray)
        basis = np.stack([across, upward], axis=2)
        spread = basis.transpose(0, 2, 1) @ compute_observation_covariance(sightings, noise)[rows] @ basis
        # What a ray says of the place: nothing along itself.
        self.information: Float64Array = basis @ np.linalg.inv(spread) @ basis.transpose(0, 2, 1)
        self.information_vector: Float64Array = (self.information @ self.hit_site_m[:, :, None])[:, :, 0]

    def select_groups(self, groups: slice) -> GroupRays:
        """The rays of some groups that follow one another."""
        own = object.__new__(GroupRays)
        start = int(self.starts[groups.start])
        stop = int(self.starts[groups.stop]) if groups.stop < len(self.starts) else len(self.group)
        own.rows, own.group = self.rows[start:stop], self.group[start:stop] - groups.start
        own.starts, own.count = self.starts[groups] - start, self.count[groups]
        own.hit_site_m, own.information, own.information_vector = (
            self.hit_site_m[start:stop],
            self.information[start:stop],
            self.information_vector[start:stop],
        )
        return own

    def sum_groups(self, values: Float64Array) -> Float64Array:
        """Sums (g, ...) over the rays of each group."""
        total: Float64Array = np.add.reduceat(values, self.starts, axis=0)
        return total

    def compute_squared_residuals(self, xyz_site_m: Float64Array) -> Float64Array:
        """Squared residuals (n,) in sigmas of the rays from places (g, 3)."""
        gap = np.repeat(xyz_site_m, self.count, axis=0) - self.hit_site_m
        squares: Float64Array = (gap * (self.information @ gap[:, :, None])[:, :, 0]).sum(axis=1)
        return squares

    def find_nearest(self, xyz_site_m: Float64Array) -> RowIndices:
        """For each group the ray (g,) whose hit lies nearest to its place."""
        gap = np.linalg.norm(np.repeat(xyz_site_m, self.count, axis=0) - self.hit_site_m, axis=1)
        order = np.lexsort((np.arange(len(gap)), gap, self.group))
        return order[self.starts]

    def compute_medians(self) -> Float64Array:
        """Median places (g, 3) of the hits, an axis at a time: where to begin."""
        middle = np.empty((len(self.starts), 3))
        low, high = self.starts + (self.count - 1) // 2, self.starts + self.count // 2
        for axis in range(3):
            ordered = self.hit_site_m[np.lexsort((self.hit_site_m[:, axis], self.group)), axis]
            middle[:, axis] = (ordered[low] + ordered[high]) / 2
        return middle


def find_planes(sightings: ObservationArrays, rays: GroupRays) -> SurfacePlanes:
    """The surface at each group: where the ray that is nearest to the middle of all met it."""
    rows = rays.rows[rays.find_nearest(rays.compute_medians())]
    return SurfacePlanes(xyz_site_m=sightings.xyz_site_m[rows], normal_site=sightings.normal_site[rows])


def triangulate_groups(rays: GroupRays, planes: SurfacePlanes, hold_m: float) -> TriangulatedPoints:
    """The places nearest to all rays of each group, held to the plane to ``hold_m`` (one sigma).

    Weighted least squares, repeated with the weights of Student's t for the rays and for the surface. Groups are taken
    some thousands at a time: what is repeated then stays in the processor's cache, and several processors share it.
    """
    count = len(rays.starts)
    parts = [slice(start, min(start + _BATCH_GROUPS, count)) for start in range(0, count, _BATCH_GROUPS)]

    def part(groups: slice) -> TriangulatedPoints:
        own = SurfacePlanes(xyz_site_m=planes.xyz_site_m[groups], normal_site=planes.normal_site[groups])
        return _triangulate_batch(rays.select_groups(groups), own, hold_m)

    found = map_blocks(part, parts)
    return TriangulatedPoints(
        xyz_site_m=np.concatenate([f.xyz_site_m for f in found]),
        covariance_m2=np.concatenate([f.covariance_m2 for f in found]),
        cost=np.concatenate([f.cost for f in found]),
        normal_sigma_m=np.concatenate([f.normal_sigma_m for f in found]),
    )


def _triangulate_batch(rays: GroupRays, planes: SurfacePlanes, hold: float) -> TriangulatedPoints:
    normal = planes.normal_site
    outer = normal[:, :, None] * normal[:, None, :]
    place = rays.compute_medians()
    for _ in range(_ITERATIONS):
        weight: Float64Array = (_STUDENT_T_DOF + 2) / (_STUDENT_T_DOF + rays.compute_squared_residuals(place))
        off = np.einsum("gi,gi->g", place - planes.xyz_site_m, normal) / hold
        held = (_STUDENT_T_DOF + 1) / (_STUDENT_T_DOF + off**2) / hold**2
        told = rays.sum_groups(weight[:, None, None] * rays.information)
        right = rays.sum_groups(weight[:, None] * rays.information_vector)
        system = told + held[:, None, None] * outer
        right += (held * np.einsum("gi,gi->g", planes.xyz_site_m, normal))[:, None] * normal
        place = np.linalg.solve(system, right[:, :, None])[:, :, 0]
    # A residual smaller than expected makes no ray better than it is.
    sure = np.minimum(weight, 1.0)[:, None, None] * rays.information
    told = rays.sum_groups(sure)
    covariance = np.asarray(np.linalg.inv(told + outer / hold**2), dtype=np.float64)
    # Along the normal by the rays alone: the information left once the other two directions are free.
    loose = np.linalg.inv(told + outer / _FREE_SIGMA_M**2)
    variance = np.einsum("gi,gij,gj->g", normal, loose, normal)
    alone = np.where(variance < 0.5 * _FREE_SIGMA_M**2, np.sqrt(np.maximum(variance, 0.0)), np.inf)
    cost = rays.sum_groups((_STUDENT_T_DOF + 2) * np.log1p(rays.compute_squared_residuals(place) / _STUDENT_T_DOF))
    cost += (_STUDENT_T_DOF + 1) * np.log1p(off**2 / _STUDENT_T_DOF)
    return TriangulatedPoints(xyz_site_m=place, covariance_m2=covariance, cost=cost, normal_sigma_m=alone)


@dataclass(frozen=True, kw_only=True)
class VarianceEstimate:
    """A variance that a campaign shows: ``value`` from ``count`` samples; nothing where there are none."""

    value: float = 0.0
    count: int = 0

    def combine_with_prior(self, before: float, worth: float) -> float:
        """The variance together with one known ``before``, which is worth so many samples: their weighted geometric
        mean, as a variance may be off by any factor."""
        if self.count == 0:
            return before
        share = self.count / (self.count + worth)
        return float(max(self.value, _VARIANCE_RATIO_MIN * before) ** share * before ** (1 - share))


def estimate_variances(
    sightings: ObservationArrays, rays: GroupRays, relief_m: float
) -> tuple[VarianceEstimate, VarianceEstimate]:
    """The variance of the rays, in those that ``rays`` were made with, and that of the building off its model in m2.

    By what groups of three and more rays leave over, and by how far off the model those lie whose rays tell it better
    than ``relief_m``. Medians, so that groups that are wrong say little.
    """
    planes = find_planes(sightings, rays)
    free = triangulate_groups(rays, planes, _FREE_SIGMA_M)
    enough = rays.count >= 3
    if not enough.any():
        return VarianceEstimate(), VarianceEstimate()
    # Two coordinates a ray, three unknowns a group: what is left of a residual's square is this share.
    squares = rays.compute_squared_residuals(free.xyz_site_m) / np.repeat(1 - 1.5 / rays.count, rays.count)
    used = squares[np.repeat(enough, rays.count)]
    factor = VarianceEstimate(value=float(np.median(used)) / _CHI2_MEDIAN[1], count=len(used))
    off = np.einsum("gi,gi->g", free.xyz_site_m - planes.xyz_site_m, planes.normal_site)
    variance = max(factor.value, _VARIANCE_RATIO_MIN) * free.normal_sigma_m**2
    sure = enough & (variance < relief_m**2)
    if not sure.any():
        return factor, VarianceEstimate()
    found = float(np.median(off[sure] ** 2)) / _CHI2_MEDIAN[0] - float(np.median(variance[sure]))
    return factor, VarianceEstimate(value=max(found, _RELIEF_MIN_M**2), count=int(sure.sum()))
