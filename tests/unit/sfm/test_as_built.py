"""The as-built model of a campaign: a corner of two walls photographed by adjusted cameras."""

from dataclasses import replace

import numpy as np
import pytest

from facadelake.building.mesh.load import MeshModelSettings, place_building_without_model
from facadelake.building.surface.raycasting import Surface
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.core.geodesy import SiteOrigin
from facadelake.sfm.as_built_model import build_as_built_model, estimate_roughness, triangulate_in_site
from facadelake.sfm.reconstruction import LocalisedPhoto, Reconstruction
from schemas.vocabulary import SurfaceKind

CAMERA = Camera(width_px=2000, height_px=1500, fx_px=1200, fy_px=1200, cx_px=1010, cy_px=740, k1=-0.02)
ORIGIN = SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0)
NOISE_PX = 0.5
# The free block stands in another frame, another scale, and bent: its points must not be used.
SFM_FROM_SITE = Similarity(
    rotation=np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), translation=np.array([3.0, -2, 7]), scale=0.3
)


def looking(eye, at) -> PosedCamera:
    z = np.asarray(at, dtype=float) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0, 1])
    x /= np.linalg.norm(x)
    return PosedCamera(
        camera=CAMERA,
        site_from_cam=Similarity(rotation=np.array([x, np.cross(z, x), z]).T, translation=np.asarray(eye, dtype=float)),
    )


def block(count: int = 1500) -> tuple[Reconstruction, dict[str, PosedCamera], np.ndarray]:
    """Walls facing south (y = 0, x from -10 to 0) and west (x = -10, y from 0 to 10), 6 m high."""
    rng = np.random.default_rng(4)
    uv = rng.uniform(0, 1, (count, 2)) * [10, 6]
    south = rng.random(count) < 0.5
    xyz = np.where(
        south[:, None],
        np.column_stack([uv[:, 0] - 10, np.zeros(count), uv[:, 1]]),
        np.column_stack([np.full(count, -10.0), uv[:, 0], uv[:, 1]]),
    )
    eyes = [(-12 - 3 * k, -3 - 2 * (6 - k), 2 + k % 3) for k in range(7)]
    posed = {f"{k}.jpg": looking(eye, (-8.5, 1.5, 3)) for k, eye in enumerate(eyes)}
    rows, columns, pixels = [], [], []
    for k, camera in enumerate(posed.values()):
        xy = camera.project_site(xyz)
        seen = CAMERA.is_inside(xy) & np.where(south, eyes[k][1] < 0, eyes[k][0] < -10)
        rows.append(np.full(seen.sum(), k))
        columns.append(np.flatnonzero(seen))
        pixels.append(xy[seen] + rng.normal(0, NOISE_PX, (seen.sum(), 2)))
    photos = tuple(
        LocalisedPhoto(
            photo_id=name,
            camera=replace(CAMERA, fx_px=1100.0),
            sfm_from_cam=Similarity(rotation=np.eye(3), translation=SFM_FROM_SITE.apply(camera.centre_site_m)),
            reprojection_error_px=0.6,
            tie_points=count,
        )
        for name, camera in posed.items()
    )
    reconstruction = Reconstruction(
        photos=photos,
        unlocalised=(),
        xyz_sfm=SFM_FROM_SITE.apply(xyz) + rng.normal(0, 0.05, xyz.shape),
        rgb=np.zeros((count, 3), np.uint8),
        image_point_photo=np.concatenate(rows),
        image_point_tie_point=np.concatenate(columns),
        image_point_xy_img=np.vstack(pixels),
        mean_reprojection_error_px=0.6,
        costs=(),
    )
    return reconstruction, posed, xyz


@pytest.fixture(scope="module")
def corner() -> tuple[Reconstruction, dict[str, PosedCamera], np.ndarray]:
    return block()


def test_tie_points_come_from_the_adjusted_cameras_and_not_from_the_free_block(corner) -> None:
    reconstruction, posed, xyz = corner
    found = triangulate_in_site(reconstruction, posed)
    used = np.unique(found.image_point_tie_point)
    error = np.linalg.norm(found.xyz_sfm[used] - xyz[used], axis=1)
    # Half a pixel at 10 to 30 m and 1,200 px of focal length is 4 to 12 mm a ray.
    assert 0.001 < np.median(error) < 0.02  # m
    np.testing.assert_array_equal(found.photos[0].sfm_from_cam.translation, posed["0.jpg"].centre_site_m)


