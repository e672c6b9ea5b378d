"""A later campaign in the reference of an earlier one: right to millimetres, or refused with the numbers."""

from dataclasses import replace

import numpy as np
import pytest

from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.campaign.matching import ReferenceMatch, match_reference
from facadelake.georeferencing.campaign.reference import ReferencePoints
from facadelake.georeferencing.campaign.reference_selection import build_reference
from facadelake.sfm.tie_point_covariance import compute_tie_point_covariance
from tests.unit.georeferencing.two_campaigns import (
    NOISE_PX,
    ORIGIN,
    Campaign,
    build_campaign,
    change_light,
    draw_descriptors,
    draw_facade_points,
    draw_similarity,
)

POINTS = 1000


def build_true_reference(of: Campaign) -> ReferencePoints:
    """The reference that truth's placement of a campaign leaves."""
    xyz = of.site_from_sfm.apply(of.reconstruction.xyz_sfm)
    return build_reference(
        of.reconstruction,
        of.descriptors,
        cameras=of.cameras,
        xyz_site_m=xyz,
        covariance_m2=compute_tie_point_covariance(of.reconstruction, of.cameras, xyz, sigma_px=NOISE_PX),
        frame_covariance_m2=np.eye(3) * 1e-4,
        building_id="house",
        campaign_id="2026-04",
        origin=ORIGIN,
    )


def match_campaign(later: Campaign, points: ReferencePoints) -> ReferenceMatch:
    """The later campaign in the reference."""
    return match_reference(later.reconstruction, later.descriptors, points, origin=ORIGIN)


@pytest.fixture(scope="module")
def earlier() -> Campaign:
    """The earlier campaign."""
    rng = np.random.default_rng(1)
    return build_campaign(draw_facade_points(POINTS, rng), draw_descriptors(POINTS, rng), draw_similarity(1), rng)


def build_later_campaign(earlier: Campaign, *, share: float, seed: int = 2) -> Campaign:
    """A later campaign that finds ``share`` of the earlier one's points again and as many others as are missing."""
    rng = np.random.default_rng(seed)
    same = rng.random(POINTS) < share
    xyz = np.where(same[:, None], earlier.xyz_true_m, draw_facade_points(POINTS, rng))
    seen = np.where(same[:, None], change_light(earlier.descriptors, rng), draw_descriptors(POINTS, rng))
    return build_campaign(xyz, seen, draw_similarity(seed), rng)


def compute_camera_error_m(later: Campaign, site_from_sfm: Similarity) -> np.ndarray:
    """Distance (n,) of the cameras to where truth has them."""
    centres = later.reconstruction.centres_sfm
    return np.linalg.norm(site_from_sfm.apply(centres) - later.site_from_sfm.apply(centres), axis=1)


@pytest.mark.parametrize("share", [0.9, 0.3])
def test_cameras_stand_where_they_stood_to_millimetres(earlier: Campaign, share: float) -> None:
    later = build_later_campaign(earlier, share=share)
    found = match_campaign(later, build_true_reference(earlier))
    assert 0.8 * share * POINTS < len(found.point) < 1.1 * share * POINTS  # the share is drawn
    off_m = compute_camera_error_m(later, found.site_from_sfm)
    assert 1e-5 < off_m.mean() < 0.004  # m; half a pixel is 3 mm at a point, and hundreds of points share it
    right = np.linalg.norm(later.xyz_true_m[found.point] - found.xyz_site_m, axis=1)
    assert (right < 0.03).mean() > 0.995  # m; the rows belong together
    assert found.runner_up < 0.05 * found.agreeing
    assert POINTS - 10 < found.points_compared <= POINTS


def test_the_covariances_hold_the_residuals(earlier: Campaign) -> None:
    """Other light moves every feature by half a pixel; the prior's covariance and the later point's contain it."""
    points, rng = build_true_reference(earlier), np.random.default_rng(6)
    moved = earlier.xyz_true_m + rng.normal(size=(POINTS, 3)) * 0.5 * np.median(points.gsd_m)
    later = build_campaign(moved, change_light(earlier.descriptors, rng), draw_similarity(6), rng)
    found = match_campaign(later, points)
    own = compute_tie_point_covariance(later.reconstruction, later.cameras, moved, sigma_px=NOISE_PX)[found.point]
    squared = np.einsum("ki,kij,kj->k", found.residual_m, np.linalg.inv(found.covariance_m2 + own), found.residual_m)
    assert 0.85 < np.median(squared) / 2.366 < 1.1  # chi-square of 3
    assert 0.93 < (squared < 7.815).mean() < 0.975


