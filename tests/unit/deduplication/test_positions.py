"""Where defects are: rays that cross against the surface that the model has, and how well that is known."""

from dataclasses import fields

import numpy as np
import pytest

from facadelake.deduplication.candidate_pairs import PositionNoise
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.position import estimate_positions
from facadelake.deduplication.settings import MergeSettings

NORMAL = np.array([0.0, -1, 0])
EYES = np.array([[-6.0, -8, 1], [5.0, -9, 2], [0.5, -10, 0], [-2.0, -7, 3], [3.0, -12, 1]])
NOISE = PositionNoise(size_share=0.02, floor_m=0.003, relief_m=0.05)


def observe_place(place, eyes=EYES, aside=None, size_m=0.2, pose_covariance_m2=None):
    """Observations from ``eyes`` of a point in front of or behind the model's wall y = 0; hits shifted ``aside``."""
    ray = (place if aside is None else place + aside) - eyes
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    distance = -eyes[:, 1] / ray[:, 1]
    n = len(eyes)
    return ObservationArrays(
        xyz_site_m=eyes + ray * distance[:, None],
        normal_site=np.tile(NORMAL, (n, 1)),
        ray_site=ray,
        distance_m=distance,
        width_m=np.full(n, size_m),
        height_m=np.full(n, size_m),
        gsd_m=np.full(n, 0.002),
        photo=np.arange(n),
        defect_class=np.zeros(n, dtype=np.int64),
        box_img=np.full((n, 4), np.nan),
        pose_covariance_m2=np.zeros((n, 3, 3)) if pose_covariance_m2 is None else pose_covariance_m2,
    )


def one(observations, noise=NOISE, settings=None):
    found = estimate_positions(
        observations, np.zeros(len(observations), dtype=np.int64), noise, settings or MergeSettings()
    )
    return found


def test_crossing_rays_find_the_relief_that_the_model_lacks():
    """The real point is 8 cm in front of the model's wall; the hits are where each ray hit the model."""
    place = np.array([0.3, -0.08, 1.2])
    found = one(observe_place(place))
    assert (
        0.0 < np.linalg.norm(found.xyz_site_m[0] - place) < 0.002
    )  # m: the prior of the surface has a small influence
    assert 0.077 < found.deviation_m[0] < 0.08  # m, before the wall
    assert found.triangulated[0]
    mean_of_hits = observe_place(place).xyz_site_m.mean(axis=0)
    assert abs(mean_of_hits[1]) < 1e-9  # m: no mean of hits can leave the model


def test_one_ray_stays_on_the_surface_with_the_relief_along_it():
    observation = observe_place(np.array([0.3, -0.08, 1.2]), EYES[:1])
    found = one(observation)
    np.testing.assert_allclose(found.xyz_site_m[0], observation.xyz_site_m[0], rtol=0, atol=1e-12)  # m
    assert not found.triangulated[0]
    np.testing.assert_allclose(found.deviation_sigma_m[0], 0.05, rtol=0, atol=1e-6)  # m
    along = observation.ray_site[0] @ found.covariance_m2[0] @ observation.ray_site[0]
    cosine = abs(observation.ray_site[0, 1])
    np.testing.assert_allclose(along**0.5, 0.05 / cosine, rtol=0, atol=0.002)  # m: along the ray the relief is longer


def test_rays_side_by_side_leave_the_place_on_the_surface():
    eyes = np.array([[0.0, -10, 1], [0.05, -10, 1]])
    found = one(observe_place(np.array([0.3, -0.08, 1.2]), eyes))
    assert abs(found.xyz_site_m[0, 1]) < 0.01  # m
    assert not found.triangulated[0]


def test_one_wrong_observation_hardly_shifts_the_defect():
    place = np.array([0.3, -0.03, 1.2])
    aside = np.zeros((5, 3))
    aside[1] = [0.5, 0, 0.3]
    right, wrong = one(observe_place(place)), one(observe_place(place, aside=aside))
    assert np.linalg.norm(right.xyz_site_m[0] - place) < 0.002  # m
    assert np.linalg.norm(wrong.xyz_site_m[0] - place) < 0.005  # m
    hits = observe_place(place, aside=aside).xyz_site_m
    assert np.linalg.norm(hits.mean(axis=0) - place) > 0.1  # m: the plain mean


def test_with_gps_alone_the_surface_dominates():
    """The whole block 0.8 m too far forward: its rays cross there, and the wall is where the model has it."""
    observations = observe_place(np.array([0.3, -0.8, 1.2]))
    trusted, doubted = one(observations), one(observations, settings=MergeSettings(offset_m=2.0))
    assert abs(trusted.xyz_site_m[0, 1] + 0.8) < 0.05  # m
    assert abs(doubted.xyz_site_m[0, 1]) < 0.01  # m
    np.testing.assert_allclose(doubted.xyz_site_m[0, [0, 2]], [0.3, 1.2], rtol=0, atol=0.01)  # m: what GPS leaves
    sigma = np.sqrt(np.diagonal(doubted.covariance_m2[0]))
    assert sigma[0] > 1.9  # m, along the wall
    assert sigma[1] < 0.06  # m, across it: the relief


def test_what_the_poses_share_does_not_average_out():
    place, shared = np.array([0.3, -0.03, 1.2]), np.diag([0.02, 0.01, 0.015]) ** 2
    free = one(observe_place(place)).covariance_m2[0]
    held = one(observe_place(place, pose_covariance_m2=np.tile(shared, (5, 1, 1)))).covariance_m2[0]
    np.testing.assert_allclose(held - free, shared, rtol=0, atol=1e-9)  # m2
    measured = one(
        observe_place(place, pose_covariance_m2=np.tile(shared, (5, 1, 1))),
        settings=MergeSettings(block_sigma_m=0.005),
    ).covariance_m2[0]
    np.testing.assert_allclose(np.trace(measured - free) / 3, 0.005**2, rtol=0, atol=1e-9)  # m2


@pytest.mark.parametrize("views", [2, 5])
def test_the_covariance_holds_what_is_off(views):
    """Noise of known size in 400 defects: 95 % of the errors lie in the ellipsoid, neither fewer nor all."""
    rng = np.random.default_rng(views)
    # Boxes vary along the wall by a share of their size, poses in all directions.
    along = np.hypot(0.02 * 0.2, 0.003)
    places = [np.array([0.3, offset, 1.2]) for offset in rng.normal(0, 0.05, 400)]
    made = [
        observe_place(place, EYES[:views], aside=rng.normal(0, 1, (views, 3)) * [along, 0.003, along])
        for place in places
    ]
    whole = ObservationArrays(
        **{f.name: np.concatenate([getattr(one, f.name) for one in made]) for f in fields(ObservationArrays)}
    )
    found = estimate_positions(whole, np.repeat(np.arange(400), views), NOISE, MergeSettings())
    error = found.xyz_site_m - np.array(places)
    squared = np.einsum("gi,gij,gj->g", error, np.linalg.inv(found.covariance_m2), error)
    assert 0.90 < np.mean(squared < 7.815) < 0.985  # chi-square with 3 degrees of freedom
