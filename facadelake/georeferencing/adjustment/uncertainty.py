"""How well an adjustment is known: formal covariance, what it would have been without a part of the building, and
what it says of points that are left out.

The formal covariance takes every tie point's error for independent. On real facades errors hang together: reflections
in panes, foliage, a lens that the model holds only roughly. So the block is adjusted again without one region of the
building at a time (delete-a-group jackknife); how far the cameras move is what such errors can do, and is added.
Source: Busing et al. 1999, Statistics and Computing 9 (delete-m jackknife).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.cluster.vq import kmeans2

from facadelake.core.arrays import Float64Array, RowIndices
from facadelake.georeferencing.adjustment.linearise import ParameterIndex
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.reduced_system import ReducedCameraSystem, build_reduced_system
from facadelake.georeferencing.adjustment.solve import Solution, compute_covariance, solve_step

_REGIONS = 8
_SEED = 1
_MAX_CLUSTERED = 20_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """``covariance`` (g, g) of the kept unknowns, honest; ``formal`` (g, g), as the sigmas alone have it; the reduced
    system that ``formal`` is the inverse of."""

    covariance: Float64Array
    formal: Float64Array
    system: ReducedCameraSystem

    def compute_point_covariance(self, nodes: RowIndices) -> Float64Array:
        """Formal covariance (k, 3, 3) of ``nodes`` (k,), cameras' included."""
        out = np.empty((len(nodes), 3, 3))
        coupling = self.system.coupling
        for k, node in enumerate(nodes):
            first, last = np.searchsorted(coupling.point, (node, node + 1))
            rows, place = np.unique(coupling.row[first:last], return_inverse=True)
            dense = np.zeros((len(rows), 3))
            np.add.at(dense, place, coupling.value[first:last])
            own = self.system.point_covariance_m2[node]
            pulled = dense @ own
            out[k] = own + pulled.T @ self.formal[np.ix_(rows, rows)] @ pulled
        return out


def estimate_uncertainty(
    problem: AdjustmentProblem, solution: Solution, ties: int, tie_variance_factor: float
) -> Uncertainty:
    """The covariance of a solved problem.

    Its first ``ties`` nodes are tie points, whose variance is multiplied by ``tie_variance_factor``.
    """
    system, formal = compute_covariance(problem, solution, tie_variance_factor)
    moves = _compute_jackknife_steps(problem, solution, ties)
    away = moves - moves.mean(axis=0)
    spread = (len(moves) - 1) / len(moves) * (away.T @ away) if len(moves) else np.zeros_like(formal)
    return Uncertainty(covariance=formal + spread, formal=formal, system=system)


def _compute_jackknife_steps(problem: AdjustmentProblem, solution: Solution, ties: int) -> Float64Array:
    """What the kept unknowns (r, g) would move by, to first order, without the tie points of each region."""
    xyz = solution.state.xyz_site_m[:ties]
    if len(xyz) < 10 * _REGIONS:
        return np.zeros((0, ParameterIndex.build(problem).size))
    rng = np.random.default_rng(_SEED)
    draw = rng.choice(len(xyz), min(len(xyz), _MAX_CLUSTERED), replace=False)
    centres, _ = kmeans2(xyz[draw], _REGIONS, minit="++", rng=rng)
    region = np.linalg.norm(xyz[:, None, :] - centres[None], axis=2).argmin(axis=1)
    seen = problem.image_points
    region_of = np.full(len(seen.point), -1)
    tie = seen.point < ties
    region_of[tie] = region[seen.point[tie]]
    return np.array([_compute_step_without(problem, solution, region_of == number) for number in range(_REGIONS)])


def _compute_step_without(problem: AdjustmentProblem, solution: Solution, left_out: Float64Array) -> Float64Array:
    """One Gauss-Newton step from the solution with the sightings ``left_out`` (k,) given next to no weight."""
    # Leaving rows out would change the nodes' order; a thousandth of the weight leaves them as good as out.
    whitening = problem.image_points.whitening * np.where(left_out, 1e-3, 1.0)[:, None, None]
    without = replace(problem, image_points=replace(problem.image_points, whitening=whitening))
    return solve_step(without, build_reduced_system(without, solution.state, solution.tie_sigma_px))


def compute_leave_one_out_residual(
    residual: Float64Array, node_covariance: Float64Array, prior_variance: Float64Array
) -> Float64Array:
    """What ``given - adjusted`` (k, 3) would be, had each point's own prior been left out: (k, 3).

    ``point_covariance_m2`` (k, 3, 3) with the prior, whose variances are ``prior_variance`` (k, 3). Exact for a linear
    problem. Source: Cook and Weisberg 1982, Residuals and influence in regression, 2.2.
    """
    share = node_covariance / prior_variance[:, None, :]
    left: Float64Array = np.linalg.solve(np.eye(3) - share, residual[:, :, None])[:, :, 0].astype(np.float64)
    return left
