"""Observations of the reduced system's parameters alone: GPS, attitudes, and priors of lenses, offsets and walls."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import BoolArray, Float64Array, Float64N
from facadelake.georeferencing.adjustment.linearise import PRIOR_LOSS_SCALE, compute_cauchy_loss
from facadelake.georeferencing.adjustment.parameters import AdjustmentState, ParameterIndex
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem


def add_parameter_priors(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64N
) -> float:
    """Add the normal equations of GPS, attitudes and priors in place.

    Args:
        problem: the adjustment.
        state: the state to linearise about.
        matrix: normal matrix (g, g), added to in place.
        gradient: gradient (g,), added to in place.

    Returns:
        the robust cost of these observations.
    """
    return (
        _add_positions(problem, state, matrix, gradient)
        + _add_attitudes(problem, state, matrix, gradient)
        + _add_gaussian_priors(problem, state, matrix, gradient)
    )


def _add_positions(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64N
) -> float:
    terms, index = problem.positions, ParameterIndex.build(problem)
    if not len(terms.photo):
        return 0.0
    residual = state.centre_site_m[terms.photo] + state.gps_offset_m[terms.flight] - terms.xyz_site_m
    whitened = residual / terms.sigma_m
    loss, weight = compute_cauchy_loss((whitened**2).sum(axis=1) / 3.0, PRIOR_LOSS_SCALE)
    information = weight[:, None] / terms.sigma_m**2
    for axis in range(3):
        centre = 6 * terms.photo + axis
        offset = index.gps_offset + 3 * terms.flight + axis
        for row, column in ((centre, centre), (centre, offset), (offset, centre), (offset, offset)):
            np.add.at(matrix, (row, column), information[:, axis])
        for row in (centre, offset):
            np.add.at(gradient, row, information[:, axis] * residual[:, axis])
    return float(3.0 * loss.sum())


def _add_attitudes(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64N
) -> float:
    terms, index = problem.attitudes, ParameterIndex.build(problem)
    if not len(terms.photo):
        return 0.0
    site_from_cam = state.site_from_cam[terms.photo]
    angle = Rotation.from_matrix(site_from_cam @ terms.site_from_cam.transpose(0, 2, 1)).as_rotvec()
    angle[:, 2] -= state.yaw_offset_rad[terms.flight]  # counter-clockwise about up
    whitened = angle / terms.sigma_rad
    loss, weight = compute_cauchy_loss((whitened**2).sum(axis=1) / 3.0, PRIOR_LOSS_SCALE)
    root = np.sqrt(weight)[:, None] / terms.sigma_rad
    jacobian = np.zeros((len(terms.photo), 3, 7))
    jacobian[:, :, :6][:, :, 3:] = site_from_cam * root[:, :, None]
    jacobian[:, 2, 6] = -root[:, 2]
    residual = angle * root
    for k, (photo, flight) in enumerate(zip(terms.photo, terms.flight, strict=True)):
        rows = np.append(6 * photo + np.arange(6), index.yaw + flight)
        matrix[np.ix_(rows, rows)] += jacobian[k].T @ jacobian[k]
        gradient[rows] += jacobian[k].T @ residual[k]
    return float(3.0 * loss.sum())


def _add_gaussian_priors(
    problem: AdjustmentProblem, state: AdjustmentState, matrix: Float64Array, gradient: Float64N
) -> float:
    index = ParameterIndex.build(problem)
    lens_sigma = problem.lens_prior_sigma.ravel()
    free = lens_sigma > 0
    residual = np.concatenate(
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
    used = np.concatenate([free, np.ones(len(residual) - len(free), dtype=bool)])
    rows = np.arange(index.lens, index.size)[used]
    matrix[rows, rows] += 1.0 / sigma[used] ** 2
    gradient[rows] += (residual / sigma**2)[used]
    return float(((residual / sigma)[used] ** 2).sum())


def mask_fixed_parameters(problem: AdjustmentProblem) -> BoolArray:
    """Which parameters (g,) of the reduced system are fixed: lens parameters with a prior sigma of 0."""
    index = ParameterIndex.build(problem)
    out = np.zeros(index.size, dtype=bool)
    out[index.lens : index.gps_offset] = problem.lens_prior_sigma.ravel() == 0
    return out
