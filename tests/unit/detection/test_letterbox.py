"""A rectangle is at the position that the letterbox states, to half a pixel of the photograph."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from facadelake.detection.card import CardInput, ResizeMode
from facadelake.detection.inference.letterbox import fit_letterbox

INPUT = {"width_px": 416, "height_px": 320, "colour": "bgr", "scale": 1.0, "pad_value": 0}
SIZES = [(3072, 2048), (2048, 3072), (4000, 501), (333, 1999), (200, 150), (416, 320), (1, 1)]


@pytest.mark.parametrize("resize", list(ResizeMode))
@pytest.mark.parametrize(("width", "height"), SIZES[:5])
def test_a_rectangle_is_transformed_back_to_its_position(resize: ResizeMode, width: int, height: int) -> None:
    left, top, right, bottom = width // 5, height // 3, width - width // 7, height - height // 9
    image = np.zeros((height, width, 3), dtype=np.uint8)
    image[top:bottom, left:right] = 255
    box = fit_letterbox(CardInput(**INPUT, resize=resize), image_width_px=width, image_height_px=height)
    values = box.input_from_image(image)[0, 0]
    # Moments of the rectangle in the input: independent of gain and padding.
    centre, spread = np.zeros(2), np.zeros(2)
    for axis in (0, 1):
        profile, at = values.sum(axis=axis), np.arange(values.shape[1 - axis]) + 0.5
        centre[axis] = (profile * at).sum() / profile.sum()
        spread[axis] = (profile * (at - centre[axis]) ** 2).sum() / profile.sum()
    half = np.sqrt(3 * spread)  # of a uniform rectangle
    found = box.image_from_input(np.concatenate([centre - half, centre + half])[None])[0]
    assert (found[:2] + found[2:]) / 2 == pytest.approx([(left + right) / 2, (top + bottom) / 2], rel=0, abs=0.5)  # px
    # Blur of a reduced edge increases the second moment by up to half a pixel of the input.
    edge_px = 0.5 * max(width / box.resized_width_px, height / box.resized_height_px, 1.0)
    assert found == pytest.approx([left, top, right, bottom], rel=0, abs=edge_px)  # px


@pytest.mark.parametrize("resize", list(ResizeMode))
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_the_whole_photograph_fits_exactly(resize: ResizeMode, width: int, height: int) -> None:
    spec = CardInput(**INPUT, resize=resize)
    box = fit_letterbox(spec, image_width_px=width, image_height_px=height)
    right, bottom = box.left_px + box.resized_width_px, box.top_px + box.resized_height_px
    assert min(box.left_px, box.top_px) >= 0
    assert right <= 416
    assert bottom <= 320
    assert box.resized_width_px == 416 or box.resized_height_px == 320
    corners = np.array([[box.left_px, box.top_px, right, bottom]], dtype=np.float64)
    assert box.image_from_input(corners)[0] == pytest.approx([0, 0, width, height], rel=0, abs=1e-9)  # px
    if resize is ResizeMode.CENTRE:
        assert abs((416 - right) - box.left_px) <= 1
        assert abs((320 - bottom) - box.top_px) <= 1
    elif resize is ResizeMode.CORNER:
        assert (box.left_px, box.top_px) == (0, 0)


def test_colours_scaling_and_padding() -> None:
    image = np.full((100, 50, 3), (10, 20, 30), dtype=np.uint8)  # blue, green, red
    spec = CardInput(
        width_px=64, height_px=64, colour="rgb", scale=1 / 255, mean=(0.1, 0.2, 0.3), std=(0.5, 0.25, 0.2),
        resize=ResizeMode.CENTRE, pad_value=128,
    )  # fmt: skip
    values = fit_letterbox(spec, image_width_px=50, image_height_px=100).input_from_image(image)
    assert values.shape == (1, 3, 64, 64)
    assert values.dtype == np.float32
    red, green, blue = (30 / 255 - 0.1) / 0.5, (20 / 255 - 0.2) / 0.25, (10 / 255 - 0.3) / 0.2
    assert values[0, :, 32, 32] == pytest.approx([red, green, blue], rel=0, abs=1e-6)
    grey = 128 / 255
    assert values[0, :, 32, 0] == pytest.approx([(grey - 0.1) / 0.5, (grey - 0.2) / 0.25, (grey - 0.3) / 0.2], abs=1e-6)


def test_opencv_resizes_about_the_corner() -> None:
    """Assumption of the transform: an edge at x of a wide image is at x * gain of the reduced one."""
    image = np.zeros((4, 1000), dtype=np.float32)
    image[:, 437:] = 1
    for method in (cv2.INTER_AREA, cv2.INTER_LINEAR):
        small = cv2.resize(image, (100, 4), interpolation=method)
        step = 100 - small[0].sum()
        assert step == pytest.approx(43.7, rel=0, abs=0.5)  # px
