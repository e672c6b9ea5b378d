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

from facadelake.core.arrays import Float64Array, Float64x3x3
from facadelake.core.errors import InputDataError
from facadelake.georeferencing.gps.priors import rotation_from_attitude

# Programs write six digits or more; a matrix with a larger deviation is not a rotation.
_ORTHONORMAL_TOLERANCE = 1e-3


class RotationDirection(StrEnum):
    """The transform that a quaternion or matrix states."""

    WORLD_FROM_CAM = "world_from_cam"
    CAM_FROM_WORLD = "cam_from_world"


class CameraAxes(StrEnum):
    """The camera's axes: those of computer vision (OpenCV, COLMAP), or of graphics and photogrammetry."""

    RIGHT_DOWN_FORWARD = "right_down_forward"
    RIGHT_UP_BACKWARD = "right_up_backward"


class PitchZero(StrEnum):
    """Viewing direction of a camera with pitch 0."""

    HORIZON = "horizon"
    NADIR = "nadir"


# The camera's axes, x right, y down, z forward, in the image's of photogrammetry, and those of a camera that looks out
# of a body's belly (x forward, y right, z down), each as columns; the matrix of north-east-down in east-north-up.
_IMAGE_FROM_CAM = np.diag([1.0, -1.0, -1.0])
_BODY_FROM_CAM = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def rotation_from_matrix(matrix: Float64x3x3, direction: RotationDirection, axes: CameraAxes) -> Float64x3x3:
    """world_from_cam (3, 3) of a matrix (3, 3) that is a rotation up to rounding.

    Raises InputDataError where it is not orthonormal to 1e-3, or a reflection.
    """
    if not np.isfinite(matrix).all():
        raise InputDataError("the rotation has values that are not finite")
    deviation = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if deviation > _ORTHONORMAL_TOLERANCE:
        raise InputDataError(
            f"the rotation's rows are not orthonormal (deviation {deviation:.2g}, limit {_ORTHONORMAL_TOLERANCE:g}); "
            "check the order of rows and columns, and that it contains no scale"
        )
    if np.linalg.det(matrix) < 0:
        raise InputDataError(
            "the rotation is a reflection (determinant -1); one axis of the camera or of the world is inverted"
        )
    stated = matrix if direction is RotationDirection.WORLD_FROM_CAM else matrix.T
    # The nearest rotation (polar decomposition): rounding leaves the matrix 1e-7 off.
    nearest: Float64Array = Rotation.from_matrix(stated).as_matrix()
    return nearest @ _IMAGE_FROM_CAM if axes is CameraAxes.RIGHT_UP_BACKWARD else nearest


def rotation_from_quaternion(w_x_y_z: Float64Array, direction: RotationDirection, axes: CameraAxes) -> Float64x3x3:
    """world_from_cam (3, 3) of a quaternion (4,), its real part first.

    Raises InputDataError where its length is not 1.
    """
    length = float(np.linalg.norm(w_x_y_z))
    if not abs(length - 1) < _ORTHONORMAL_TOLERANCE:
        raise InputDataError(f"the quaternion's length is {length:.4g}, not 1; check its order (w, x, y, z)")
    w, x, y, z = w_x_y_z / length
    return rotation_from_matrix(Rotation.from_quat([x, y, z, w]).as_matrix(), direction, axes)


def rotation_from_yaw_pitch_roll(yaw_deg: float, pitch_deg: float, roll_deg: float, zero: PitchZero) -> Float64x3x3:
    """world_from_cam (3, 3), the world east-north-up, of a gimbal or a body.

    Args:
        yaw_deg: clockwise from north.
        pitch_deg: above the horizon, or from nadir.
        roll_deg: clockwise as the camera sees it.
        zero: the direction of pitch 0: the horizon for a gimbal, nadir for a body.

    Returns:
        the rotation.
    """
    if zero is PitchZero.HORIZON:
        return rotation_from_attitude(yaw_deg, pitch_deg, roll_deg)
    ned_from_body = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    rotation: Float64Array = _ENU_FROM_NED @ ned_from_body @ _BODY_FROM_CAM
    return rotation


def rotation_from_omega_phi_kappa(omega_deg: float, phi_deg: float, kappa_deg: float) -> Float64x3x3:
    """world_from_cam (3, 3) of photogrammetry's angles (Kraus 2007)."""
    world_from_image = Rotation.from_euler("XYZ", [omega_deg, phi_deg, kappa_deg], degrees=True).as_matrix()
    rotation: Float64Array = world_from_image @ _IMAGE_FROM_CAM
    return rotation


def list_alternative_conventions(world_from_cam: Float64x3x3) -> dict[str, Float64x3x3]:
    """The rotation (3, 3) under other conventions, by the change of the header that would state them."""
    return {
        "the other value of rotation (world_from_cam, cam_from_world)": world_from_cam.T,
        "the other value of camera_axes (right_down_forward, right_up_backward)": world_from_cam @ _IMAGE_FROM_CAM,
        "the other values of rotation and camera_axes": (world_from_cam @ _IMAGE_FROM_CAM).T,
    }
