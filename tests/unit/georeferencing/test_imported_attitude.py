"""Attitudes of other programs against their published definitions, written out by hand."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from facadelake.core.errors import InputDataError
from facadelake.georeferencing.imported.attitude import (
    CameraAxes,
    PitchZero,
    RotationDirection,
    rotation_from_matrix,
    rotation_from_omega_phi_kappa,
    rotation_from_quaternion,
    rotation_from_yaw_pitch_roll,
)

Array = NDArray[np.float64]
ANGLE = st.floats(-180, 180)
EAST, NORTH, UP = np.eye(3)
RIGHT, DOWN, FORWARD = np.eye(3)  # of the camera


def rotate(rotation: Array, direction_cam: Array) -> Array:
    return rotation @ direction_cam


@given(ANGLE, ANGLE, ANGLE)
def test_omega_phi_kappa_is_the_published_matrix(omega_deg: float, phi_deg: float, kappa_deg: float) -> None:
    """Term by term as Pix4D's article prints Rx(omega) Ry(phi) Rz(kappa); its image has y up and z backward."""
    o, p, k = radians(omega_deg), radians(phi_deg), radians(kappa_deg)
    published = np.array(
        [
            [cos(k) * cos(p), -sin(k) * cos(p), sin(p)],
            [cos(k) * sin(o) * sin(p) + sin(k) * cos(o), cos(k) * cos(o) - sin(k) * sin(o) * sin(p), -sin(o) * cos(p)],
            [sin(k) * sin(o) - cos(k) * cos(o) * sin(p), sin(k) * cos(o) * sin(p) + cos(k) * sin(o), cos(o) * cos(p)],
        ]
    )
    found = rotation_from_omega_phi_kappa(omega_deg, phi_deg, kappa_deg)
    np.testing.assert_allclose(rotate(found, RIGHT), published[:, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotate(found, -DOWN), published[:, 1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotate(found, -FORWARD), published[:, 2], rtol=0, atol=1e-12)


@given(ANGLE, st.floats(-90, 90), ANGLE)
def test_a_gimbal_is_north_east_down(yaw_deg: float, pitch_deg: float, roll_deg: float) -> None:
    """DJI: Rz(yaw) Ry(pitch) Rx(roll) of a body whose x looks out of the lens, y to the right, z down."""
    y, p, r = radians(yaw_deg), radians(pitch_deg), radians(roll_deg)
    about_z = np.array([[cos(y), -sin(y), 0], [sin(y), cos(y), 0], [0, 0, 1]])
    about_y = np.array([[cos(p), 0, sin(p)], [0, 1, 0], [-sin(p), 0, cos(p)]])
    about_x = np.array([[1, 0, 0], [0, cos(r), -sin(r)], [0, sin(r), cos(r)]])
    ned = about_z @ about_y @ about_x
    found = rotation_from_yaw_pitch_roll(yaw_deg, pitch_deg, roll_deg, PitchZero.HORIZON)
    for axis_cam, axis_body in ((FORWARD, 0), (RIGHT, 1), (DOWN, 2)):
        north, east, down = ned[:, axis_body]
        np.testing.assert_allclose(rotate(found, axis_cam), [east, north, -down], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("yaw", "pitch", "looks", "top"),
    [(0, 0, -UP, NORTH), (90, 0, -UP, EAST), (270, 0, -UP, -EAST), (0, 90, NORTH, UP), (90, 90, EAST, UP)],
)
def test_pitch_from_nadir_by_the_published_examples(yaw: float, pitch: float, looks: Array, top: Array) -> None:
    """Pix4D's article: at 0, 0, 0 the camera looks down and the image's top is north; pitch 90 looks forward."""
    found = rotation_from_yaw_pitch_roll(yaw, pitch, 0.0, PitchZero.NADIR)
    np.testing.assert_allclose(rotate(found, FORWARD), looks, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rotate(found, -DOWN), top, rtol=0, atol=1e-12)


def test_directions_and_axes_of_one_camera() -> None:
    """A camera that looks east with its top up, written in four ways."""
    world_from_cam = np.column_stack([-NORTH, -UP, EAST])
    flipped = np.column_stack([-NORTH, UP, -EAST])  # y up, z backward
    down, up = CameraAxes.RIGHT_DOWN_FORWARD, CameraAxes.RIGHT_UP_BACKWARD
    for matrix, direction, axes in (
        (world_from_cam, RotationDirection.WORLD_FROM_CAM, down),
        (world_from_cam.T, RotationDirection.CAM_FROM_WORLD, down),
        (flipped, RotationDirection.WORLD_FROM_CAM, up),
        (flipped.T, RotationDirection.CAM_FROM_WORLD, up),
    ):
        np.testing.assert_allclose(rotation_from_matrix(matrix, direction, axes), world_from_cam, rtol=0, atol=1e-12)


def test_a_rounded_matrix_becomes_a_rotation() -> None:
    """Six digits, as files have them, leave it orthonormal to 1e-12."""
    exact = rotation_from_omega_phi_kappa(12.3, -40.2, 77.7)
    found = rotation_from_matrix(np.round(exact, 6), RotationDirection.WORLD_FROM_CAM, CameraAxes.RIGHT_DOWN_FORWARD)
    np.testing.assert_allclose(found @ found.T, np.eye(3), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found, exact, rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(3) * 1.01, "not orthonormal"),
        (np.diag([1.0, 1.0, -1.0]), "reflection"),
        (np.full((3, 3), np.nan), "not finite"),
    ],
)
def test_an_invalid_rotation_is_refused(matrix: Array, message: str) -> None:
    with pytest.raises(InputDataError, match=message):
        rotation_from_matrix(matrix, RotationDirection.WORLD_FROM_CAM, CameraAxes.RIGHT_DOWN_FORWARD)
    with pytest.raises(InputDataError, match="length is 2"):
        rotation_from_quaternion(
            np.array([0.0, 0, 0, 2]), RotationDirection.WORLD_FROM_CAM, CameraAxes.RIGHT_DOWN_FORWARD
        )
