"""The camera against OpenCV's projection, and against itself backwards."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity

CAMERA = Camera(
    width_px=3072, height_px=2048, fx_px=2759.5, fy_px=2764.2, cx_px=1520.7, cy_px=1006.8,
    k1=-0.08, k2=0.03, p1=7e-4, p2=-4e-4,
)  # fmt: skip
POSE = Similarity(
    rotation=Rotation.from_euler("xyz", [80, 10, -30], degrees=True).as_matrix(),
    translation=np.array([12.0, -30.0, 4.0]),
)


def test_projection_is_opencvs() -> None:
    xyz = np.random.default_rng(1).uniform([-4, -3, 6], [4, 3, 20], (200, 3))
    expected, _ = cv2.projectPoints(xyz, np.zeros(3), np.zeros(3), CAMERA.matrix, CAMERA.distortion)
    np.testing.assert_allclose(CAMERA.project(xyz), expected.reshape(-1, 2), rtol=0, atol=1e-9)  # px


def test_a_posed_camera_is_opencvs_with_the_inverse_pose() -> None:
    posed = PosedCamera(camera=CAMERA, site_from_cam=POSE)
    xyz = POSE.apply(np.random.default_rng(2).uniform([-4, -3, 6], [4, 3, 20], (50, 3)))
    rvec = Rotation.from_matrix(POSE.rotation.T).as_rotvec()
    tvec = -POSE.rotation.T @ POSE.translation
    expected, _ = cv2.projectPoints(xyz, rvec, tvec, CAMERA.matrix, CAMERA.distortion)
    np.testing.assert_allclose(posed.project_site(xyz), expected.reshape(-1, 2), rtol=0, atol=1e-8)  # px
    np.testing.assert_array_equal(posed.centre_site_m, [12.0, -30.0, 4.0])


@given(st.floats(0, 3072), st.floats(0, 2048), st.floats(0.1, 1000))
def test_a_ray_comes_back_to_its_pixel(x: float, y: float, distance: float) -> None:
    ray = CAMERA.rays_cam_from_img(np.array([[x, y]]))
    assert np.linalg.norm(ray) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(CAMERA.project(ray * distance), [[x, y]], rtol=0, atol=1e-4)  # px


def test_a_ray_in_site_passes_the_point_it_came_from() -> None:
    posed = PosedCamera(camera=CAMERA, site_from_cam=POSE)
    xyz = POSE.apply(np.array([[1.0, -0.5, 9.0], [-2.0, 1.0, 14.0]]))
    origin, direction = posed.rays_site_from_img(posed.project_site(xyz))
    along = np.einsum("ij,ij->i", xyz - origin, direction)
    np.testing.assert_allclose(origin + along[:, None] * direction, xyz, rtol=0, atol=1e-6)  # m


def test_points_behind_the_camera_have_no_pixel() -> None:
    assert np.isnan(CAMERA.project(np.array([[0.0, 0, -5], [0, 0, 0]]))).all()


def test_the_principal_ray_is_straight_ahead_in_the_pixel_convention() -> None:
    """The principal point of an ideal camera of 4 x 2 pixels is (2, 1), a corner between pixels."""
    ideal = Camera(width_px=4, height_px=2, fx_px=10, fy_px=10, cx_px=2, cy_px=1)
    np.testing.assert_allclose(ideal.rays_cam_from_img(np.array([[2.0, 1.0]])), [[0, 0, 1]], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(ideal.is_inside(np.array([[0.5, 0.5], [4.0, 2.0], [-0.1, 1], [2, 2.1]])),
                                  [True, True, False, False])  # fmt: skip


@pytest.mark.parametrize("bad", [{"fx_px": 0.0}, {"k1": float("nan")}, {"width_px": -1}])
def test_an_impossible_camera_is_refused(bad: dict[str, float]) -> None:
    good = {"width_px": 4, "height_px": 2, "fx_px": 10.0, "fy_px": 10.0, "cx_px": 2.0, "cy_px": 1.0}
    with pytest.raises(InputDataError, match="not usable"):
        Camera(**(good | bad))  # type: ignore[arg-type]
