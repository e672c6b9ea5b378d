"""Observations of the kept unknowns alone: GPS, attitudes, and what is known of lenses, offsets and walls."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.georeferencing.adjustment.linearise import (
    PRIOR_LOSS_SCALE,
    AdjustmentState,
    ParameterIndex,
    compute_cauchy_loss,
)
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem


def add_parameter_priors(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64Array
) -> float:
    """Add their normal equations to ``matrix`` (g, g) and ``gradient`` (g,) in place; returns their cost."""
    return (
        _add_positions(problem, state, matrix, gradient)
        + _add_attitudes(problem, state, matrix, gradient)
        + _add_gaussian_priors(problem, state, matrix, gradient)
    )


def _add_positions(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64Array
) -> float:
    terms, layout = problem.positions, ParameterIndex.build(problem)
    if not len(terms.photo):
        return 0.0
    away = state.centre_site_m[terms.photo] + state.gps_offset_m[terms.flight] - terms.xyz_site_m
    whitened = away / terms.sigma_m
    loss, weight = compute_cauchy_loss((whitened**2).sum(axis=1) / 3.0, PRIOR_LOSS_SCALE)
    information = weight[:, None] / terms.sigma_m**2
    for axis in range(3):
        at = 6 * terms.photo + axis
        common = layout.gps_offset + 3 * terms.flight + axis
        for first, second in ((at, at), (at, common), (common, at), (common, common)):
            np.add.at(matrix, (first, second), information[:, axis])
        for place in (at, common):
            np.add.at(gradient, place, information[:, axis] * away[:, axis])
    return float(3.0 * loss.sum())


def _add_attitudes(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64Array
) -> float:
    terms, layout = problem.attitudes, ParameterIndex.build(problem)
    if not len(terms.photo):
        return 0.0
    now = state.site_from_cam[terms.photo]
    away = Rotation.from_matrix(now @ terms.site_from_cam.transpose(0, 2, 1)).as_rotvec()
    away[:, 2] -= state.yaw_offset_rad[terms.flight]  # counter-clockwise about up
    whitened = away / terms.sigma_rad
    loss, weight = compute_cauchy_loss((whitened**2).sum(axis=1) / 3.0, PRIOR_LOSS_SCALE)
    root = np.sqrt(weight)[:, None] / terms.sigma_rad
    rows = np.zeros((len(terms.photo), 3, 7))
    rows[:, :, :6][:, :, 3:] = now * root[:, :, None]
    rows[:, 2, 6] = -root[:, 2]
    residual = away * root
    for k, (photo, flight) in enumerate(zip(terms.photo, terms.flight, strict=True)):
        at = np.append(6 * photo + np.arange(6), layout.yaw + flight)
        matrix[np.ix_(at, at)] += rows[k].T @ rows[k]
        gradient[at] += rows[k].T @ residual[k]
    return float(3.0 * loss.sum())


def _add_gaussian_priors(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64Array
) -> float:
    layout = ParameterIndex.build(problem)
    lens_sigma = problem.lens_prior_sigma.ravel()
    free = lens_sigma > 0
    away = np.concatenate(
        [
            (state.lens - problem.lens_prior_mean).ravel(),
            state.gps_offset_m.ravel(),
            state.yaw_offset_rad,
            state.wall_deviation_m,
        ]
    )
    sigma = np.concatenate(
        [
            np.where(free, lens_sigma, 1.0),
            problem.positions.offset_sigma_m.ravel(),
            problem.attitudes.yaw_sigma_rad,
            problem.point_to_plane.wall_sigma_m,
        ]
    )
    known = np.concatenate([free, np.ones(len(away) - len(free), dtype=bool)])
    place = np.arange(layout.lens, layout.size)[known]
    matrix[place, place] += 1.0 / sigma[known] ** 2
    gradient[place] += (away / sigma**2)[known]
    return float(((away / sigma)[known] ** 2).sum())


def mask_fixed_parameters(problem: AdjustmentProblem) -> BoolArray:
    """Which kept unknowns (g,) are held at their start: lens terms of sigma 0."""
    layout = ParameterIndex.build(problem)
    out = np.zeros(layout.size, dtype=bool)
    out[layout.lens : layout.gps_offset] = problem.lens_prior_sigma.ravel() == 0
    return out
