"""Observations compared by appearance: the same place in other light, a neighbour beside it, no texture."""

import cv2
import numpy as np
import pytest

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.deduplication.appearance import PhotographSource
from facadelake.deduplication.clustering import cluster_observations
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings
from tests.unit.registration.wall_scene import look_at

CAMERA = Camera(width_px=900, height_px=700, fx_px=1500, fy_px=1500, cx_px=450, cy_px=350, k1=-0.05)
TEXEL_M = 0.004


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A wall y = 0 with a random texture, 4 m square, in two photographs, the second darker and from aside."""
    rng = np.random.default_rng(5)
    fine = cv2.GaussianBlur(rng.normal(0, 1, (1000, 1000)).astype(np.float32), (0, 0), 3)
    wall = 128 + 40 * fine / fine.std()
    root = tmp_path_factory.mktemp("photographs")
    cameras = {name: posed(*eye) for name, eye in {"a": (0.0, -6, 2), "b": (2.0, -5, 1.6), "c": (-1, -6, 2)}.items()}
    for name, light in (("a", (1.0, 0.0)), ("b", (0.5, 30.0))):
        columns, rows = np.meshgrid(np.arange(900) + 0.5, np.arange(700) + 0.5)
        origin, ray = cameras[name].rays_site_from_img(np.column_stack([columns.ravel(), rows.ravel()]))
        hit = origin + ray * (-origin[:, 1] / ray[:, 1])[:, None]
        at = np.column_stack([(hit[:, 0] + 2) / TEXEL_M, (4 - hit[:, 2]) / TEXEL_M]) - 0.5
        shown = cv2.remap(wall, at.reshape(700, 900, 2).astype(np.float32), None, cv2.INTER_LINEAR)
        cv2.imwrite(
            str(root / f"{name}.png"), np.clip(light[0] * shown + light[1] + rng.normal(0, 2, shown.shape), 0, 255)
        )
    (root / "c.png").write_text("no picture")
    return root, {f"{name}.png": camera for name, camera in cameras.items()}


def posed(x, y, z):
    turned = look_at([x, y, z], [0.0, 0.0, 2.0])
    return PosedCamera(
        camera=CAMERA,
        site_from_cam=Similarity(rotation=turned.site_from_cam.rotation, translation=turned.centre_site_m),
    )


def make_observations(places, photo, cameras, size_m=0.15):
    """Boxes at ``places`` (n, 2: x, z) of the wall in the photographs of ``photo``."""
    xyz = np.array([[x, 0.0, z] for x, z in places])
    away = xyz - np.array([list(cameras.values())[number].centre_site_m for number in photo])
    distance = np.linalg.norm(away, axis=1)
    n = len(xyz)
    return ObservationArrays(
        xyz_site_m=xyz,
        normal_site=np.tile([0.0, -1, 0], (n, 1)),
        ray_site=away / distance[:, None],
        distance_m=distance,
        width_m=np.full(n, size_m),
        height_m=np.full(n, size_m),
        gsd_m=distance / 1500,
        photo=np.asarray(photo),
        defect_class=np.zeros(n, dtype=np.int64),
        box_img=np.full((n, 4), np.nan),
        pose_covariance_m2=np.zeros((n, 3, 3)),
    )


def compare_pair(folder, places, photo):
    root, cameras = folder
    observations = make_observations(places, photo, cameras)
    pictures = PhotographSource(root=root, posed=cameras)
    return pictures.compare_pairs(observations, list(cameras), np.array([0]), np.array([1]), np.array([0.06]))


def test_one_place_looks_the_same_obliquely_and_in_other_light(folder):
    found = compare_pair(folder, [(0.1, 2.1), (0.12, 2.09)], [0, 1])
    assert 0.8 < found.score[0] <= 1.0
    assert found.same[0]
    assert not found.differs[0]


def test_a_neighbour_20_cm_away_is_found_aside(folder):
    found = compare_pair(folder, [(0.1, 2.1), (0.3, 2.1)], [0, 1])
    assert found.score[0] < 0.5
    assert found.differs[0]
    assert not found.same[0]


def test_what_cannot_be_read_is_not_compared(folder):
    found = compare_pair(folder, [(0.1, 2.1), (0.1, 2.1)], [0, 2])
    assert np.isnan(found.score[0])
    assert not found.same[0]
    assert not found.differs[0]


def test_a_place_at_the_photographs_end_is_not_compared(folder):
    found = compare_pair(folder, [(1.75, 2.1), (1.75, 2.1)], [0, 1])
    assert np.isnan(found.score[0])


@pytest.mark.parametrize(
    ("registered_x", "shown_x", "by_position", "by_appearance"), [(0.27, 0.1, 1, 0), (0.22, 0.45, 0, 1)]
)
def test_appearance_joins_what_a_pose_error_separates_and_separates_what_it_joins(
    folder, registered_x, shown_x, by_position, by_appearance
):
    """The second photograph's pose is aside by as much as its box is registered beside what it shows."""
    root, cameras = folder
    aside = np.array([registered_x - shown_x, 0, 0])
    real = cameras["b.png"].site_from_cam
    stated = Similarity(rotation=real.rotation, translation=real.translation + aside)
    placed = {**cameras, "b.png": PosedCamera(camera=CAMERA, site_from_cam=stated)}
    observations = make_observations([(0.1, 2.1), (registered_x, 2.1)], [0, 1], placed, size_m=0.2)
    compare = PhotographSource(root=root, posed=placed).prepare_comparison(list(placed))
    assert cluster_observations(observations, MergeSettings()).group.tolist() == [0, by_position]
    compared = cluster_observations(observations, MergeSettings(), compare)
    assert compared.group.tolist() == [0, by_appearance]
    assert compared.differs.tolist() == [bool(by_appearance)]
