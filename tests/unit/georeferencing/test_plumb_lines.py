"""Plumb lines in drawn photographs, and the correction of a leaning block by them."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from facadelake.core.arrays import Float64Array
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.model.lean import correct_lean, estimate_lean
from facadelake.georeferencing.model.plumb_lines import BUILT_SIGMA_RAD, VerticalDirection, estimate_vertical

CAMERA = Camera(width_px=1200, height_px=900, fx_px=1000, fy_px=1000, cx_px=610, cy_px=440, k1=-0.05)
LOOKING_NORTH = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # site_from_cam: x east, y down, z north


@dataclass(frozen=True, kw_only=True)
class DrawnPhotographs:
    """Grey photographs in memory."""

    images: list[NDArray[np.uint8] | None]

    def read_grey(self, row: int, reduction: int, /) -> NDArray[np.uint8]:
        image = self.images[row]
        if image is None:
            raise InputDataError("photograph cannot be decoded")
        return image[::reduction, ::reduction]


def build_cameras(count: int) -> list[PosedCamera]:
    """Cameras along a wall that lies ten metres north, with pitch up and down, roll and yaw."""
    made = []
    for k in range(count):
        turn = Rotation.from_euler("xyz", [(-20, 0, 15, 30)[k % 4], (k % 5 - 2) * 8, (k % 3 - 1) * 6], degrees=True)
        centre = np.array([3.0 * k, 0.0, 2.0 + k % 3])
        site_from_cam = Similarity(rotation=LOOKING_NORTH @ turn.as_matrix(), translation=centre)
        made.append(PosedCamera(camera=CAMERA, site_from_cam=site_from_cam))
    return made


def draw_photograph(
    posed: PosedCamera, up: Float64Array, rng: np.random.Generator, *, built_deg: float, uprights: int = 40
) -> Any:
    """What ``posed`` sees of pilasters along ``up`` (3,), each off by ``built_deg`` of its own, and of sills."""
    image = np.full((CAMERA.height_px, CAMERA.width_px), 120, dtype=np.uint8)
    for _ in range(uprights):
        foot = np.array([posed.centre_site_m[0] + rng.uniform(-8, 8), 10.0, rng.uniform(-4, 6)])
        along = up + np.radians([*rng.normal(0, built_deg, 2), 0.0])
        wide = np.array([rng.uniform(0.15, 0.4), 0.0, 0.0])
        ends = [foot, foot + wide, foot + wide + 2.5 * along, foot + 2.5 * along]
        outline = [
            a + (b - a) * t for a, b in zip(ends, [*ends[1:], ends[0]], strict=True) for t in np.linspace(0, 1, 9)
        ]
        xy = posed.project_site(np.array(outline))
        if np.isfinite(xy).all():
            # cv2 draws with 4 bits of a pixel; its pixels' centres are whole numbers.
            cv2.fillPoly(image, [np.round((xy - 0.5) * 16).astype(np.int32)], int(rng.integers(0, 256)), cv2.LINE_AA, 4)
    return image


def test_the_vertical_is_found_through_pitch_roll_and_distortion() -> None:
    rng = np.random.default_rng(3)
    up = np.array([np.radians(0.4), np.radians(-0.3), 1.0])
    views = build_cameras(8)
    found = estimate_vertical(
        views, DrawnPhotographs(images=[draw_photograph(view, up, rng, built_deg=0.2) for view in views])
    )
    assert found is not None
    off_deg = np.degrees(found.up_site[:2] / found.up_site[2]) - [0.4, -0.3]
    assert np.abs(off_deg).max() < 0.08  # deg: 0.2 deg each, some hundred lines
    assert np.linalg.norm(off_deg) > 0.0
    assert BUILT_SIGMA_RAD < found.sigma_rad < 2 * BUILT_SIGMA_RAD
    assert 6 <= found.photographs <= 8
    assert 150 < found.lines < 2000


def test_photographs_without_upright_lines_or_that_cannot_be_read_are_passed_over() -> None:
    rng = np.random.default_rng(4)
    up = np.array([0.0, 0.0, 1.0])
    views = build_cameras(6)
    images = [draw_photograph(view, up, rng, built_deg=0.1) for view in views]
    images[1], images[2] = None, np.full_like(images[0], 90)
    found = estimate_vertical(views, DrawnPhotographs(images=images))
    assert found is not None
    assert found.photographs == 4
    images[3] = None
    assert estimate_vertical(views, DrawnPhotographs(images=images)) is None  # three photographs are too few


def _build_wall_block(lean_rad: Float64Array) -> tuple[AdjustedBlock, Float64Array]:
    """A block of a plumb wall that was turned by ``-lean_rad`` about the wall's centre, and where its cameras were."""
    rng = np.random.default_rng(1)
    wall = np.column_stack([rng.uniform(-10, 10, 4000), np.zeros(4000), rng.uniform(0, 12, 4000)])
    centre = np.column_stack([np.linspace(-8, 8, 5), np.full(5, -15.0), np.full(5, 2.0)])
    turn = Rotation.from_rotvec([*-lean_rad, 0.0]).as_matrix()
    pivot = np.median(wall, axis=0)
    state = SimpleNamespace(
        xyz_site_m=wall,
        centre_site_m=(centre - pivot) @ turn.T + pivot,
        site_from_cam=np.tile(turn @ LOOKING_NORTH, (5, 1, 1)),
    )
    walls = SimpleNamespace(point=np.arange(len(wall)))
    return cast(
        AdjustedBlock,
        SimpleNamespace(solution=SimpleNamespace(state=state), problem=SimpleNamespace(point_to_plane=walls)),
    ), centre


