"""What the comparison of detectors rests on: area of facade in a photograph, and the classical filter."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.classical_cracks import RidgeCrackFilter
from benchmarks.detector_sets import measure_visible_area
from facadelake.building.surface.raycasting import Surface
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from tests.unit.evaluation.detectors.labelled import image

SIDE_M = 6.0


def wall() -> Surface:
    """A square wall of 36 m2 in the plane y = 0."""
    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) * SIDE_M / 2
    return Surface.from_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def camera_at(x: float, y: float) -> PosedCamera:
    """A camera at eye level that looks at the wall's middle."""
    camera = Camera(width_px=1200, height_px=1000, fx_px=800.0, fy_px=810.0, cx_px=590.0, cy_px=510.0)
    forward = -np.array([x, y, 0.0]) / np.hypot(x, y)
    right = np.cross(forward, [0, 0, 1.0])
    rotation = Rotation.from_matrix(np.column_stack([right, [0, 0, -1.0], forward])).as_matrix()
    return PosedCamera(
        camera=camera, site_from_cam=Similarity(rotation=rotation, translation=np.array([x, y, 0.0]), scale=1.0)
    )


@pytest.mark.parametrize(("x", "y"), [(0.0, -10.0), (8.0, -10.0), (-12.0, -9.0)])
def test_the_whole_wall_has_its_area_from_everywhere(x: float, y: float) -> None:
    target, area, gsd = measure_visible_area(camera_at(x, y), wall(), np.array([True, False]))
    assert area == pytest.approx(SIDE_M**2, rel=0.01)
    assert gsd == pytest.approx(1000 * np.hypot(x, y) / 800, rel=0.06)
    assert target.shape == (400, 480) and 0.05 < target.mean() < 0.5


def test_a_wall_seen_grazingly_has_no_area() -> None:
    _, area, _ = measure_visible_area(camera_at(12.0, -1.0), wall(), np.array([True, False]))
    assert area < 0.5


def test_the_classical_filter_finds_a_drawn_crack() -> None:
    random = np.random.default_rng(3)
    grey = cv2.GaussianBlur(random.normal(150, 12, (400, 400)).astype(np.float32), (0, 0), 1.2)
    ends = [(60, 80), (150, 130), (220, 240), (330, 300)]
    for start, end in pairwise(ends):
        cv2.line(grey, start, end, 60.0, 3, cv2.LINE_AA)
    pixels = cv2.cvtColor(np.clip(grey, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    found = RidgeCrackFilter().detect(image("drawn"), pixels).above_floor
    best = max(found, key=lambda one: one.score)
    assert [best.box.x_px, best.box.y_px] == pytest.approx([60, 80], abs=8)  # px
    assert [best.box.width_px, best.box.height_px] == pytest.approx([270, 220], abs=12)