def test_a_photograph_without_pose_is_left_out(corner) -> None:
    reconstruction, posed, xyz = corner
    fewer = {name: camera for name, camera in posed.items() if name != "3.jpg"}
    found = triangulate_in_site(reconstruction, fewer)
    assert [photo.photo_id for photo in found.photos] == list(fewer)
    k = list(fewer).index("4.jpg")
    rows = found.image_point_photo == k
    again = fewer["4.jpg"].project_site(xyz[found.image_point_tie_point[rows]])
    assert (
        np.abs(again - found.image_point_xy_img[rows]).max() < 6 * NOISE_PX
    )  # px: image points kept their photographs


def test_a_point_in_only_one_posed_photograph_is_left_out(corner) -> None:
    """As where the other photographs were not localised: one ray does not determine the distance."""
    reconstruction, posed, _ = corner
    lonely = int(reconstruction.image_point_tie_point[reconstruction.image_point_photo == 0][0])
    rows = (reconstruction.image_point_tie_point != lonely) | (reconstruction.image_point_photo == 0)
    lost = replace(
        reconstruction,
        image_point_photo=reconstruction.image_point_photo[rows],
        image_point_tie_point=reconstruction.image_point_tie_point[rows],
        image_point_xy_img=reconstruction.image_point_xy_img[rows],
    )
    found = triangulate_in_site(lost, posed)
    kept = np.isin(found.image_point_tie_point, lonely)
    assert not kept.any() and len(found.image_point_tie_point) == len(
        triangulate_in_site(reconstruction, posed).image_point_tie_point
    ) - ((reconstruction.image_point_tie_point == lonely).sum())


def test_the_surface_is_the_building_cut_into_facades(corner) -> None:
    reconstruction, posed, _ = corner
    place = place_building_without_model(
        np.full((1, 2), np.nan),
        settings=MeshModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", origin=ORIGIN),
    )
    building = build_as_built_model(place, reconstruction, posed)
    assert building.surface_kind is SurfaceKind.AS_BUILT and building.has_surface
    area = {row["element_guid"]: row["surface_area_m2"] for row in building.elements.to_pylist()}
    assert area["facade-S-1"] > 40 and area["facade-W-1"] > 40  # m2, of 60 each
    assert sum(area.values()) - area["facade-S-1"] - area["facade-W-1"] < 15  # m2: corner and rims
    eyes = np.column_stack([np.linspace(-9, -1, 9), np.full(9, -8.0), np.linspace(1, 5, 9)])
    hits = Surface(building).cast(eyes, np.tile([0.0, 1, 0], (9, 1)))
    assert hits.hit.all()
    assert 0.0005 < np.abs(hits.xyz_site_m[:, 1]).mean() < 0.03  # m off the wall
    assert building.surface_sigma_m is not None and 0.005 <= building.surface_sigma_m < 0.03  # m


def test_roughness_is_the_noise_across_the_surface() -> None:
    rng = np.random.default_rng(1)
    flat = np.column_stack([rng.uniform(0, 20, (4000, 2)), rng.normal(0, 0.02, 4000)])
    # Of a point against the plane of eight others: a little more than the noise.
    assert 0.018 < estimate_roughness(flat) < 0.028  # m


def test_too_few_tie_points_are_an_error(corner) -> None:
    reconstruction, posed, _ = corner
    place = place_building_without_model(
        np.full((1, 2), np.nan),
        settings=MeshModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", origin=ORIGIN),
    )
    few = reconstruction.image_point_tie_point < 30
    sparse = replace(
        reconstruction,
        image_point_photo=reconstruction.image_point_photo[few],
        image_point_tie_point=reconstruction.image_point_tie_point[few],
        image_point_xy_img=reconstruction.image_point_xy_img[few],
    )
    with pytest.raises(InputDataError, match="tie points have three image points or more"):
        build_as_built_model(place, sparse, posed)
