"""The model's edges as control, on rendered facades whose truth is known.

The photographs are drawn from the surface pixel by pixel (a ray for each quarter of a pixel), by no code of the
search: brightness by element and by the side a face looks to, texture by place, noise by a seed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from facadelake.building.surface.edges import ModelEdges, extract_model_edges
from facadelake.building.surface.raycasting import Surface
from facadelake.core.arrays import Float64Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import GeoreferenceError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.model.edge_samples import find_visible_samples, sample_edges
from facadelake.georeferencing.model.edge_search import search_shift

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])
_FACES = np.array(
    [
        *([0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4]),
        *([1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]),
    ]
)
_CAMERA = Camera(width_px=320, height_px=240, fx_px=260.0, fy_px=261.0, cx_px=163.0, cy_px=118.5, k1=-0.05, k2=0.01)
_UP = np.array([[0.0, 0.0, 1.0]])

Box = tuple[float, float, float, float, float, float]  # lowest corner, size


def _build_mesh(boxes: Sequence[Box]) -> tuple[Float64Array, NDArray[np.int64], NDArray[np.int64]]:
    vertices = np.vstack([np.array(box[:3]) + _CORNERS * np.array(box[3:]) for box in boxes])
    triangles = np.vstack([_FACES + 8 * k for k in range(len(boxes))])
    return vertices, triangles, np.repeat(np.arange(len(boxes)), len(_FACES))


def _build_camera(x: float, y: float, z: float, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> PosedCamera:
    """A camera that looks along +y (north), turned to the right by ``yaw_deg`` and up by ``pitch_deg``."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    forward = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    return PosedCamera(
        camera=_CAMERA, site_from_cam=Similarity(rotation=rotation, translation=np.array([x, y, z], dtype=np.float64))
    )


def _shift_cameras(cameras: Sequence[PosedCamera], shift: Sequence[float]) -> list[PosedCamera]:
    return [
        PosedCamera(
            camera=c.camera,
            site_from_cam=Similarity(
                rotation=c.site_from_cam.rotation, translation=c.site_from_cam.translation + np.array(shift)
            ),
        )
        for c in cameras
    ]