@pytest.mark.parametrize("lean_deg", [(0.4, 0.0), (0.0, -0.3), (0.25, 0.25)])
def test_a_block_that_leans_with_its_walls_is_set_upright_as_far_as_the_lines_know_better(
    lean_deg: tuple[float, float],
) -> None:
    lean_rad = np.radians(lean_deg)
    adjusted, true = _build_wall_block(lean_rad)
    # In the leaning block's frame the vertical is the site's, turned back.
    up = Rotation.from_rotvec([*-lean_rad, 0.0]).as_matrix() @ np.array([0.0, 0.0, 1.0])
    sure = estimate_lean(adjusted, 0.10, VerticalDirection(up_site=up, sigma_rad=1e-6, lines=900, photographs=9))
    np.testing.assert_allclose(sure.rotation_rad, lean_rad, rtol=0, atol=1e-5)  # rad
    state = adjusted.solution.state
    np.testing.assert_allclose(
        (state.centre_site_m - sure.pivot_site_m) @ sure.rotation.T + sure.pivot_site_m, true, rtol=0, atol=5e-4
    )  # m
    np.testing.assert_allclose(sure.rotation @ state.site_from_cam[0], LOOKING_NORTH, rtol=0, atol=2e-5)
    unsure = estimate_lean(
        adjusted, 0.03, VerticalDirection(up_site=up, sigma_rad=0.03 / 5.76, lines=900, photographs=9)
    )
    np.testing.assert_allclose(unsure.rotation_rad, lean_rad / 2, rtol=0, atol=2e-5)  # rad: equal weights
    assert unsure.sigma_rad == pytest.approx(0.03 / 5.76 / np.sqrt(2), rel=0.02)


def test_nothing_within_the_block_changes() -> None:
    adjusted, _ = _build_wall_block(np.radians([0.4, 0.1]))
    lean = estimate_lean(
        adjusted, 0.03, VerticalDirection(up_site=np.array([0.003, 0.004, 1.0]), sigma_rad=1e-3, lines=9, photographs=9)
    )

    @dataclass(frozen=True)
    class Frozen:
        """The fields that ``correct_lean`` replaces."""

        xyz_site_m: Float64Array
        centre_site_m: Float64Array
        site_from_cam: Float64Array

    @dataclass(frozen=True)
    class Held:
        state: Frozen

    @dataclass(frozen=True)
    class Block:
        solution: Held

    before = Frozen(**vars(adjusted.solution.state))
    after = correct_lean(cast(AdjustedBlock, Block(solution=Held(state=before))), lean).solution.state
    for old, new in zip(before.site_from_cam, after.site_from_cam, strict=True):
        seen = [
            (points - state.centre_site_m[0]) @ rotation
            for points, state, rotation in ((before.xyz_site_m, before, old), (after.xyz_site_m, after, new))
        ]
        np.testing.assert_allclose(seen[0], seen[1], rtol=0, atol=1e-9)  # m, in the camera's axes
    assert np.abs(after.centre_site_m - before.centre_site_m).max() > 0.01
