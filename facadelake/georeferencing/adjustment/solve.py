"""Gauss-Newton with robust reweighting on the reduced normal equations."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from facadelake.core.arrays import Float64Array, RowIndices
from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.adjustment.linearise import (
    AdjustmentState,
    ParameterIndex,
    apply_step,
    compute_reprojection_residuals,
    initialise_state,
)
from facadelake.georeferencing.adjustment.parameter_priors import mask_fixed_parameters
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.reduced_system import ReducedCameraSystem, build_reduced_system, compute_cost

logger = logging.getLogger(__name__)

_MAX_ITERATIONS = 40
CONVERGED_M = 2e-4  # no camera moves more: far below any camera's sigma
_MAX_HALVINGS = 6
# Half of normal residuals in two dimensions lie within this many sigmas (Rayleigh's median).
_RAYLEIGH_MEDIAN = 1.1774
_MIN_SIGMA_PX = 0.05
_MIN_REDUNDANCY = 0.1  # a photograph with a handful of points tells nothing of their sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """The adjusted state, the tie points' sigma (px, each axis), how many steps it took and whether it settled."""

    state: AdjustmentState
    tie_sigma_px: float
    iterations: int
    converged: bool


def estimate_tie_sigma(problem: AdjustmentProblem, state: AdjustmentState) -> float:
    """One sigma (px) of a tie point's coordinate, from the median residual, so that outliers have no say.

    A point seen n times gives 2n coordinates and takes three unknowns, a photograph takes six of its own: residuals
    are smaller than errors by the root of that redundancy (by half where tracks have two photographs).
    """
    tie = problem.image_points.is_tie_point
    if not tie.any():
        return 1.0
    node, photo = problem.image_points.point[tie], problem.image_points.photo[tie]
    redundancy = 1.0 - 1.5 / np.bincount(node)[node] - 3.0 / np.bincount(photo)[photo]
    length = np.linalg.norm(compute_reprojection_residuals(problem, state, 1.0)[tie], axis=1)
    error = length / np.sqrt(np.maximum(redundancy, _MIN_REDUNDANCY))
    return max(float(np.median(error)) / _RAYLEIGH_MEDIAN, _MIN_SIGMA_PX)


def solve_adjustment(
    problem: AdjustmentProblem, start: AdjustmentState | None = None, *, settled_m: float = CONVERGED_M
) -> Solution:
    """Adjust from ``start`` (or the problem's own) until no camera moves by more than ``settled_m``.

    Raises GeoreferenceError where the observations leave an unknown open (the matrix is singular).
    """
    state = initialise_state(problem) if start is None else start
    sigma = estimate_tie_sigma(problem, state)
    for count in range(1, _MAX_ITERATIONS + 1):
        system = build_reduced_system(problem, state, sigma)
        step = solve_step(problem, system)
        state, length_m, lowered = _take_step(problem, state, system, step, sigma)
        sigma = estimate_tie_sigma(problem, state)
        logger.debug("step %d: cost %.1f, tie sigma %.3f px, largest move %.5f m", count, system.cost, sigma, length_m)
        if length_m < settled_m:
            return Solution(state=state, tie_sigma_px=sigma, iterations=count, converged=lowered)
    return Solution(state=state, tie_sigma_px=sigma, iterations=_MAX_ITERATIONS, converged=False)


def _scale_to_unit_diagonal(system: ReducedCameraSystem, free: RowIndices) -> tuple[Float64Array, Float64Array]:
    """The free part of the matrix with a unit diagonal, and the scale that made it so."""
    matrix = system.matrix[np.ix_(free, free)]
    diagonal = np.diag(matrix).copy()
    if not (np.isfinite(diagonal).all() and diagonal.min() > 0):
        raise _build_singularity_error()
    scale = 1.0 / np.sqrt(diagonal)
    matrix *= scale[:, None]
    matrix *= scale[None, :]
    return matrix, scale


def _build_singularity_error() -> GeoreferenceError:
    return GeoreferenceError(
        "the adjustment leaves a photograph or a lens undetermined: too few tie points hold it, or GPS, control and "
        "model together do not fix the block; give control points or photograph with more overlap"
    )


def solve_step(problem: AdjustmentProblem, system: ReducedCameraSystem) -> Float64Array:
    """The step (g,) of the kept unknowns that solves a reduced system; zero for those held."""
    free = np.flatnonzero(~mask_fixed_parameters(problem))
    step = np.zeros(ParameterIndex.build(problem).size)
    matrix, scale = _scale_to_unit_diagonal(system, free)
    try:
        factor = cho_factor(matrix, lower=True, overwrite_a=True)
    except LinAlgError as error:
        raise _build_singularity_error() from error
    step[free] = -scale * cho_solve(factor, scale * system.gradient[free])
    return step


def _take_step(
    problem: AdjustmentProblem, state: AdjustmentState, system: ReducedCameraSystem, step: Float64Array, sigma: float
) -> tuple[AdjustmentState, float, bool]:
    """The state after the step, halved until the cost no longer rises, the farthest that a camera moved (m), and
    whether any such step was found (one too short to matter counts: the state is as good as it gets)."""
    nodes = system.compute_point_step(step)
    share = 1.0
    for _ in range(_MAX_HALVINGS):
        # The nodes' step is affine in the kept unknowns'; a shortened step shortens both.
        after = apply_step(state, problem, share * step, share * nodes)
        if compute_cost(problem, after, sigma) <= system.cost * (1 + 1e-9) + 1e-9:
            break
        share /= 2
    else:
        return state, 0.0, float(np.abs(step).max()) < CONVERGED_M
    photos = step[: ParameterIndex.build(problem).lens].reshape(-1, 6)[:, :3]
    return after, float(share * np.abs(photos).max()), True


def compute_covariance(
    problem: AdjustmentProblem, solution: Solution, tie_variance_factor: float
) -> tuple[ReducedCameraSystem, Float64Array]:
    """Covariance (g, g) of the kept unknowns, zero for those held; ``tie_variance_factor`` multiplies the tie points'
    variance. Also the reduced system it is the inverse of."""
    system = build_reduced_system(problem, solution.state, solution.tie_sigma_px * float(np.sqrt(tie_variance_factor)))
    free = np.flatnonzero(~mask_fixed_parameters(problem))
    matrix, scale = _scale_to_unit_diagonal(system, free)
    try:
        inverse = cho_solve(cho_factor(matrix, lower=True, overwrite_a=True), np.eye(len(free)), overwrite_b=True)
    except LinAlgError as error:
        raise _build_singularity_error() from error
    covariance = np.zeros((ParameterIndex.build(problem).size,) * 2)
    covariance[np.ix_(free, free)] = inverse * scale[:, None] * scale[None, :]
    return system, covariance
