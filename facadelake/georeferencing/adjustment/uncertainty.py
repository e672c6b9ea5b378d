"""Covariance of an adjustment: the formal one, enlarged by a delete-a-group jackknife over regions of the building.

The formal covariance takes the errors of all image points as independent. On real facades they are correlated:
reflections in panes, foliage, lens distortion outside the model. The adjustment is therefore repeated, to first order,
without one region of the building at a time; the scatter of the results is added.
Source: Busing et al. 1999, Statistics and Computing 9 (delete-m jackknife).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.cluster.vq import kmeans2

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx2, Float64Nx3, Float64Nx3x3, RowIndices
from facadelake.georeferencing.adjustment.parameters import ParameterIndex
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.reduced_system import ReducedCameraSystem, build_reduced_system
from facadelake.georeferencing.adjustment.solve import Solution, compute_covariance, solve_step

_REGIONS = 8
_ROUNDS = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """Covariances (g, g) of the reduced system's parameters.

    ``formal``: the inverse of ``system``, from the sigmas of the observations. ``covariance``: with the jackknife's
    scatter added.
    """

    covariance: Float64Array
    formal: Float64Array
    system: ReducedCameraSystem

    def compute_point_covariance(self, points: RowIndices) -> Float64Nx3x3:
        """Formal covariance (k, 3, 3) in m2 of object ``points`` (k,), with the contribution of the cameras."""
        out = np.empty((len(points), 3, 3))
        coupling = self.system.coupling
        for k, point in enumerate(points):
            first, last = np.searchsorted(coupling.point, (point, point + 1))
            rows, position = np.unique(coupling.row[first:last], return_inverse=True)
            dense = np.zeros((len(rows), 3))
            np.add.at(dense, position, coupling.value[first:last])
            conditional = self.system.point_covariance_m2[point]
            propagated = dense @ conditional
            out[k] = conditional + propagated.T @ self.formal[np.ix_(rows, rows)] @ propagated
        return out


def estimate_uncertainty(
    problem: AdjustmentProblem, solution: Solution, tie_point_count: int, tie_variance_factor: float
) -> Uncertainty:
    """Covariance of a solved adjustment.

    Args:
        problem: the adjustment.
        solution: its solution.
        tie_point_count: number of tie points, which stand first among the object points.
        tie_variance_factor: factor on the variance of their image coordinates, for correlation between neighbours.

    Returns:
        formal covariance and covariance with the jackknife's scatter.
    """
    system, formal = compute_covariance(problem, solution, tie_variance_factor)
    steps = _compute_jackknife_steps(problem, solution, tie_point_count)
    deviation = steps - steps.mean(axis=0)
    spread = (len(steps) - 1) / len(steps) * (deviation.T @ deviation) if len(steps) else np.zeros_like(formal)
    return Uncertainty(covariance=formal + spread, formal=formal, system=system)


def _compute_jackknife_steps(problem: AdjustmentProblem, solution: Solution, tie_point_count: int) -> Float64Array:
    """Changes (r, g) of the parameters, to first order, without the tie points of each of r regions."""
    xyz = solution.state.xyz_site_m[:tie_point_count]
    if len(xyz) < 10 * _REGIONS:
        return np.zeros((0, ParameterIndex.build(problem).size))
    region = _assign_regions(xyz)
    image_points = problem.image_points
    region_of = np.full(len(image_points.point), -1)
    tie = image_points.point < tie_point_count
    region_of[tie] = region[image_points.point[tie]]
    return np.array([_compute_step_without(problem, solution, region_of == number) for number in range(_REGIONS)])


def _assign_regions(xyz_site_m: Float64Nx3) -> RowIndices:
    """Regions 0 to 7 (n,) of the tie points, compact and of like size: k-means, without the outermost points.

    It starts from the halves of halves of the building in plan, not from a random draw: a block that differs by a few
    points has the same regions, so that a sigma stays the same when a campaign is adjusted anew.
    """
    low, high = np.percentile(xyz_site_m, [1, 99], axis=0)
    inner = xyz_site_m[((xyz_site_m >= low) & (xyz_site_m <= high)).all(axis=1)]
    part = _halve_in_plan(inner)
    start = np.array([np.median(inner[part == number], axis=0) for number in range(_REGIONS)])
    centres, _ = kmeans2(inner, start, iter=_ROUNDS, minit="matrix")
    region: RowIndices = np.linalg.norm(xyz_site_m[:, None, :] - centres[None], axis=2).argmin(axis=1)
    return region


def _halve_in_plan(xyz_site_m: Float64Nx3) -> RowIndices:
    """Parts 0 to 7 (n,) of equally many points, halved three times across their longer side in plan."""
    xy = xyz_site_m[:, :2]
    part = np.zeros(len(xy), dtype=np.int64)
    for halving in range(3):
        for number in range(2**halving):
            rows = np.flatnonzero(part == number)
            along = xy[rows] @ _find_longer_side(xy[rows])
            order = np.argsort(along, kind="stable")
            part[rows[order[len(rows) // 2 :]]] += 2**halving
    return part


def _find_longer_side(xy_m: Float64Nx2) -> Float64N:
    """Direction (2,) in which points (n, 2) extend farthest."""
    _, directions = np.linalg.eigh(np.cov(xy_m.T))
    longer: Float64N = directions[:, 1] * np.sign(directions[np.abs(directions[:, 1]).argmax(), 1])
    return longer


def _compute_step_without(problem: AdjustmentProblem, solution: Solution, left_out: BoolArray) -> Float64N:
    """One Gauss-Newton step from the solution with the image points ``left_out`` (k,) given almost no weight."""
    # Leaving rows out would change the order of the points; a thousandth of the whitening has the same effect.
    whitening = problem.image_points.whitening * np.where(left_out, 1e-3, 1.0)[:, None, None]
    without = replace(problem, image_points=replace(problem.image_points, whitening=whitening))
    return solve_step(without, build_reduced_system(without, solution.state, solution.tie_sigma_px))


def compute_leave_one_out_residual(
    residual: Float64Nx3, point_covariance: Float64Nx3x3, prior_variance: Float64Nx3
) -> Float64Nx3:
    """Residuals ``given - adjusted`` (k, 3) of points, had each point's own prior been left out.

    ``residual`` (k, 3) and ``point_covariance`` (k, 3, 3) are those with the prior, whose variances are
    ``prior_variance`` (k, 3). Exact for a linear problem. Source: Cook and Weisberg 1982, Residuals and influence in
    regression, section 2.2.
    """
    leverage = point_covariance / prior_variance[:, None, :]
    left_out: Float64Array = np.linalg.solve(np.eye(3) - leverage, residual[:, :, None])[:, :, 0].astype(np.float64)
    return left_out