@dataclass(frozen=True, kw_only=True)
class _DrawnPhotographs:
    """Photographs in memory."""

    images: Sequence[NDArray[np.uint8]]

    def read_grey(self, row: int, reduction: int, /) -> NDArray[np.uint8]:
        image = self.images[row]
        height, width = (size // reduction for size in image.shape)
        cut = image[: height * reduction, : width * reduction].reshape(height, reduction, width, reduction)
        return cut.mean(axis=(1, 3)).round().astype(np.uint8)


def _draw(cameras: Sequence[PosedCamera], surface: Surface, seed: int = 3) -> _DrawnPhotographs:
    rng = np.random.default_rng(seed)
    images = []
    for posed in cameras:
        camera = posed.camera
        u, v = np.meshgrid((np.arange(2 * camera.width_px) + 0.5) / 2, (np.arange(2 * camera.height_px) + 0.5) / 2)
        hits = surface.cast(*posed.rays_site_from_img(np.column_stack([u.ravel(), v.ravel()])))
        side = np.nan_to_num(hits.normal_site) @ np.array([35.0, -20.0, 60.0])
        place = np.nan_to_num(hits.xyz_site_m)
        texture = 6.0 * np.sin(7.3 * place[:, 0] + 3.1 * place[:, 2]) * np.sin(5.7 * place[:, 2] - 2.2 * place[:, 0])
        paint = np.where(hits.element > 0, 40.0, 0.0)  # frames, eaves and doors are not of the wall's colour
        grey = np.where(hits.hit, 90.0 + side + texture + paint, 235.0).reshape(camera.height_px, 2, camera.width_px, 2)
        noisy = grey.mean(axis=(1, 3)) + rng.normal(0, 3.0, (camera.height_px, camera.width_px))
        images.append(noisy.clip(0, 255).round().astype(np.uint8))
    return _DrawnPhotographs(images=images)


@dataclass(frozen=True, kw_only=True)
class _Scene:
    surface: Surface
    edges: ModelEdges
    cameras: Sequence[PosedCamera]
    photographs: _DrawnPhotographs


def _build_scene(boxes: Sequence[Box], cameras: Sequence[PosedCamera], as_built: Sequence[Box] | None = None) -> _Scene:
    surface = Surface.from_mesh(*_build_mesh(boxes))
    real = surface if as_built is None else Surface.from_mesh(*_build_mesh(as_built))
    return _Scene(
        surface=surface,
        edges=extract_model_edges(*_build_mesh(boxes)),
        cameras=cameras,
        photographs=_draw(cameras, real),
    )


def _build_windows(columns: Sequence[float], levels: Sequence[float]) -> list[Box]:
    """Frames that stand 0.15 m before a wall at y = 0."""
    return [(x, -0.15, z, 1.2, 0.15, 1.5) for x in columns for z in levels]


def _build_house() -> list[Box]:
    """A house 14 m wide and 10 m high: three storeys of different height, a door, eaves."""
    wall: Box = (0.0, 0.0, 0.0, 14.0, 8.0, 10.0)
    eaves: Box = (-0.4, -0.4, 10.0, 14.8, 8.8, 0.3)
    door: Box = (6.2, -0.15, 0.0, 1.4, 0.15, 2.3)
    return [
        wall,
        eaves,
        door,
        *_build_windows((1.5, 4.0, 9.5, 11.8), (1.0, 4.4)),
        *_build_windows((2.2, 6.3, 10.5), (7.6,)),
    ]


def _build_flight() -> list[PosedCamera]:
    return [
        _build_camera(x, -12.0 - 0.3 * k, z, yaw_deg=yaw, pitch_deg=pitch)
        for k, (x, z, yaw, pitch) in enumerate(
            [(2, 4, 8, 4), (7, 5, 0, 0), (12, 4, -8, 4), (4, 8, 10, -6), (10, 8, -12, -6)]
        )
    ]


@pytest.fixture(scope="module")
def house() -> _Scene:
    return _build_scene(_build_house(), _build_flight())


def test_hidden_edges_and_seams_in_one_plane_are_not_seen() -> None:
    """Two abutting boxes with one front, and a third behind them: of twelve and twelve edges the front shows few."""
    boxes: list[Box] = [(0, 0, 0, 2, 1, 3), (2, 0, 0, 2, 1, 3), (1, 5, 1, 1, 1, 1)]
    surface, edges = Surface.from_mesh(*_build_mesh(boxes)), extract_model_edges(*_build_mesh(boxes))
    samples = sample_edges(edges, 0.05)
    seen = find_visible_samples(samples, _build_camera(2.0, -8.0, 1.5), surface, border_px=2.0)
    xyz = samples.xyz_site_m[seen.row]
    np.testing.assert_allclose(xyz[:, 1], 0.0, rtol=0, atol=1e-9)  # m: the front alone
    outline = np.minimum.reduce([xyz[:, 0], 4.0 - xyz[:, 0], xyz[:, 2], 3.0 - xyz[:, 2]])
    np.testing.assert_allclose(outline, 0.0, rtol=0, atol=1e-9)  # m: its outline, not the seam at x = 2
    assert len(xyz) == pytest.approx(2 * (4.0 + 3.0) / 0.05, abs=4)


def test_normals_in_the_photograph_are_square_to_the_edge_as_projected(house: _Scene) -> None:
    samples = sample_edges(house.edges, 0.2)
    posed = house.cameras[3]
    seen = find_visible_samples(samples, posed, house.surface, border_px=2.0)
    ahead = posed.project_site(samples.xyz_site_m[seen.row] + 0.02 * samples.direction[seen.row])
    back = posed.project_site(samples.xyz_site_m[seen.row] - 0.02 * samples.direction[seen.row])
    along = (ahead - back) / np.linalg.norm(ahead - back, axis=1, keepdims=True)
    np.testing.assert_allclose(np.einsum("ij,ij->i", along, seen.normal_img), 0.0, rtol=0, atol=2e-3)  # cosine
    np.testing.assert_allclose(np.linalg.norm(seen.normal_img, axis=1), 1.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("start_m", [-1.7, 0.0, 1.4])
def test_the_height_is_found_from_any_start_within_gps(house: _Scene, start_m: float) -> None:
    cameras = _shift_cameras(house.cameras, (0.0, 0.0, start_m))
    found = search_shift(cameras, house.photographs, house.edges, house.surface, _UP, np.array([0.8]))
    np.testing.assert_allclose(found.shift_site_m, [0, 0, -start_m], rtol=0, atol=0.03)  # m; a pixel is 0.05 m
    assert found.gap_sigmas > 2.0
    assert 0.0 < found.sigma_m < 0.05
    assert found.score > found.edge_score_runner_up


def test_the_shift_along_a_facade_is_found_with_the_height(house: _Scene) -> None:
    cameras = _shift_cameras(house.cameras, (0.5, 0.0, -0.6))
    free = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = search_shift(cameras, house.photographs, house.edges, house.surface, free, np.array([0.3, 0.3]))
    np.testing.assert_allclose(found.shift_site_m, [-0.5, 0.0, 0.6], rtol=0, atol=0.04)  # m


def test_storeys_that_repeat_beyond_every_photograph_are_refused() -> None:
    """Only the central part of a tall facade is visible: a storey more or less fits as well."""
    tall: list[Box] = [
        (-30.0, 0.0, -30.0, 60.0, 1.0, 60.0),
        *_build_windows(np.arange(-12.5, 13, 2.5), np.arange(-15, 16, 3.0)),
    ]
    cameras = [_build_camera(x, -9.0, z, yaw_deg=-x) for x, z in [(-3, 0.0), (0, 0.4), (3, 0.0), (1, 1.4)]]
    scene = _build_scene(tall, cameras)
    with pytest.raises(GeoreferenceError, match=r"fit its edges equally well.*standard errors \(limit") as refused:
        search_shift(
            _shift_cameras(cameras, (0, 0, 0.9)), scene.photographs, scene.edges, scene.surface, _UP, np.array([1.6])
        )
    assert "control point" in str(refused.value)


def test_photographs_of_something_else_are_refused(house: _Scene) -> None:
    rng = np.random.default_rng(5)
    noise = _DrawnPhotographs(images=[rng.integers(60, 190, (240, 320), dtype=np.uint8) for _ in house.cameras])
    with pytest.raises(GeoreferenceError):
        search_shift(house.cameras, noise, house.edges, house.surface, _UP, np.array([0.8]))


def test_a_model_without_edges_in_sight_is_refused(house: _Scene) -> None:
    away = [_build_camera(7.0, -12.0, 4.0, yaw_deg=180.0)]
    with pytest.raises(
        GeoreferenceError, match=r"0 edges of the building model are visible in 1 photographs, 6 are needed"
    ):
        search_shift(away, house.photographs, house.edges, house.surface, _UP, np.array([0.5]))
