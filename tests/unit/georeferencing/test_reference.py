"""The reference: its selection of points, its accuracy, and that its file is read complete or not at all."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.campaign.reference import (
    ReferencePoints,
    drop_reference,
    list_references,
    read_reference,
    store_reference,
)
from facadelake.georeferencing.campaign.reference_selection import build_reference, choose_spread_points
from facadelake.georeferencing.triangulation import ImageRay, intersect_rays
from facadelake.sfm.tie_point_covariance import (
    compute_tie_point_covariance,
    describe_tie_point_views,
    estimate_pixel_sigma,
)
from tests.unit.georeferencing.two_campaigns import (
    CAMERA,
    NOISE_PX,
    ORIGIN,
    Campaign,
    build_campaign,
    draw_descriptors,
    draw_facade_points,
    draw_similarity,
)


@pytest.fixture(scope="module")
def placed() -> Campaign:
    """A campaign of 400 tie points."""
    rng = np.random.default_rng(5)
    return build_campaign(draw_facade_points(400, rng), draw_descriptors(400, rng), draw_similarity(5), rng)


def build_own_reference(of: Campaign, *, most: int = 1000, spoil: slice | None = None) -> ReferencePoints:
    """Its reference; ``spoil`` are points that the adjustment dropped."""
    xyz = of.site_from_sfm.apply(of.reconstruction.xyz_sfm)
    covariance = compute_tie_point_covariance(of.reconstruction, of.cameras, xyz, sigma_px=NOISE_PX)
    if spoil is not None:
        xyz[spoil] = np.nan
    return build_reference(
        of.reconstruction,
        of.descriptors,
        cameras=of.cameras,
        xyz_site_m=xyz,
        covariance_m2=covariance,
        frame_covariance_m2=np.diag([0.01, 0.02, 0.03]) ** 2,
        building_id="house",
        campaign_id="2026-04",
        origin=ORIGIN,
        max_points=most,
    )


def test_it_keeps_what_the_adjustment_kept_in_its_rows(placed: Campaign) -> None:
    points = build_own_reference(placed, spoil=slice(0, 50))
    xyz = placed.site_from_sfm.apply(placed.reconstruction.xyz_sfm)
    assert 300 < len(points) <= 350
    for k in (0, 17, len(points) - 1):
        row = int(np.flatnonzero((xyz == points.xyz_site_m[k]).all(axis=1))[0])
        assert row >= 50
        np.testing.assert_array_equal(points.descriptors[k], placed.descriptors[row])
        tracks = placed.reconstruction.image_point_photo[placed.reconstruction.image_point_tie_point == row]
        assert points.photographs[k] == len(set(tracks.tolist()))
        centres = np.array([placed.cameras[i].centre_site_m for i in tracks])
        distance_m = np.linalg.norm(centres - xyz[row], axis=1)
        assert points.gsd_m[k] == pytest.approx(distance_m.min() / CAMERA.fx_px, rel=1e-9)
        looked = (xyz[row] - centres).sum(axis=0)
        assert points.direction_site[k] @ looked / np.linalg.norm(looked) > 0.99


def test_a_smaller_reference_is_spread_over_the_building(placed: Campaign) -> None:
    few = build_own_reference(placed, most=60)
    assert len(few) == 60
    cells = {tuple(cell) for cell in np.floor(few.xyz_site_m / 0.5).astype(int).tolist()}
    assert len(cells) == 60  # no half-metre cell gives its second point before every cell gave its first


def test_of_a_cell_the_worthiest_point_is_chosen() -> None:
    xyz = np.array([[0.1, 0.1, 0.1], [0.2, 0.1, 0.1], [0.3, 0.1, 0.1], [5.0, 5.0, 5.0]])
    assert choose_spread_points(xyz, np.array([1.0, 3.0, 2.0, 0.1]), max_points=2).tolist() == [1, 3]
    assert choose_spread_points(xyz, np.array([1.0, 3.0, 2.0, 0.1]), max_points=3).tolist() == [1, 2, 3]


def test_a_campaign_of_loose_points_cannot_be_a_reference(placed: Campaign) -> None:
    with pytest.raises(GeoreferenceError, match=r"none of the 400 tie points is known to 0\.10 m"):
        build_own_reference(placed, spoil=slice(0, 400))


def test_descriptors_of_another_reconstruction_are_refused(placed: Campaign) -> None:
    with pytest.raises(InputDataError, match=r"\(399, 128\) for 400 tie points"):
        build_own_reference(replace(placed, descriptors=placed.descriptors[:-1]))


def test_the_covariance_is_that_of_repeated_marks(placed: Campaign) -> None:
    """Independent path: mark one point 80 times with noise, intersect, and look at the scatter."""
    row = int(np.flatnonzero(np.bincount(placed.reconstruction.image_point_tie_point) == 3)[0])
    rng, found = np.random.default_rng(9), []
    photos = placed.reconstruction.image_point_photo[placed.reconstruction.image_point_tie_point == row]
    poses = [placed.cameras[i].site_from_cam for i in photos]
    for _ in range(80):
        views = [
            ImageRay(
                camera=CAMERA,
                world_from_cam=pose,
                xy_img=CAMERA.project(pose.invert().apply(placed.xyz_true_m[row][None]))[0]
                + rng.normal(0, NOISE_PX, 2),
            )
            for pose in poses
        ]
        point = intersect_rays(views)
        assert point is not None
        found.append(point.xyz_world)
    scatter = np.linalg.eigvalsh(np.cov(np.array(found).T))
    stated = compute_tie_point_covariance(placed.reconstruction, placed.cameras, placed.xyz_true_m, sigma_px=NOISE_PX)[
        row
    ]
    assert (np.sqrt(np.linalg.eigvalsh(stated) / scatter) > 0.75).all()  # of a sigma; 80 draws determine it to 8 %
    assert (np.sqrt(np.linalg.eigvalsh(stated) / scatter) < 1.3).all()
    assert estimate_pixel_sigma(placed.reconstruction) == pytest.approx(NOISE_PX, abs=1e-6)  # px


def test_a_point_in_one_photograph_has_no_covariance(placed: Campaign) -> None:
    one = replace(placed.reconstruction, image_point_photo=np.zeros(1, int), image_point_tie_point=np.zeros(1, int))
    stated = compute_tie_point_covariance(one, placed.cameras, placed.xyz_true_m, sigma_px=NOISE_PX)
    assert np.isnan(stated).all()  # one photograph leaves the distance open, none leaves everything open
    assert describe_tie_point_views(one, placed.cameras, placed.xyz_true_m).photographs.sum() == 1


def test_the_file_comes_back_the_same_and_has_one_hash(placed: Campaign, tmp_path: Path) -> None:
    points = build_own_reference(placed)
    digest = points.save(tmp_path / "a.npz")
    assert points.save(tmp_path / "b.npz") == digest
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = read_reference(tmp_path / "a.npz")
    assert (back.building_id, back.campaign_id, back.origin) == ("house", "2026-04", ORIGIN)
    for name in ("xyz_site_m", "covariance_m2", "descriptors", "direction_site", "gsd_m", "photographs"):
        np.testing.assert_array_equal(getattr(back, name), getattr(points, name))
    np.testing.assert_array_equal(back.frame_covariance_m2, points.frame_covariance_m2)
    assert back.descriptors.dtype == np.uint8
    moved = replace(points, xyz_site_m=points.xyz_site_m + np.array([0.001, 0, 0]))
    assert moved.save(tmp_path / "c.npz") != digest


@pytest.mark.parametrize("harm", ["missing", "short", "changed", "other"])
def test_a_file_that_is_not_whole_is_refused(placed: Campaign, tmp_path: Path, harm: str) -> None:
    path = tmp_path / "reference.npz"
    build_own_reference(placed).save(path)
    if harm == "missing":
        path.unlink()
    elif harm == "short":
        path.write_bytes(path.read_bytes()[:5000])
    elif harm == "changed":
        with np.load(path) as loaded:
            arrays = dict(loaded)
        arrays["xyz_site_m"][3, 2] += 0.5
        np.savez(path, **arrays)
    else:
        path.write_text("no reference")
    with pytest.raises(InputDataError, match="georeference the earlier campaign again"):
        read_reference(path)


def test_about_another_origin_it_is_the_same_place_on_the_globe(placed: Campaign) -> None:
    """Independent path: by longitude, latitude and height, point by point."""
    points = build_own_reference(placed)
    other = SiteOrigin(lon_deg=9.101, lat_deg=48.7405, height_ellipsoidal_m=470.0)
    there = points.transform_to(other)
    np.testing.assert_allclose(
        there.xyz_site_m, other.site_from_geo(ORIGIN.geo_from_site(points.xyz_site_m)), rtol=0, atol=1e-6
    )  # m
    assert np.linalg.norm(there.xyz_site_m - points.xyz_site_m, axis=1).min() > 50  # m
    axes = other.ecef_from_site().rotation.T @ ORIGIN.ecef_from_site().rotation
    np.testing.assert_allclose(there.covariance_m2[7], axes @ points.covariance_m2[7] @ axes.T, rtol=0, atol=1e-12)
    assert points.transform_to(ORIGIN) is points


def test_a_campaign_committed_again_without_a_reference_loses_the_old_one(tmp_path: Path) -> None:
    written = tmp_path / "written.npz"
    for campaign in ("2025-04", "2026-04"):
        written.write_bytes(campaign.encode())
        store_reference(written, tmp_path, "town-hall", campaign)
    both = ["2026-04", "2027-04", "2025-04"]
    assert [path.stem for path in list_references(tmp_path, "town-hall", both)] == ["2026-04", "2025-04"]
    drop_reference(tmp_path, "town-hall", "2026-04")
    drop_reference(tmp_path, "town-hall", "2026-04")  # no file: no error
    left = list_references(tmp_path, "town-hall", both)
    assert [(path.stem, path.read_bytes()) for path in left] == [("2025-04", b"2025-04")]
