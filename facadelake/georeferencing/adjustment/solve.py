"""Gauss-Newton iterations with robust reweighting on the reduced camera system, and its covariance."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from facadelake.core.arrays import Float64Array, Float64N, RowIndices
from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.adjustment.linearise import compute_reprojection_residuals
from facadelake.georeferencing.adjustment.parameter_priors import mask_fixed_parameters
from facadelake.georeferencing.adjustment.parameters import (
    AdjustmentState,
    ParameterIndex,
    apply_step,
    initialise_state,
)
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.reduced_system import ReducedCameraSystem, build_reduced_system, compute_cost

logger = logging.getLogger(__name__)

_MAX_ITERATIONS = 40
CONVERGED_M = 2e-4  # largest camera step at convergence: far below any camera's sigma
_MAX_HALVINGS = 6
# Half of normal residuals in two dimensions lie within this many sigmas (median of the Rayleigh distribution).
_RAYLEIGH_MEDIAN = 1.1774
_MIN_SIGMA_PX = 0.05
_MIN_REDUNDANCY = 0.1  # the residuals of a photograph with few points do not determine their sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """The adjusted state, the tie points' sigma (px, each axis), the number of iterations and their convergence."""

    state: AdjustmentState
    tie_sigma_px: float
    iterations: int
    converged: bool


def estimate_tie_sigma(problem: AdjustmentProblem, state: AdjustmentState) -> float:
    """One sigma (px) of a tie point's image coordinate, from the median residual, which outliers do not affect.

    Residuals are smaller than errors by the root of their redundancy number (Foerstner and Wrobel 2016, section 4.2):
    a tie point with n image points gives 2n coordinates and takes three unknowns, a photograph takes six. With two
    image points per tie point residuals are half the errors.
    """
    tie = problem.image_points.is_tie_point
    if not tie.any():
        return 1.0
    point, photo = problem.image_points.point[tie], problem.image_points.photo[tie]
    redundancy = 1.0 - 1.5 / np.bincount(point)[point] - 3.0 / np.bincount(photo)[photo]
    length = np.linalg.norm(compute_reprojection_residuals(problem, state, 1.0)[tie], axis=1)
    error = length / np.sqrt(np.maximum(redundancy, _MIN_REDUNDANCY))
    return max(float(np.median(error)) / _RAYLEIGH_MEDIAN, _MIN_SIGMA_PX)


def solve_adjustment(
    problem: AdjustmentProblem, start: AdjustmentState | None = None, *, converged_m: float = CONVERGED_M
) -> Solution:
    """Iterate from ``start`` (else the problem's initial values) until no camera moves by more than ``converged_m``.

    Raises GeoreferenceError where the observations leave a parameter undetermined (the normal matrix is singular).
    """
    state = initialise_state(problem) if start is None else start
    sigma = estimate_tie_sigma(problem, state)
    for iteration in range(1, _MAX_ITERATIONS + 1):
        system = build_reduced_system(problem, state, sigma)
        step = solve_step(problem, system)
        state, length_m, lowered = _take_step(problem, state, system, step, sigma)
        sigma = estimate_tie_sigma(problem, state)
        logger.debug(
            "iteration %d: cost %.1f, tie sigma %.3f px, largest camera step %.5f m",
            iteration,
            system.cost,
            sigma,
            length_m,
        )
        if length_m < converged_m:
            return Solution(state=state, tie_sigma_px=sigma, iterations=iteration, converged=lowered)
    return Solution(state=state, tie_sigma_px=sigma, iterations=_MAX_ITERATIONS, converged=False)


def _scale_to_unit_diagonal(system: ReducedCameraSystem, free: RowIndices) -> tuple[Float64Array, Float64N]:
    """The free part of the matrix scaled to a unit diagonal, and the scale."""
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
        "the adjustment leaves a photograph or a lens undetermined (singular normal matrix): too few tie points, or "
        "GPS, control and model together do not fix the block; give control points, or photograph with more overlap"
    )


def solve_step(problem: AdjustmentProblem, system: ReducedCameraSystem) -> Float64N:
    """The step (g,) that solves the reduced system; zero for fixed parameters."""
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
    problem: AdjustmentProblem,
    state: AdjustmentState,
    system: ReducedCameraSystem,
    step: Float64N,
    tie_sigma_px: float,
) -> tuple[AdjustmentState, float, bool]:
    """Take a step, halved until the cost does not rise.

    Args:
        problem: the adjustment.
        state: the state that ``system`` is linearised about.
        system: the reduced system.
        step: its solution (g,).
        tie_sigma_px: one sigma of a tie point's image coordinate.

    Returns:
        the new state; the largest step of a camera in metres; and whether the cost was lowered. A step below
        ``CONVERGED_M`` that does not lower it counts as lowered: the state is at the minimum.
    """
    point_step = system.compute_point_step(step)
    share = 1.0
    for _ in range(_MAX_HALVINGS):
        # The points' step is affine in the parameters' step, so one factor shortens both.
        after = apply_step(state, problem, share * step, share * point_step)
        if compute_cost(problem, after, tie_sigma_px) <= system.cost * (1 + 1e-9) + 1e-9:
            break
        share /= 2
    else:
        return state, 0.0, float(np.abs(step).max()) < CONVERGED_M
    photos = step[: ParameterIndex.build(problem).lens].reshape(-1, 6)[:, :3]
    return after, float(share * np.abs(photos).max()), True


def compute_covariance(
    problem: AdjustmentProblem, solution: Solution, tie_variance_factor: float
) -> tuple[ReducedCameraSystem, Float64Array]:
    """The reduced system at the solution and its inverse: the covariance (g, g), zero for fixed parameters.

    ``tie_variance_factor`` multiplies the variance of the tie points' image coordinates.
    """
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
