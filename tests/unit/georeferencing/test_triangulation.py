"""Intersection of marks: exact, with a wrong mark, and with rays at too small an angle."""

import numpy as np
from scipy.spatial.transform import Rotation

from facadelake.core.camera import Camera
from facadelake.core.frames import Similarity
from facadelake.georeferencing.triangulation import ImageRay, intersect_rays

CAMERA = Camera(width_px=4000, height_px=3000, fx_px=3000, fy_px=3000, cx_px=2000, cy_px=1500, k1=-0.05)
POINT = np.array([0.3, -0.2, 10.0])


def build_ray(x: float, *, off_px: tuple[float, float] = (0.0, 0.0)) -> ImageRay:
    """A camera beside the origin that looks along z and marks POINT."""
    pose = Similarity(
        rotation=Rotation.from_euler("y", -2.0 * x, degrees=True).as_matrix(), translation=np.array([x, 0, 0])
    )
    xy = CAMERA.project(pose.invert().apply(POINT[None]))[0]
    return ImageRay(camera=CAMERA, world_from_cam=pose, xy_img=xy + off_px)


def test_exact_marks_meet_in_the_point() -> None:
    found = intersect_rays([build_ray(x) for x in (-3.0, -1.0, 2.0, 4.0)])
    assert found is not None
    np.testing.assert_allclose(found.xyz_world, POINT, rtol=0, atol=1e-6)
    assert found.rms_px < 1e-3


def test_a_wrong_mark_is_not_used() -> None:
    found = intersect_rays([build_ray(-3.0), build_ray(-1.0), build_ray(2.0, off_px=(150.0, -60.0)), build_ray(4.0)])
    assert found is not None
    assert found.used.tolist() == [True, True, False, True]
    np.testing.assert_allclose(found.xyz_world, POINT, rtol=0, atol=1e-6)


def test_noise_of_a_pixel_stays_a_pixel() -> None:
    rng = np.random.default_rng(1)
    views = [build_ray(x, off_px=tuple(rng.normal(0, 1.0, 2))) for x in np.linspace(-4, 4, 9)]
    found = intersect_rays(views)
    assert found is not None
    assert 0.5 < found.rms_px < 2.5  # px
    assert 1e-4 < np.linalg.norm(found.xyz_world - POINT) < 0.02  # m; 1 px is 3.3 mm there


def test_one_ray_or_parallel_rays_give_no_point() -> None:
    assert intersect_rays([build_ray(0.0)]) is None
    assert intersect_rays([build_ray(0.0), build_ray(0.05)]) is None
