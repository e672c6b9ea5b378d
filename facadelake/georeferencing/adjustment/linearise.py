"""The observations as whitened, robustly weighted residuals with their derivatives, about a state of the unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.projection import lens_from_camera, project

# Cauchy's loss: beyond this many sigmas an observation loses its say. 2.4 keeps 95 % efficiency on normal errors.
REPROJECTION_LOSS_SCALE = 2.4
POINT_TO_PLANE_LOSS_SCALE = 2.0
PRIOR_LOSS_SCALE = 4.0
_BEHIND_CAMERA_RESIDUAL = 50.0  # sigmas; what an observation of a point behind the camera counts


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustmentState:
    """Values of all unknowns: ``centre_site_m`` (n, 3), ``site_from_cam`` (n, 3, 3), ``lens`` (c, 8), ``xyz_site_m``
    (m, 3), ``gps_offset_m`` (f, 3), ``yaw_offset_rad`` (f,), ``wall_deviation_m`` (w,)."""

    centre_site_m: Float64Array
    site_from_cam: Float64Array
    lens: Float64Array
    xyz_site_m: Float64Array
    gps_offset_m: Float64Array
    yaw_offset_rad: Float64Array
    wall_deviation_m: Float64Array


def initialise_state(problem: AdjustmentProblem) -> AdjustmentState:
    """The state an adjustment begins with; offsets and deviations are zero."""
    block = problem.block
    return AdjustmentState(
        centre_site_m=block.centre_site_m,
        site_from_cam=block.site_from_cam,
        lens=np.array([lens_from_camera(camera) for camera in block.cameras]),
        xyz_site_m=problem.initial_xyz_m,
        gps_offset_m=np.zeros_like(problem.positions.offset_sigma_m),
        yaw_offset_rad=np.zeros_like(problem.attitudes.yaw_sigma_rad),
        wall_deviation_m=np.zeros_like(problem.point_to_plane.wall_sigma_m),
    )


def apply_step(
    state: AdjustmentState, problem: AdjustmentProblem, step: Float64Array, node_step: Float64Array
) -> AdjustmentState:
    """The state after a step of the kept unknowns (in the order of ``ParameterIndex``) and of the nodes (m, 3)."""
    layout = ParameterIndex.build(problem)
    photo = step[: layout.lens].reshape(-1, 6)
    return AdjustmentState(
        centre_site_m=state.centre_site_m + photo[:, :3],
        site_from_cam=state.site_from_cam @ Rotation.from_rotvec(photo[:, 3:]).as_matrix(),
        lens=state.lens + step[layout.lens : layout.gps_offset].reshape(-1, 8),
        xyz_site_m=state.xyz_site_m + node_step,
        gps_offset_m=state.gps_offset_m + step[layout.gps_offset : layout.yaw].reshape(-1, 3),
        yaw_offset_rad=state.yaw_offset_rad + step[layout.yaw : layout.wall],
        wall_deviation_m=state.wall_deviation_m + step[layout.wall :],
    )


@dataclass(frozen=True, kw_only=True)
class ParameterIndex:
    """Where the kept unknowns stand in the vector: photographs (6 each: centre in site, rotation vector in cam) from 0,
    then ``lens`` (8 each), ``gps_offset`` (3 a flight), ``yaw`` (1 a flight), ``wall`` (1 each), ``size`` in all."""

    lens: int
    gps_offset: int
    yaw: int
    wall: int
    size: int

    @staticmethod
    def build(problem: AdjustmentProblem) -> ParameterIndex:
        """The layout of a problem."""
        lens = 6 * len(problem.block.centre_site_m)
        offset = lens + 8 * len(problem.block.cameras)
        yaw = offset + 3 * len(problem.positions.offset_sigma_m)
        wall = yaw + len(problem.attitudes.yaw_sigma_rad)
        return ParameterIndex(
            lens=lens, gps_offset=offset, yaw=yaw, wall=wall, size=wall + len(problem.point_to_plane.wall_sigma_m)
        )


def compute_cauchy_loss(squared: Float64Array, limit: float | Float64Array) -> tuple[Float64Array, Float64Array]:
    """Loss and weight of squared whitened residuals under Cauchy's robust loss."""
    inner = 1.0 + squared / limit**2
    return limit**2 * np.log(inner), 1.0 / inner


def build_skew_matrices(vectors: Float64Array) -> Float64Array:
    """Matrices (k, 3, 3) that take x to ``vector`` cross x."""
    out = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 0] = -z, y, z
    out[:, 1, 2], out[:, 2, 0], out[:, 2, 1] = -x, -y, x
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedReprojection:
    """Sightings, weighted: residuals (k, 2), derivatives by photograph (k, 2, 6), lens (k, 2, 8) and node (k, 2, 3)."""

    residual: Float64Array
    jacobian_photo: Float64Array
    jacobian_lens: Float64Array
    jacobian_point: Float64Array
    cost: float