def test_a_part_that_moved_is_left_out(earlier: Campaign) -> None:
    later = build_later_campaign(earlier, share=1.0)
    moved = (later.xyz_true_m[:, 0] > 15) & (later.xyz_true_m[:, 2] < 3)  # a scaffold, set aside by 0.6 m
    rng = np.random.default_rng(3)
    xyz = later.xyz_true_m + np.where(moved[:, None], [0.0, -0.6, 0.0], 0.0)
    later = build_campaign(xyz, later.descriptors, later.site_from_sfm, rng)
    found = match_campaign(later, build_true_reference(earlier))
    assert moved.sum() > 100
    assert not moved[found.point].any()
    assert compute_camera_error_m(later, found.site_from_sfm).mean() < 0.004  # m
    assert found.runner_up > 0.5 * moved.sum()  # the scaffold agrees with itself, and is too small to compete


def test_another_origin_of_the_site_moves_the_answer_with_it(earlier: Campaign) -> None:
    later, points = build_later_campaign(earlier, share=0.6), build_true_reference(earlier)
    other = SiteOrigin(lon_deg=9.1003, lat_deg=48.7398, height_ellipsoidal_m=481.0)
    here = match_campaign(later, points)
    there = match_reference(later.reconstruction, later.descriptors, points, origin=other)
    centres = later.reconstruction.centres_sfm
    for k, unit in enumerate((3e-8, 3e-8, 2e-3)):  # deg, deg, m: 2 mm
        np.testing.assert_allclose(
            other.geo_from_site(there.site_from_sfm.apply(centres))[:, k],
            ORIGIN.geo_from_site(here.site_from_sfm.apply(centres))[:, k],
            rtol=0,
            atol=unit,
        )


def test_another_building_is_refused(earlier: Campaign) -> None:
    with pytest.raises(GeoreferenceError, match=r"agree on one placement.*is it the same building\?"):
        match_campaign(build_later_campaign(earlier, share=0.0), build_true_reference(earlier))


def test_few_points_or_points_in_one_corner_are_refused(earlier: Campaign) -> None:
    points = build_true_reference(earlier)
    with pytest.raises(GeoreferenceError, match="does not match the reference"):
        match_campaign(build_later_campaign(earlier, share=0.012), points)
    corner = np.linalg.norm(earlier.xyz_true_m - [6.0, 0.0, 3.0], axis=1) < 1.2
    assert corner.sum() > 5
    later = build_later_campaign(earlier, share=1.0)
    only = np.where(corner[:, None], later.descriptors, draw_descriptors(POINTS, np.random.default_rng(8)))
    with pytest.raises(GeoreferenceError, match="at least 30 in 8 are needed"):
        match_campaign(replace(later, descriptors=only), points)


@pytest.mark.parametrize(("share_of_second", "refused"), [(0.5, True), (0.15, False)])
def test_a_facade_that_repeats_is_refused_where_two_answers_compete(
    earlier: Campaign, share_of_second: float, refused: bool
) -> None:
    """Some surfaces of the later campaign look like those one window (3.2 m) to the side in the reference."""
    rng = np.random.default_rng(11)
    points = build_true_reference(earlier)
    second = rng.random(len(points)) < share_of_second
    shifted = replace(points, xyz_site_m=points.xyz_site_m + np.where(second[:, None], [3.2, 0.0, 0.0], 0.0))
    later = build_later_campaign(earlier, share=0.9)
    if refused:
        with pytest.raises(GeoreferenceError, match=r"two placements .* compete: \d+ points agree on the best, \d+ on"):
            match_campaign(later, shifted)
    else:
        found = match_campaign(later, shifted)
        assert compute_camera_error_m(later, found.site_from_sfm).mean() < 0.004  # m
        assert 0.05 < found.runner_up / found.agreeing < 0.4
