"""The covariance of an observation against a Monte Carlo simulation of pose, pixel and surface."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facadelake.building.surface.raycasting import Surface
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.pose_table import read_pose_covariances
from facadelake.core.tables import table_from_rows
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings
from tests.unit.registration.wall_scene import CAMERA, look_at

DISTORTED = Camera(
    width_px=2000, height_px=1500, fx_px=1500, fy_px=1480, cx_px=1030, cy_px=720, k1=-0.08, k2=0.03, p1=2e-3, p2=-1e-3
)
BOX = (560.0, 950.0, 60.0, 24.0)
DRAWS = 6000
WITHIN = 0.08  # four sigmas of a variance from this number of draws


def pose_covariance(sigma_m: float, sigma_deg: float) -> np.ndarray:
    """Centre and attitude are correlated, as they are where tie points determine a pose."""
    rng = np.random.default_rng(5)
    mix = np.linalg.qr(rng.normal(size=(6, 6)))[0] * [0.3, 0.6, 0.9, 1.0, 1.1, 1.3]
    scale = np.diag([sigma_m] * 3 + [np.radians(sigma_deg)] * 3)
    return scale @ mix @ mix.T @ scale


def simulate_positions(posed, settings, covariance, rng) -> np.ndarray:
    """Positions (DRAWS, 3) of the box's centre on the wall y = 0, with random errors of pose, pixel and wall."""
    x, y, width, height = BOX
    poses = rng.multivariate_normal(np.zeros(6), covariance, size=DRAWS)
    sigma = np.hypot(settings.pixel_sigma_px, settings.box_sigma_share * np.array([width, height]))
    pixels = np.array([x + width / 2, y + height / 2]) + rng.normal(size=(DRAWS, 2)) * sigma
    wall_y = rng.normal(size=DRAWS) * settings.model_sigma_m
    out = np.empty((DRAWS, 3))
    for i in range(DRAWS):
        turned = posed.site_from_cam.rotation @ Rotation.from_rotvec(poses[i, 3:]).as_matrix()
        at = posed.site_from_cam.translation + poses[i, :3]
        ray = turned @ posed.camera.rays_cam_from_img(pixels[i : i + 1])[0]
        out[i] = at + ray * (wall_y[i] - at[1]) / ray[1]
    return out


@pytest.mark.parametrize(
    ("eye", "settings", "covariance"),
    [
        ([-6.0, -9.0, 4.0], RegistrationSettings(model_sigma_m=0.03), pose_covariance(0.02, 0.1)),
        ([-12.0, -4.5, 5.0], RegistrationSettings(model_sigma_m=0.03), pose_covariance(0.002, 0.01)),
        ([1.0, -5.0, 2.0], RegistrationSettings(model_sigma_m=1e-4, box_sigma_share=0.0), pose_covariance(0.05, 0.3)),
        ([-6.0, -9.0, 4.0], RegistrationSettings(model_sigma_m=1e-4), np.zeros((6, 6))),
    ],
    ids=["all of it", "the wall off its model, obliquely", "the pose", "the box"],
)
def test_the_covariance_is_that_of_simulated_positions(wall, detections_of, eye, settings, covariance):
    posed = replace(look_at(eye, [-1.0, 0.0, 1.5]), camera=DISTORTED)
    made = detections_of(("a", "p", "crack", BOX))
    row = observe_detections(made, {"p": posed}, wall, Surface(wall), settings, {"p": covariance}).to_pylist()[0]
    assert row["observation_outcome"] == "registered"
    stated = np.array(row["covariance_site"]).reshape(3, 3)
    np.testing.assert_allclose(stated, stated.T, rtol=0, atol=1e-15)  # m2
    places = simulate_positions(posed, settings, covariance, np.random.default_rng(11))
    np.testing.assert_allclose(
        places.mean(axis=0), [row["x_site_m"], row["y_site_m"], row["z_site_m"]], rtol=0, atol=0.01
    )  # m
    # In the axes in which the stated covariance is the identity, the simulated one is too: two-sided.
    values, axes = np.linalg.eigh(stated)
    kept = values > 1e-9 * values.max()
    found = np.cov((places - places.mean(axis=0)) @ axes[:, kept] / np.sqrt(values[kept]), rowvar=False)
    np.testing.assert_allclose(found, np.eye(kept.sum()), rtol=0, atol=WITHIN)
    sigmas = [row["sigma_east_m"], row["sigma_north_m"], row["sigma_up_m"]]
    np.testing.assert_allclose(sigmas, np.sqrt(np.diag(stated)), rtol=0, atol=1e-12)  # m
    np.testing.assert_allclose(sigmas, places.std(axis=0), rtol=WITHIN / 2, atol=1e-9)  # m