def compute_reprojection_residuals(
    problem: AdjustmentProblem, state: AdjustmentState, tie_sigma_px: float
) -> Float64Array:
    """Whitened residuals (k, 2) of the sightings, unweighted."""
    seen, block = problem.image_points, problem.block
    xyz_cam = _transform_to_camera(problem, state)
    projected = project(xyz_cam, state.lens[block.camera_of_photo[seen.photo]])
    residual: Float64Array = np.einsum("kij,kj->ki", seen.whitening, projected.xy_img - seen.xy_img)
    residual[seen.is_tie_point] /= tie_sigma_px
    residual[~projected.in_front] = _BEHIND_CAMERA_RESIDUAL
    return residual


def _transform_to_camera(problem: AdjustmentProblem, state: AdjustmentState) -> Float64Array:
    seen = problem.image_points
    away = seen.offset_site_m + state.xyz_site_m[seen.point] - state.centre_site_m[seen.photo]
    xyz_cam: Float64Array = np.einsum("kji,kj->ki", state.site_from_cam[seen.photo], away)
    return xyz_cam


def linearise_reprojection(
    problem: AdjustmentProblem, state: AdjustmentState, tie_sigma_px: float
) -> LinearisedReprojection:
    """The sightings about ``state``; tie points have ``tie_sigma_px`` per axis."""
    seen, block = problem.image_points, problem.block
    rotation = state.site_from_cam[seen.photo]
    xyz_cam = _transform_to_camera(problem, state)
    projected = project(xyz_cam, state.lens[block.camera_of_photo[seen.photo]])
    whitening = seen.whitening / np.where(seen.is_tie_point, tie_sigma_px, 1.0)[:, None, None]
    residual = np.einsum("kij,kj->ki", whitening, projected.xy_img - seen.xy_img)
    behind = ~projected.in_front
    residual[behind] = _BEHIND_CAMERA_RESIDUAL
    loss, weight = compute_cauchy_loss((residual**2).sum(axis=1), REPROJECTION_LOSS_SCALE)
    root = np.sqrt(np.where(behind, 0.0, weight))
    whitening = whitening * root[:, None, None]
    by_cam = whitening @ projected.jacobian_xyz_cam
    by_node = np.einsum("kai,kji->kaj", by_cam, rotation)
    # exp(-w) x is x + x cross w: the camera turns by w in its own axes.
    by_turn = by_cam @ build_skew_matrices(xyz_cam)
    return LinearisedReprojection(
        residual=residual * root[:, None],
        jacobian_photo=np.concatenate([-by_node, by_turn], axis=2),
        jacobian_lens=whitening @ projected.jacobian_lens,
        jacobian_point=by_node,
        cost=float(loss.sum()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedPointToPlane:
    """Wall terms, weighted: residual (k,), derivative by node (k, 3) and by the wall's deviation (k,)."""

    residual: Float64Array
    jacobian_point: Float64Array
    jacobian_wall: Float64Array
    cost: float


def linearise_point_to_plane(problem: AdjustmentProblem, state: AdjustmentState) -> LinearisedPointToPlane:
    """The tie points on the model's surface about ``state``."""
    walls = problem.point_to_plane
    deviation = np.where(walls.wall >= 0, np.append(state.wall_deviation_m, 0.0)[walls.wall], 0.0)
    away = np.einsum("ki,ki->k", walls.normal_site, state.xyz_site_m[walls.point]) - walls.distance_m - deviation
    residual = away / walls.sigma_m
    loss, weight = compute_cauchy_loss(residual**2, POINT_TO_PLANE_LOSS_SCALE)
    root = np.sqrt(weight)
    return LinearisedPointToPlane(
        residual=residual * root,
        jacobian_point=walls.normal_site * (root / walls.sigma_m)[:, None],
        jacobian_wall=-(root / walls.sigma_m),
        cost=float(loss.sum()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedPointPriors:
    """Node priors, weighted: information (k, 3, 3), ``information @ (node - prior)`` (k, 3)."""

    information: Float64Array
    gradient: Float64Array
    cost: float


def linearise_point_priors(problem: AdjustmentProblem, state: AdjustmentState) -> LinearisedPointPriors:
    """The nodes' priors about ``state``."""
    priors = problem.point_priors
    away = state.xyz_site_m[priors.point] - priors.xyz_m
    pull = np.einsum("kij,kj->ki", priors.information, away)
    loss, weight = compute_cauchy_loss(np.einsum("ki,ki->k", away, pull), priors.loss_scale)
    return LinearisedPointPriors(
        information=priors.information * weight[:, None, None], gradient=pull * weight[:, None], cost=float(loss.sum())
    )
