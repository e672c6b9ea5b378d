"""Whitened, robustly weighted residuals of the object points with their Jacobians, about a state of the unknowns.

Robust weights by Cauchy's loss (Triggs et al. 2000, section 3.3; Ceres Solver *CauchyLoss*), applied as iteratively
reweighted least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx2, Float64Nx3, Float64Nx3x3
from facadelake.georeferencing.adjustment.parameters import AdjustmentState
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.projection import project

# Scales of the loss in sigmas, beyond which observations are down-weighted; 2.4 keeps 95 % efficiency on normal errors.
REPROJECTION_LOSS_SCALE = 2.4
POINT_TO_PLANE_LOSS_SCALE = 2.0
PRIOR_LOSS_SCALE = 4.0
_BEHIND_CAMERA_RESIDUAL = (
    50.0  # sigmas; the constant residual of an image point whose object point is behind the camera
)


def compute_cauchy_loss(squared: Float64N, scale: float | Float64N) -> tuple[Float64N, Float64N]:
    """Loss and weight (k,) of squared whitened residuals (k,) under Cauchy's loss of this ``scale`` (in sigmas)."""
    inner = 1.0 + squared / scale**2
    return scale**2 * np.log(inner), 1.0 / inner


def build_skew_matrices(vectors: Float64Nx3) -> Float64Nx3x3:
    """Skew-symmetric matrices (k, 3, 3) of the cross product: ``matrix @ x`` is ``vector`` cross x."""
    out = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 0] = -z, y, z
    out[:, 1, 2], out[:, 2, 0], out[:, 2, 1] = -x, -y, x
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedReprojection:
    """Weighted reprojection residuals (k, 2), Jacobians by photograph (k, 2, 6), lens (k, 2, 8) and point (k, 2, 3)."""

    residual: Float64Nx2
    jacobian_photo: Float64Array
    jacobian_lens: Float64Array
    jacobian_point: Float64Array
    cost: float


def compute_reprojection_residuals(
    problem: AdjustmentProblem, state: AdjustmentState, tie_sigma_px: float
) -> Float64Nx2:
    """Whitened residuals (k, 2) of the image points, not weighted; tie points have ``tie_sigma_px`` per axis."""
    image_points, block = problem.image_points, problem.block
    xyz_cam = _transform_to_camera(problem, state)
    projected = project(xyz_cam, state.lens[block.camera_of_photo[image_points.photo]])
    residual: Float64Array = np.einsum("kij,kj->ki", image_points.whitening, projected.xy_img - image_points.xy_img)
    residual[image_points.is_tie_point] /= tie_sigma_px
    residual[~projected.in_front] = _BEHIND_CAMERA_RESIDUAL
    return residual


def _transform_to_camera(problem: AdjustmentProblem, state: AdjustmentState) -> Float64Nx3:
    """Object points (k, 3) of the image points, each in ``cam`` of its photograph."""
    image_points = problem.image_points
    offset = state.xyz_site_m[image_points.point] - state.centre_site_m[image_points.photo]
    xyz_cam: Float64Array = np.einsum("kji,kj->ki", state.site_from_cam[image_points.photo], offset)
    return xyz_cam


def linearise_reprojection(
    problem: AdjustmentProblem, state: AdjustmentState, tie_sigma_px: float
) -> LinearisedReprojection:
    """The image points linearised about ``state``; tie points have ``tie_sigma_px`` per axis."""
    image_points, block = problem.image_points, problem.block
    rotation = state.site_from_cam[image_points.photo]
    xyz_cam = _transform_to_camera(problem, state)
    projected = project(xyz_cam, state.lens[block.camera_of_photo[image_points.photo]])
    whitening = image_points.whitening / np.where(image_points.is_tie_point, tie_sigma_px, 1.0)[:, None, None]
    residual = np.einsum("kij,kj->ki", whitening, projected.xy_img - image_points.xy_img)
    behind = ~projected.in_front
    residual[behind] = _BEHIND_CAMERA_RESIDUAL
    loss, weight = compute_cauchy_loss((residual**2).sum(axis=1), REPROJECTION_LOSS_SCALE)
    root = np.sqrt(np.where(behind, 0.0, weight))
    whitening = whitening * root[:, None, None]
    jacobian_cam = whitening @ projected.jacobian_xyz_cam
    jacobian_point = np.einsum("kai,kji->kaj", jacobian_cam, rotation)
    # exp(-w) x is x + x cross w: the rotation vector w is about the camera's own axes.
    jacobian_rotation = jacobian_cam @ build_skew_matrices(xyz_cam)
    return LinearisedReprojection(
        residual=residual * root[:, None],
        jacobian_photo=np.concatenate([-jacobian_point, jacobian_rotation], axis=2),
        jacobian_lens=whitening @ projected.jacobian_lens,
        jacobian_point=jacobian_point,
        cost=float(loss.sum()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedPointToPlane:
    """Weighted point-to-plane residuals (k,) with Jacobians by point (k, 3) and by the wall's deviation (k,)."""

    residual: Float64N
    jacobian_point: Float64Nx3
    jacobian_wall: Float64N
    cost: float


def linearise_point_to_plane(problem: AdjustmentProblem, state: AdjustmentState) -> LinearisedPointToPlane:
    """The tie points on the model's surface, linearised about ``state``."""
    terms = problem.point_to_plane
    deviation = np.where(terms.wall >= 0, np.append(state.wall_deviation_m, 0.0)[terms.wall], 0.0)
    distance = np.einsum("ki,ki->k", terms.normal_site, state.xyz_site_m[terms.point]) - terms.distance_m - deviation
    residual = distance / terms.sigma_m
    loss, weight = compute_cauchy_loss(residual**2, POINT_TO_PLANE_LOSS_SCALE)
    root = np.sqrt(weight)
    return LinearisedPointToPlane(
        residual=residual * root,
        jacobian_point=terms.normal_site * (root / terms.sigma_m)[:, None],
        jacobian_wall=-(root / terms.sigma_m),
        cost=float(loss.sum()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedPointPriors:
    """Weighted point priors: information (k, 3, 3), and gradient ``information @ (point - prior)`` (k, 3)."""

    information: Float64Nx3x3
    gradient: Float64Nx3
    cost: float


def linearise_point_priors(problem: AdjustmentProblem, state: AdjustmentState) -> LinearisedPointPriors:
    """The priors of object points, linearised about ``state``."""
    priors = problem.point_priors
    residual = state.xyz_site_m[priors.point] - priors.xyz_m
    gradient = np.einsum("kij,kj->ki", priors.information, residual)
    loss, weight = compute_cauchy_loss(np.einsum("ki,ki->k", residual, gradient), priors.loss_scale)
    return LinearisedPointPriors(
        information=priors.information * weight[:, None, None],
        gradient=gradient * weight[:, None],
        cost=float(loss.sum()),
    )
