"""The georeferenced bundle adjustment of a block, from an initial placement to posed cameras with their covariance."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from facadelake.core.arrays import BoolArray
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock, build_adjusted_block
from facadelake.georeferencing.adjustment.assembly import build_problem
from facadelake.georeferencing.adjustment.control_observations import ControlObservations, SurfaceConstraint
from facadelake.georeferencing.adjustment.parameters import AdjustmentState, ParameterIndex, initialise_state
from facadelake.georeferencing.adjustment.point_to_plane import match_points_to_surface
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.projection import LENS_PARAMETERS
from facadelake.georeferencing.adjustment.solve import CONVERGED_M, Solution, compute_covariance, solve_adjustment
from facadelake.georeferencing.adjustment.tie_points import TiePointSelection, choose_tie_points
from facadelake.sfm import Reconstruction

logger = logging.getLogger(__name__)

# Gate and convergence limit of each round with the model: the gate narrows from the error of the initial placement to
# the relief of a facade; early rounds need not converge, because their correspondences are renewed.
_SURFACE_ROUNDS = ((0.3, 2e-3), (0.2, 1e-3), (0.2, CONVERGED_M))
_SIGNIFICANCE_SIGMAS = 2.0
_OPTIONAL_PARAMETERS = ("aspect", "k2", "p1", "p2")


def adjust_block(
    reconstruction: Reconstruction, site_from_sfm: Similarity, control: ControlObservations
) -> AdjustedBlock:
    """Adjust the block with its control, from the initial placement ``site_from_sfm``.

    With a model, correspondences with its faces are renewed in three rounds. Then lens parameters without a significant
    deviation from a plain lens are fixed at it, and the block is adjusted once more.
    Raises GeoreferenceError where the observations leave the block undetermined.
    """
    tie_points = choose_tie_points(reconstruction, site_from_sfm)
    problem = build_problem(reconstruction, site_from_sfm, tie_points, control)
    if control.model is None:
        solution = solve_adjustment(problem)
    else:
        # Correspondences come before the first solution: GPS alone would pull the block away from the model.
        state = initialise_state(problem)
        for gate_m, converged_m in _SURFACE_ROUNDS:
            problem = _update_point_to_plane(problem, tie_points, state, control.model, gate_m)
            state = replace(state, wall_deviation_m=np.zeros(len(problem.point_to_plane.wall_sigma_m)))
            solution = solve_adjustment(problem, state, converged_m=converged_m)
            state = solution.state
    free = _find_significant_parameters(problem, solution)
    if not free.all():
        problem = _fix_parameters(problem, free)
        lens = np.where(problem.lens_prior_sigma > 0, solution.state.lens, problem.lens_prior_mean)
        solution = solve_adjustment(problem, replace(solution.state, lens=lens))
    logger.info(
        "adjusted %d photographs, %d tie points: sigma %.2f px, %d iterations",
        len(problem.block.centre_site_m),
        len(tie_points),
        solution.tie_sigma_px,
        solution.iterations,
    )
    return build_adjusted_block(problem, tie_points, solution, free)


def _update_point_to_plane(
    problem: AdjustmentProblem,
    tie_points: TiePointSelection,
    state: AdjustmentState,
    model: SurfaceConstraint,
    gate_m: float,
) -> AdjustmentProblem:
    """The problem with new correspondences between tie points and the model's faces, found from ``state``."""
    terms = match_points_to_surface(tie_points, state, model.surface, gate_m=gate_m, model_sigma_m=model.sigma_m)
    logger.debug("%d tie points on %d walls", len(terms.point), len(terms.wall_sigma_m))
    return replace(problem, point_to_plane=terms)


def _find_significant_parameters(problem: AdjustmentProblem, solution: Solution) -> BoolArray:
    """Lens parameters (c, 8) to keep free: those always adjusted, and optional ones significant at two sigmas."""
    index = ParameterIndex.build(problem)
    _, covariance = compute_covariance(problem, solution, 1.0)
    sigma = np.sqrt(np.diag(covariance)[index.lens : index.gps_offset]).reshape(-1, len(LENS_PARAMETERS))
    deviation = np.abs(solution.state.lens - problem.lens_prior_mean)
    optional = np.isin(LENS_PARAMETERS, _OPTIONAL_PARAMETERS)
    free: BoolArray = ~optional | (deviation > _SIGNIFICANCE_SIGMAS * sigma)
    return free


def _fix_parameters(problem: AdjustmentProblem, free: BoolArray) -> AdjustmentProblem:
    """The problem with the lens parameters that are not ``free`` (c, 8) fixed at their prior mean."""
    return replace(problem, lens_prior_sigma=np.where(free, problem.lens_prior_sigma, 0.0))
