"""The unknowns of the adjustment: their values, and their places in the parameter vector of the reduced system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx3, Float64Nx3x3
from facadelake.georeferencing.adjustment.problem import AdjustmentProblem
from facadelake.georeferencing.adjustment.projection import lens_from_camera


@dataclass(frozen=True, kw_only=True, eq=False)
class AdjustmentState:
    """Values of all unknowns.

    Photographs: ``centre_site_m`` (n, 3), ``site_from_cam`` (n, 3, 3); ``lens`` (c, 8); object points ``xyz_site_m``
    (m, 3); flights: ``gps_offset_m`` (f, 3), ``yaw_offset_rad`` (f,); ``wall_deviation_m`` (w,).
    """

    centre_site_m: Float64Nx3
    site_from_cam: Float64Nx3x3
    lens: Float64Array
    xyz_site_m: Float64Nx3
    gps_offset_m: Float64Nx3
    yaw_offset_rad: Float64N
    wall_deviation_m: Float64N


@dataclass(frozen=True, kw_only=True)
class ParameterIndex:
    """Places in the parameter vector (g,) of the reduced system.

    Photographs stand first (6 each: centre in site, rotation vector in cam), then, from ``lens`` on, lenses (8 each),
    from ``gps_offset`` flights (3 each), from ``yaw`` flights (1 each), from ``wall`` walls (1 each); ``size`` is g.
    """

    lens: int
    gps_offset: int
    yaw: int
    wall: int
    size: int

    @staticmethod
    def build(problem: AdjustmentProblem) -> ParameterIndex:
        """The places of a problem's parameters."""
        lens = 6 * len(problem.block.centre_site_m)
        gps_offset = lens + 8 * len(problem.block.cameras)
        yaw = gps_offset + 3 * len(problem.positions.offset_sigma_m)
        wall = yaw + len(problem.attitudes.yaw_sigma_rad)
        return ParameterIndex(
            lens=lens, gps_offset=gps_offset, yaw=yaw, wall=wall, size=wall + len(problem.point_to_plane.wall_sigma_m)
        )


def initialise_state(problem: AdjustmentProblem) -> AdjustmentState:
    """The initial state; offsets and deviations are zero."""
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
    state: AdjustmentState, problem: AdjustmentProblem, step: Float64N, point_step: Float64Nx3
) -> AdjustmentState:
    """The state after one step of the solver.

    Args:
        state: values before the step.
        problem: the adjustment, for the places of its parameters.
        step: step (g,) of the reduced system's parameters, in the order of ``ParameterIndex``. Rotations are
            multiplied from the right: ``site_from_cam @ exp(step)``.
        point_step: step (m, 3) of the object points, metres in site.

    Returns:
        the new state.
    """
    index = ParameterIndex.build(problem)
    photo = step[: index.lens].reshape(-1, 6)
    return AdjustmentState(
        centre_site_m=state.centre_site_m + photo[:, :3],
        site_from_cam=state.site_from_cam @ Rotation.from_rotvec(photo[:, 3:]).as_matrix(),
        lens=state.lens + step[index.lens : index.gps_offset].reshape(-1, 8),
        xyz_site_m=state.xyz_site_m + point_step,
        gps_offset_m=state.gps_offset_m + step[index.gps_offset : index.yaw].reshape(-1, 3),
        yaw_offset_rad=state.yaw_offset_rad + step[index.yaw : index.wall],
        wall_deviation_m=state.wall_deviation_m + step[index.wall :],
    )
