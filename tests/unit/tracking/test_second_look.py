"""A second look on painted walls of known truth: the same, gone, hidden, grown, in other light and a little shifted."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.tracking import PatchGrid, Place, compare_views, judge_comparison, rectify_patch
from schemas.vocabulary import DefectClass, LookVerdict

PLACE = Place(xyz_site_m=np.zeros(3), normal_site=np.array([0.0, -1.0, 0.0]), width_m=0.3, height_m=0.3)
GRID = PatchGrid.build(PLACE, 0.006)
Picture = NDArray[np.float32]


def paint_wall(seed: int, *, defect: str | None, scale: float = 1.0) -> Picture:
    """A rough wall of grey values, with a crack or a spall at its centre, ``scale`` times its size."""
    height, width = GRID.defect.shape
    rng = np.random.default_rng(seed)
    wall = 140 + 12 * cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), 2.5) / 0.11
    centre, half = np.array([width // 2, height // 2]), 0.5 * scale * 0.3 / GRID.cell_m
    if defect == "crack":
        step = np.array([0.85 * half, 0.5 * half])
        low, high = (centre - step).astype(int).tolist(), (centre + step).astype(int).tolist()
        cv2.line(wall, low, high, 60.0, 2, cv2.LINE_AA)
    elif defect == "spalling":
        cv2.ellipse(wall, centre.tolist(), (int(0.8 * half), int(0.6 * half)), 0, 0, 360, 85.0, -1, cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(wall, (0, 0), 0.7), dtype=np.float32)


def photograph(wall: Picture, seed: int, light: float = 1.0) -> list[Picture]:
    """Three views: shifted by up to two cells, in a light that falls off across the wall, with noise."""
    rng = np.random.default_rng(seed)
    height, width = wall.shape
    views = []
    for _ in range(3):
        shift = np.array([[1, 0, rng.uniform(-2, 2)], [0, 1, rng.uniform(-2, 2)]], dtype=np.float32)
        moved = cv2.warpAffine(wall, shift, (width, height), borderMode=cv2.BORDER_REFLECT)
        shading = light * (1 + 0.25 * rng.uniform(-1, 1) * np.linspace(-1, 1, width)[None, :])
        views.append((moved * shading + rng.normal(scale=1.5, size=wall.shape)).astype(np.float32))
    return views


def look(before: Picture, after: Picture, defect: str, seed: int = 0) -> LookVerdict:
    found = compare_views(photograph(before, seed), photograph(after, seed + 100, light=0.7), GRID, 0.05)
    return judge_comparison(found, DefectClass(defect))


@pytest.mark.parametrize("defect", ["crack", "spalling"])
@pytest.mark.parametrize("seed", range(6))
def test_a_defect_that_stays_looks_the_same(defect: str, seed: int) -> None:
    wall = paint_wall(seed, defect=defect)
    assert look(wall, wall, defect, seed) is LookVerdict.SAME


@pytest.mark.parametrize("defect", ["crack", "spalling"])
@pytest.mark.parametrize("seed", range(6))
def test_a_repaired_defect_is_gone_on_a_wall_that_is_recognised(defect: str, seed: int) -> None:
    assert look(paint_wall(seed, defect=defect), paint_wall(seed, defect=None), defect, seed) is LookVerdict.GONE


@pytest.mark.parametrize("defect", ["crack", "spalling"])
@pytest.mark.parametrize("seed", range(6))
def test_what_is_before_the_wall_is_never_a_repair(defect: str, seed: int) -> None:
    scaffold = paint_wall(seed + 50, defect=None)
    verdict = look(paint_wall(seed, defect=defect), scaffold, defect, seed)
    assert verdict in (LookVerdict.HIDDEN, LookVerdict.UNDECIDED)


@pytest.mark.parametrize("seed", range(6))
def test_a_spall_that_grew_is_never_a_repair(seed: int) -> None:
    small, large = paint_wall(seed, defect="spalling", scale=0.7), paint_wall(seed, defect="spalling", scale=1.1)
    assert look(small, large, "spalling", seed) is not LookVerdict.GONE


def test_a_place_of_few_cells_decides_nothing() -> None:
    coarse = PatchGrid.build(PLACE, 0.08)
    flat = np.full(coarse.defect.shape, 100.0, dtype=np.float32)
    noisy = [flat + np.random.default_rng(k).normal(size=flat.shape).astype(np.float32) for k in range(2)]
    found = compare_views(noisy[:1], noisy[1:], coarse, 0.05)
    assert judge_comparison(found, DefectClass.CRACK) is LookVerdict.UNDECIDED


def test_a_patch_is_rectified_to_its_place_on_the_wall() -> None:
    """A camera 3 m before the wall that faces south: east is right, up is up; by the pinhole's similar triangles."""
    camera = Camera(width_px=600, height_px=400, fx_px=900, fy_px=900, cx_px=300, cy_px=200)
    site_from_cam = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    posed = PosedCamera(
        camera=camera, site_from_cam=Similarity(rotation=site_from_cam, translation=np.array([0.0, -3.0, 0.0]))
    )
    image = np.full((400, 600), 200, dtype=np.uint8)
    east_m, up_m = 0.09, 0.06
    column, row = 300 + 900 * east_m / 3, 200 - 900 * up_m / 3
    cv2.circle(image, (round(column - 0.5), round(row - 0.5)), 6, 20, -1)
    patch = rectify_patch(image, posed, PLACE, GRID)
    assert patch is not None and patch.shape == GRID.defect.shape
    dark = np.argwhere(patch < 100).mean(axis=0)
    half = np.array(GRID.defect.shape) // 2
    assert (dark[1] - half[1]) * GRID.cell_m == pytest.approx(east_m, abs=0.003)
    assert (half[0] - dark[0]) * GRID.cell_m == pytest.approx(up_m, abs=0.003)
    beside = Place(**{**vars(PLACE), "xyz_site_m": np.array([1.0, 0.0, 0.0])})
    assert rectify_patch(image, posed, beside, GRID) is None  # beyond the photograph's border
