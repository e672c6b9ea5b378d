"""The adjustment's projection against the domain's camera, OpenCV and difference quotients."""

import cv2
import numpy as np
import pytest

from facadelake.core.camera import Camera
from facadelake.georeferencing.adjustment.projection import LENS_PARAMETERS, camera_from_lens, lens_from_camera, project

CAMERA = Camera(
    width_px=5280, height_px=3956, fx_px=3700.0, fy_px=3690.0, cx_px=2655.0, cy_px=1962.0, k1=-0.11, k2=0.03,
    p1=1.3e-3, p2=-0.7e-3,
)  # fmt: skip


def draw_points(count: int = 60) -> np.ndarray:
    """Points (n, 3) in cam, out to the image's corners."""
    rng = np.random.default_rng(3)
    depth = rng.uniform(3, 40, count)
    return np.column_stack([rng.uniform(-0.7, 0.7, count) * depth, rng.uniform(-0.5, 0.5, count) * depth, depth])


def test_pixels_are_the_cameras_and_opencvs() -> None:
    xyz = draw_points()
    found = project(xyz, np.tile(lens_from_camera(CAMERA), (len(xyz), 1)))
    np.testing.assert_allclose(found.xy_img, CAMERA.project(xyz), rtol=0, atol=1e-9)  # px
    by_opencv, _ = cv2.projectPoints(xyz, np.zeros(3), np.zeros(3), CAMERA.matrix, CAMERA.distortion)
    np.testing.assert_allclose(found.xy_img, by_opencv.reshape(-1, 2), rtol=0, atol=1e-8)  # px
    assert found.in_front.all()


def test_derivatives_are_difference_quotients_of_opencv() -> None:
    xyz = draw_points()
    found = project(xyz, np.tile(lens_from_camera(CAMERA), (len(xyz), 1)))

    def pixels(at: np.ndarray, lens: np.ndarray) -> np.ndarray:
        camera = camera_from_lens(lens, CAMERA)
        return cv2.projectPoints(at, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0].reshape(-1, 2)

    lens = lens_from_camera(CAMERA)
    for axis in range(3):
        step = np.eye(3)[axis] * 1e-5
        slope = (pixels(xyz + step, lens) - pixels(xyz - step, lens)) / 2e-5
        np.testing.assert_allclose(
            found.jacobian_xyz_cam[:, :, axis], slope, rtol=1e-6, atol=1e-4
        )  # px/m, of 100 to 1000
    for term, name in enumerate(LENS_PARAMETERS):
        step = np.eye(len(LENS_PARAMETERS))[term] * (1e-2 if name.endswith("px") else 1e-5)
        slope = (pixels(xyz, lens + step) - pixels(xyz, lens - step)) / (2 * step[term])
        np.testing.assert_allclose(found.jacobian_lens[:, :, term], slope, rtol=1e-6, atol=1e-4, err_msg=name)


def test_each_point_has_its_own_lens() -> None:
    xyz = draw_points(2)
    other = Camera(width_px=4000, height_px=3000, fx_px=2900.0, fy_px=2900.0, cx_px=2000.0, cy_px=1500.0)
    found = project(xyz, np.array([lens_from_camera(CAMERA), lens_from_camera(other)]))
    np.testing.assert_allclose(found.xy_img[0], CAMERA.project(xyz[:1])[0], rtol=0, atol=1e-9)  # px
    np.testing.assert_allclose(found.xy_img[1], other.project(xyz[1:])[0], rtol=0, atol=1e-9)  # px


@pytest.mark.parametrize("depth_m", [0.0, -5.0])
def test_a_point_at_or_behind_the_camera_is_said_to_be(depth_m: float) -> None:
    found = project(np.array([[0.3, 0.2, depth_m], [0.3, 0.2, 5.0]]), np.tile(lens_from_camera(CAMERA), (2, 1)))
    assert found.in_front.tolist() == [False, True]
    assert np.isfinite(found.xy_img).all()


def test_lens_and_camera_are_inverse() -> None:
    back = camera_from_lens(lens_from_camera(CAMERA), CAMERA)
    for name in ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2"):
        assert getattr(back, name) == pytest.approx(getattr(CAMERA, name), rel=1e-14), name
    assert (back.width_px, back.height_px) == (5280, 3956)
