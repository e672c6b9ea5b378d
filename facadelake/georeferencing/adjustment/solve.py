"""Gauss-Newton with robust reweighting on the reduced normal equations."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from facadelake.core.arrays import Float64Array, RowIndices
from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.adjustment.linearise import Layout, State, moved, sighting_residuals, start_of
from facadelake.georeferencing.adjustment.parameter_priors import held
from facadelake.georeferencing.adjustment.problem import Problem
from facadelake.georeferencing.adjustment.reduced_system import Reduced, cost_of, reduce

logger = logging.getLogger(__name__)

_MOST_STEPS = 40
SETTLED_M = 2e-4  # no camera moves more: far below any camera's sigma
_HALVINGS = 6
# Half of normal residuals in two dimensions lie within this many sigmas (Rayleigh's median).
_RAYLEIGH_MEDIAN = 1.1774
_LEAST_SIGMA_PX = 0.05
_LEAST_REDUNDANCY = 0.1  # a photograph with a handful of points tells nothing of their sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """The adjusted state, the tie points' sigma (px, each axis), how many steps it took and whether it settled."""

    state: State
    tie_sigma_px: float
    steps: int
    settled: bool


def tie_sigma_of(problem: Problem, state: State) -> float:
    """One sigma (px) of a tie point's coordinate, from the median residual, so that outliers have no say.

    A point seen n times gives 2n coordinates and takes three unknowns, a photograph takes six of its own: residuals
    are smaller than errors by the root of that redundancy (by half where tracks have two photographs).
    """
    tie = problem.sightings.tie
    if not tie.any():
        return 1.0
    node, photo = problem.sightings.node[tie], problem.sightings.photo[tie]
    redundancy = 1.0 - 1.5 / np.bincount(node)[node] - 3.0 / np.bincount(photo)[photo]
    length = np.linalg.norm(sighting_residuals(problem, state, 1.0)[tie], axis=1)
    error = length / np.sqrt(np.maximum(redundancy, _LEAST_REDUNDANCY))
    return max(float(np.median(error)) / _RAYLEIGH_MEDIAN, _LEAST_SIGMA_PX)


def solve(problem: Problem, start: State | None = None, *, settled_m: float = SETTLED_M) -> Solution:
    """Adjust from ``start`` (or the problem's own) until no camera moves by more than ``settled_m``.

    Raises GeoreferenceError where the observations leave an unknown open (the matrix is singular).
    """
    state = start_of(problem) if start is None else start
    sigma = tie_sigma_of(problem, state)
    for count in range(1, _MOST_STEPS + 1):
        system = reduce(problem, state, sigma)
        step = solved_step(problem, system)
        state, length_m, lowered = _taken(problem, state, system, step, sigma)
        sigma = tie_sigma_of(problem, state)
        logger.debug("step %d: cost %.1f, tie sigma %.3f px, largest move %.5f m", count, system.cost, sigma, length_m)
        if length_m < settled_m:
            return Solution(state=state, tie_sigma_px=sigma, steps=count, settled=lowered)
    return Solution(state=state, tie_sigma_px=sigma, steps=_MOST_STEPS, settled=False)


def _scaled(system: Reduced, free: RowIndices) -> tuple[Float64Array, Float64Array]:
    """The free part of the matrix with a unit diagonal, and the scale that made it so."""
    matrix = system.matrix[np.ix_(free, free)]
    diagonal = np.diag(matrix).copy()
    if not (np.isfinite(diagonal).all() and diagonal.min() > 0):
        raise _open()
    scale = 1.0 / np.sqrt(diagonal)
    matrix *= scale[:, None]
    matrix *= scale[None, :]
    return matrix, scale


def _open() -> GeoreferenceError:
    return GeoreferenceError(
        "the adjustment leaves a photograph or a lens undetermined: too few tie points hold it, or GPS, control and "
        "model together do not fix the block; give control points or photograph with more overlap"
    )


def solved_step(problem: Problem, system: Reduced) -> Float64Array:
    """The step (g,) of the kept unknowns that solves a reduced system; zero for those held."""
    free = np.flatnonzero(~held(problem))
    step = np.zeros(Layout.of(problem).size)
    matrix, scale = _scaled(system, free)
    try:
        factor = cho_factor(matrix, lower=True, overwrite_a=True)
    except LinAlgError as error:
        raise _open() from error
    step[free] = -scale * cho_solve(factor, scale * system.gradient[free])
    return step


def _taken(
    problem: Problem, state: State, system: Reduced, step: Float64Array, sigma: float
) -> tuple[State, float, bool]:
    """The state after the step, halved until the cost no longer rises, the farthest that a camera moved (m), and
    whether any such step was found (one too short to matter counts: the state is as good as it gets)."""
    nodes = system.node_step(step)
    share = 1.0
    for _ in range(_HALVINGS):
        # The nodes' step is affine in the kept unknowns'; a shortened step shortens both.
        after = moved(state, problem, share * step, share * nodes)
        if cost_of(problem, after, sigma) <= system.cost * (1 + 1e-9) + 1e-9:
            break
        share /= 2
    else:
        return state, 0.0, float(np.abs(step).max()) < SETTLED_M
    photos = step[: Layout.of(problem).lens].reshape(-1, 6)[:, :3]
    return after, float(share * np.abs(photos).max()), True


def covariance_of(problem: Problem, solution: Solution, tie_variance_factor: float) -> tuple[Reduced, Float64Array]:
    """Covariance (g, g) of the kept unknowns, zero for those held; ``tie_variance_factor`` multiplies the tie points'
    variance. Also the reduced system it is the inverse of."""
    system = reduce(problem, solution.state, solution.tie_sigma_px * float(np.sqrt(tie_variance_factor)))
    free = np.flatnonzero(~held(problem))
    matrix, scale = _scaled(system, free)
    try:
        inverse = cho_solve(cho_factor(matrix, lower=True, overwrite_a=True), np.eye(len(free)), overwrite_b=True)
    except LinAlgError as error:
        raise _open() from error
    covariance = np.zeros((Layout.of(problem).size,) * 2)
    covariance[np.ix_(free, free)] = inverse * scale[:, None] * scale[None, :]
    return system, covariance