def test_at_a_large_incidence_the_walls_deviation_is_a_large_shift_along_the_wall(wall, detections_of):
    settings = RegistrationSettings(model_sigma_m=0.03, box_sigma_share=0.0)
    steep = np.radians(75.0)
    posed = look_at([-10 * np.sin(steep), -10 * np.cos(steep), 2.0], [0.0, 0.0, 2.0])
    made = detections_of(("a", "p", "crack", (995.0, 745.0, 10.0, 10.0)))
    row = observe_detections(made, {"p": posed}, wall, Surface(wall), settings).to_pylist()[0]
    # Half a pixel at 10 m is 3.3 mm, on this wall 13 mm; the wall's 3 cm shift the position by 3 cm tan(75 deg).
    half_pixel = 0.5 * 10 / 1500 / np.cos(steep)
    np.testing.assert_allclose(row["sigma_east_m"], np.hypot(0.03 * np.tan(steep), half_pixel), rtol=0, atol=5e-4)  # m
    np.testing.assert_allclose(row["sigma_north_m"], 0.03, rtol=0, atol=5e-4)  # m


def test_covariances_come_from_the_poses_that_were_measured():
    values = (np.arange(36.0) + 1).tolist()
    common = {
        "image_width_px": CAMERA.width_px, "image_height_px": CAMERA.height_px, "tie_points": 9,
    }  # fmt: skip
    poses = table_from_rows(
        "poses",
        [
            {"photo_id": "a", "pose_source": "sfm", "covariance": values, **common},
            {"photo_id": "b", "pose_source": "prior", "covariance": values, **common},
            {"photo_id": "c", "pose_source": "resected", **common},
        ],
    )
    found = read_pose_covariances(poses)
    assert list(found) == ["a"]
    np.testing.assert_array_equal(found["a"], np.arange(36.0).reshape(6, 6) + 1)


def test_a_pose_without_covariance_counts_as_exact(wall, detections_of):
    posed = PosedCamera(
        camera=CAMERA,
        site_from_cam=Similarity(
            rotation=look_at([0, -10, 2], [0, 0, 2]).site_from_cam.rotation, translation=np.array([0.0, -10.0, 2.0])
        ),
    )
    made = detections_of(("a", "p", "crack", BOX))
    without = observe_detections(made, {"p": posed}, wall, Surface(wall), RegistrationSettings()).to_pylist()[0]
    exact = observe_detections(
        made, {"p": posed}, wall, Surface(wall), RegistrationSettings(), {"p": np.zeros((6, 6))}
    ).to_pylist()[0]
    loose = observe_detections(
        made, {"p": posed}, wall, Surface(wall), RegistrationSettings(), {"p": pose_covariance(0.05, 0.3)}
    ).to_pylist()[0]
    assert without["covariance_site"] == exact["covariance_site"]
    assert loose["sigma_up_m"] > 1.3 * exact["sigma_up_m"]


def test_a_measured_surface_has_its_own_sigma(wall, detections_of):
    made = detections_of(("a", "p", "crack", BOX))
    posed = {"p": look_at([0, -10, 2], [0, 0, 2])}
    declared = RegistrationSettings(model_sigma_m=0.03)
    measured = replace(wall, surface_sigma_m=0.007)
    [one] = observe_detections(made, posed, wall, Surface(wall), declared).to_pylist()
    [other] = observe_detections(made, posed, measured, Surface(wall), declared).to_pylist()
    np.testing.assert_allclose([one["sigma_north_m"], other["sigma_north_m"]], [0.03, 0.007], rtol=0, atol=1e-9)  # m


def test_along_the_wall_itself_the_covariance_is_still_a_number(wall, detections_of):
    posed = look_at([-9.9, -1e-3, 2.0], [9.0, 0.0, 2.0])
    [row] = observe_detections(
        detections_of(("a", "p", "crack", (995.0, 745.0, 10.0, 10.0))),
        {"p": posed},
        wall,
        Surface(wall),
        RegistrationSettings(target_share_min=0.1),
        {"p": pose_covariance(0.02, 0.1)},
    ).to_pylist()
    assert row["observation_outcome"] == "grazing"
    assert np.isfinite(row["covariance_site"]).all()
    assert row["sigma_east_m"] > 1.0  # m
