"""Attitudes as other programs write them, as rotations from the camera (x right, y down, z forward) into the world.

- quaternion or matrix: of world_from_cam or its inverse, of a camera whose axes are named;
- yaw, pitch, roll of a gimbal (DJI): yaw clockwise from north, pitch above the horizon, roll clockwise;
- yaw, pitch, roll from nadir (Pix4D, Metashape): of a body from whose belly the camera looks down, its top forward;
- omega, phi, kappa (photogrammetry): world_from_image = Rx(omega) Ry(phi) Rz(kappa), the image's y up, z backward.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import InputDataError
from facadelake.georeferencing.gps.priors import rotation_from_attitude

# Programs write six digits and more; what is further from a rotation is none.
_ORTHONORMAL_TOLERANCE = 1e-3


class RotationDirection(StrEnum):
    """Which way a quaternion or matrix turns."""

    WORLD_FROM_CAM = "world_from_cam"
    CAM_FROM_WORLD = "cam_from_world"


class CameraAxes(StrEnum):
    """How the camera's axes lie: computer vision's (OpenCV, COLMAP), or graphics' and photogrammetry's."""

    RIGHT_DOWN_FORWARD = "right_down_forward"
    RIGHT_UP_BACKWARD = "right_up_backward"


class PitchZero(StrEnum):
    """Where a camera of pitch 0 looks."""

    HORIZON = "horizon"
    NADIR = "nadir"


# The camera's axes, x right, y down, z forward, in the image's of photogrammetry, and those of a camera that looks out
# of a body's belly (x forward, y right, z down), each as columns; the matrix of north-east-down in east-north-up.
_IMAGE_FROM_CAM = np.diag([1.0, -1.0, -1.0])
_BODY_FROM_CAM = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def rotation_from_matrix(matrix: Float64Array, direction: RotationDirection, axes: CameraAxes) -> Float64Array:
    """world_from_cam (3, 3) of a matrix that is a rotation but for its digits.

    Raises InputDataError for one that is not orthonormal to 1e-3, or mirrors.
    """
    if not np.isfinite(matrix).all():
        raise InputDataError("the rotation has values that are no numbers")
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > _ORTHONORMAL_TOLERANCE:
        raise InputDataError(
            f"the rotation's rows are not orthonormal (off by {off:.2g}, {_ORTHONORMAL_TOLERANCE:g} allowed); are rows and "
            "columns in order, is a scale in it?"
        )
    if np.linalg.det(matrix) < 0:
        raise InputDataError("the rotation mirrors (determinant -1); one of the camera's or the world's axes is turned")
    turned = matrix if direction is RotationDirection.WORLD_FROM_CAM else matrix.T
    nearest: Float64Array = Rotation.from_matrix(turned).as_matrix()  # its polar part: digits leave it 1e-7 off
    return nearest @ _IMAGE_FROM_CAM if axes is CameraAxes.RIGHT_UP_BACKWARD else nearest


def rotation_from_quaternion(w_x_y_z: Float64Array, direction: RotationDirection, axes: CameraAxes) -> Float64Array:
    """world_from_cam (3, 3) of a quaternion, its real part first. Raises InputDataError where its length is not 1."""
    length = float(np.linalg.norm(w_x_y_z))
    if not abs(length - 1) < _ORTHONORMAL_TOLERANCE:
        raise InputDataError(f"the quaternion's length is {length:.4g}, not 1; is its order w, x, y, z?")
    w, x, y, z = w_x_y_z / length
    return rotation_from_matrix(Rotation.from_quat([x, y, z, w]).as_matrix(), direction, axes)


def rotation_from_yaw_pitch_roll(yaw_deg: float, pitch_deg: float, roll_deg: float, zero: PitchZero) -> Float64Array:
    """world_from_cam (3, 3), the world east-north-up, of a gimbal (zero at the horizon) or a body (zero at nadir)."""
    if zero is PitchZero.HORIZON:
        return rotation_from_attitude(yaw_deg, pitch_deg, roll_deg)
    ned_from_body = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    rotation: Float64Array = _ENU_FROM_NED @ ned_from_body @ _BODY_FROM_CAM
    return rotation


def rotation_from_omega_phi_kappa(omega_deg: float, phi_deg: float, kappa_deg: float) -> Float64Array:
    """world_from_cam (3, 3) of photogrammetry's angles."""
    turn = Rotation.from_euler("XYZ", [omega_deg, phi_deg, kappa_deg], degrees=True).as_matrix()
    rotation: Float64Array = turn @ _IMAGE_FROM_CAM
    return rotation


def list_alternative_conventions(world_from_cam: Float64Array) -> dict[str, Float64Array]:
    """How the rotation (3, 3) would be under other conventions, by what the header would have to say."""
    return {
        "the other word for rotation (world_from_cam, cam_from_world)": world_from_cam.T,
        "the other word for camera_axes (right_down_forward, right_up_backward)": world_from_cam @ _IMAGE_FROM_CAM,
        "the other words for rotation and camera_axes": (world_from_cam @ _IMAGE_FROM_CAM).T,
    }
