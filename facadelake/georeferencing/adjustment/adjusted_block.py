"""The adjusted block: posed cameras and points with their covariance, and residuals at control points left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64Nx3, Float64Nx3x3, Float64x3, Float64x3x3
from facadelake.core.camera import PosedCamera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.control_observations import MarkedPoints
from facadelake.georeferencing.adjustment.linearise import (
    PRIOR_LOSS_SCALE,
    compute_cauchy_loss,
    compute_reprojection_residuals,
)
from facadelake.georeferencing.adjustment.parameters import AdjustmentState, ParameterIndex
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem, Block
from facadelake.georeferencing.adjustment.projection import LENS_PARAMETERS, camera_from_lens
from facadelake.georeferencing.adjustment.solve import Solution
from facadelake.georeferencing.adjustment.tie_points import TiePointSelection, estimate_tie_variance_factor
from facadelake.georeferencing.adjustment.uncertainty import (
    Uncertainty,
    compute_leave_one_out_residual,
    estimate_uncertainty,
)

_MIN_REMAINING_POINTS = 3  # control points that must remain when one is left out


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustedBlock:
    """The adjusted block.

    ``covariance`` (n, 6, 6): centre (m, site) and attitude (rad, about the camera's axes) of each photograph.
    ``gps_offset_m`` (f, 3) and ``gps_offset_sigma_m``: common error of each flight's GPS, GPS minus camera centre.
    ``datum_covariance_m2`` (3, 3): of the mean camera centre. ``tie_variance_factor``: factor on the variance of tie
    points' image coordinates for their correlation. ``lens_sigma`` (c, 8): one sigma of the adjusted lens parameters.
    ``focal_height_correlation``: largest correlation of a focal length with the block's mean height.
    ``fixed_parameters``: names of the lens parameters that were not significant and fixed at their prior mean.
    """

    problem: AdjustmentProblem
    solution: Solution
    tie_points: TiePointSelection
    covariance: Float64Array
    uncertainty: Uncertainty
    gps_offset_m: Float64Nx3
    gps_offset_sigma_m: Float64Nx3
    datum_covariance_m2: Float64x3x3
    tie_variance_factor: float
    lens_sigma: Float64Array
    focal_height_correlation: float
    fixed_parameters: tuple[str, ...]

    @property
    def cameras(self) -> tuple[PosedCamera, ...]:
        """The posed cameras, in the reconstruction's order."""
        return build_posed_cameras(self.problem.block, self.solution.state)

    @property
    def xyz_site_m(self) -> Float64Nx3:
        """The adjusted tie points (t, 3)."""
        return self.solution.state.xyz_site_m[: len(self.tie_points)]

    @property
    def point_covariance_m2(self) -> Float64Nx3x3:
        """Covariance (t, 3, 3) of the tie points within the block, that is for given cameras."""
        return self.uncertainty.system.point_covariance_m2[: len(self.tie_points)]

    @property
    def marked_xyz_site_m(self) -> Float64Nx3:
        """The adjusted marked points (p, 3)."""
        return self.solution.state.xyz_site_m[len(self.tie_points) :]


def build_posed_cameras(block: Block, state: AdjustmentState) -> tuple[PosedCamera, ...]:
    """The cameras of a state, in the order of the photographs."""
    return tuple(
        PosedCamera(
            camera=camera_from_lens(state.lens[lens], block.cameras[lens]),
            site_from_cam=Similarity(rotation=rotation, translation=centre),
        )
        for lens, rotation, centre in zip(block.camera_of_photo, state.site_from_cam, state.centre_site_m, strict=True)
    )


def build_adjusted_block(
    problem: AdjustmentProblem, tie_points: TiePointSelection, solution: Solution, free: BoolArray
) -> AdjustedBlock:
    """The adjusted block with its covariance.

    Args:
        problem: the adjustment as solved last.
        tie_points: its tie points.
        solution: its solution.
        free: lens parameters (c, 8) that were adjusted; the others were fixed.

    Returns:
        the block.
    """
    state, index = solution.state, ParameterIndex.build(problem)
    tie = problem.image_points.is_tie_point
    residual = compute_reprojection_residuals(problem, state, solution.tie_sigma_px)[tie]
    tie_variance_factor = estimate_tie_variance_factor(
        residual, problem.image_points.photo[tie], problem.image_points.xy_img[tie]
    )
    uncertainty = estimate_uncertainty(problem, solution, len(tie_points), tie_variance_factor)
    covariance = uncertainty.covariance
    photos = len(state.centre_site_m)
    blocks = covariance[: index.lens, : index.lens].reshape(photos, 6, photos, 6)
    centres = blocks[:, :3, :, :3]
    diagonal = blocks[np.arange(photos), :, np.arange(photos), :]
    sigma = np.sqrt(np.diag(covariance))
    fixed = [
        f"{name} of camera {lens + 1}"
        for lens, row in enumerate(free)
        for name, is_free in zip(LENS_PARAMETERS, row, strict=True)
        if not is_free
    ]
    return AdjustedBlock(
        problem=problem,
        solution=solution,
        tie_points=tie_points,
        covariance=(diagonal + diagonal.transpose(0, 2, 1)) / 2,
        uncertainty=uncertainty,
        gps_offset_m=state.gps_offset_m,
        gps_offset_sigma_m=sigma[index.gps_offset : index.yaw].reshape(-1, 3),
        datum_covariance_m2=centres.mean(axis=(0, 2)),
        tie_variance_factor=tie_variance_factor,
        lens_sigma=sigma[index.lens : index.gps_offset].reshape(-1, len(LENS_PARAMETERS)),
        focal_height_correlation=_compute_focal_height_correlation(covariance, index, photos),
        fixed_parameters=tuple(fixed),
    )


def _compute_focal_height_correlation(covariance: Float64Array, index: ParameterIndex, photos: int) -> float:
    """Largest absolute correlation of a focal length with the block's mean height; near 1 they cannot be separated."""
    height = covariance[:, 2 : index.lens : 6].mean(axis=1)
    variance = float(height[2 : index.lens : 6].mean())
    focal = np.arange(index.lens, index.gps_offset, len(LENS_PARAMETERS))
    scale = np.sqrt(np.diag(covariance)[focal] * max(variance, 1e-18))
    return float(np.abs(height[focal] / scale).max())


def compute_held_out_residuals(adjusted: AdjustedBlock, marked: MarkedPoints) -> dict[int, Float64x3]:
    """Residual ``given - predicted`` (3,), metres in site, of each control point as if its survey had been left out.

    Keys are rows of ``marked``. Empty where fewer than three control points would remain.
    """
    control = np.flatnonzero(np.isfinite(marked.sigma_m).all(axis=1))
    if len(control) <= _MIN_REMAINING_POINTS:
        return {}
    fitted = marked.xyz_site_m[control] - adjusted.marked_xyz_site_m[control]
    variance = marked.sigma_m[control] ** 2
    # A point that disagrees was down-weighted in the adjustment, so less of it is left out.
    _, weight = compute_cauchy_loss((fitted**2 / variance).sum(axis=1), PRIOR_LOSS_SCALE)
    residual = compute_leave_one_out_residual(
        fitted,
        adjusted.uncertainty.compute_point_covariance(len(adjusted.tie_points) + control),
        variance / weight[:, None],
    )
    return {int(row): left_out for row, left_out in zip(control, residual, strict=True)}
