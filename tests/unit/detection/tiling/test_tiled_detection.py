"""Tiles give the detections of the whole photograph: no crack is duplicated, cut or merged with its neighbour."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from facadelake.core.arrays import UInt8Image
from facadelake.detection.inference.detector import DetectedBox
from facadelake.detection.tiling.tiled_detection import detect_image
from tests.unit.detection.blobs import BlobDetector


def make_wall(width: int = 1000, height: int = 700) -> UInt8Image:
    return np.full((height, width, 3), 255, dtype=np.uint8)


def draw_crack(image: UInt8Image, *points: tuple[int, int], thick: int = 3) -> None:
    cv2.polylines(image, [np.array(points)], isClosed=False, color=(0, 0, 0), thickness=thick)


def sort_corners(found: tuple[DetectedBox, ...]) -> NDArray[np.float64]:
    boxes = [(f.box.x_px, f.box.y_px, f.box.x_px + f.box.width_px, f.box.y_px + f.box.height_px) for f in found]
    return np.array(sorted(boxes), dtype=np.float64).reshape(-1, 4)


def detect_whole(image: UInt8Image) -> NDArray[np.float64]:
    """The boxes of all blobs, found without tiles."""
    (found,) = BlobDetector().detect_batch([image])
    return sort_corners(found)


def detect_fine(image: UInt8Image, *, masks: bool = False) -> NDArray[np.float64]:
    """The boxes of the pass of tiles, without the pass of the whole photograph."""
    return sort_corners(detect_image(BlobDetector(masks=masks, gsd_mm=(2.0,)), image, gsd_mm=2.0))


def detect_tiled(image: UInt8Image, *, masks: bool = False) -> NDArray[np.float64]:
    return sort_corners(detect_image(BlobDetector(masks=masks), image))


@pytest.mark.parametrize("masks", [False, True])
@pytest.mark.parametrize(
    "points",
    [
        [(20, 350), (980, 350)],
        [(500, 10), (500, 690)],
        [(15, 12), (985, 690)],
        [(985, 20), (15, 600)],
        [(20, 100), (300, 130), (520, 300), (600, 580), (980, 640)],
    ],
)
def test_a_crack_through_many_tiles_is_one_box(points: list[tuple[int, int]], masks: bool) -> None:
    image = make_wall()
    draw_crack(image, *points)
    assert detect_fine(image, masks=masks) == pytest.approx(detect_whole(image), rel=0, abs=1)  # px
    assert detect_tiled(image, masks=masks) == pytest.approx(detect_whole(image), rel=0, abs=1)  # px


@pytest.mark.parametrize("masks", [False, True])
@pytest.mark.parametrize("apart", [40, 70, 130])
@pytest.mark.parametrize("slope", [0.0, 0.15])
def test_cracks_side_by_side_stay_apart(apart: int, slope: float, masks: bool) -> None:
    image = make_wall()
    for row in range(4):
        top = 60 + row * apart
        draw_crack(image, (20, top), (980, round(top + slope * 960)))
    assert detect_fine(image, masks=masks) == pytest.approx(detect_whole(image), rel=0, abs=1)  # px
    assert detect_tiled(image, masks=masks) == pytest.approx(detect_whole(image), rel=0, abs=1)  # px


@pytest.mark.parametrize(("wide", "high"), [(60, 40), (150, 90), (300, 260), (480, 70)])
def test_a_patch_across_tiles_is_one_box(wide: int, high: int) -> None:
    for x in range(250, 420, 37):
        image = make_wall()
        cv2.ellipse(image, (x, 350), (wide // 2, high // 2), 0, 0, 360, (0, 0, 0), -1)
        cv2.rectangle(image, (700, 100), (700 + wide // 2, 100 + high), (0, 0, 0), -1)
        assert detect_fine(image) == pytest.approx(detect_whole(image), rel=0, abs=1)  # px


def test_spots_are_detected_once_at_any_position() -> None:
    image = make_wall()
    for x in range(15, 1000, 61):
        for y in range(15, 700, 53):
            cv2.rectangle(image, (x, y), (x + 17, y + 12), (0, 0, 0), -1)
    assert len(detect_tiled(image)) == len(detect_whole(image))
    assert detect_tiled(image) == pytest.approx(detect_whole(image), rel=0, abs=1)  # px


def test_masks_of_parts_are_united() -> None:
    image = make_wall()
    draw_crack(image, (20, 100), (980, 600), thick=5)
    (found,) = detect_image(BlobDetector(masks=True), image)
    assert found.mask is not None
    assert found.mask.area == pytest.approx(float((image[..., 0] < 128).sum()), rel=0, abs=1)  # px2


def test_workers_do_not_change_the_result() -> None:
    image = make_wall()
    draw_crack(image, (15, 12), (985, 690))
    assert detect_image(BlobDetector(), image, workers=3) == detect_image(BlobDetector(), image)


def test_a_small_image_is_processed_once() -> None:
    detector = BlobDetector()
    detect_image(detector, make_wall(320, 300))
    assert detector.processed_sizes == [(300, 320)]


def test_nothing_is_processed_for_an_empty_target() -> None:
    detector = BlobDetector()
    image = make_wall()
    draw_crack(image, (20, 350), (980, 350))
    assert detect_image(detector, image, target=np.zeros((70, 100), dtype=bool)) == ()
    assert detector.processed_sizes == []
