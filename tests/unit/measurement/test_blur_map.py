"""Blur over a photograph, against pictures whose point spread is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from facadelake.core.arrays import UInt8Image
from facadelake.measurement import map_blur


def draw_facade(sigma_px: float, noise: float = 1.0, size: tuple[int, int] = (900, 1200)) -> UInt8Image:
    """A wall with windows, spread by ``sigma_px`` in linear light, in sRGB with ``noise`` grey levels."""
    y, x = np.mgrid[0 : size[0], 0 : size[1]].astype(np.float32)
    light = np.where(((x + 0.2 * y) % 170 < 60) & ((y - 0.1 * x) % 150 < 80), 0.08, 0.45).astype(np.float32)
    if sigma_px:
        light = cv2.GaussianBlur(light, (0, 0), sigma_px)
    grey = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    noisy = 255 * grey + np.random.default_rng(7).normal(0, noise, grey.shape)
    return np.repeat(np.clip(noisy + 0.5, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.mark.parametrize("sigma_px", [0.7, 1.0, 2.0, 3.0, 4.0, 6.0, 9.0])
def test_blur_is_measured_even_where_a_photograph_is_out_of_focus(sigma_px: float) -> None:
    """At full resolution noise makes 2 px of any larger blur; an estimate too high is the safe side."""
    measured = float(np.nanmedian(map_blur(draw_facade(sigma_px)).sigma_px))
    assert 0.85 * sigma_px < measured < 1.5 * sigma_px


def test_a_part_is_found_by_its_pixel() -> None:
    sharp, soft = draw_facade(0.7), draw_facade(4.0)
    image = np.hstack([sharp, soft])
    blur = map_blur(image).get_sigma_px(np.array([[10.0, 400.0], [2390.0, 400.0]]))
    assert blur[0] < 1.2
    assert blur[1] > 3.0


def test_a_photograph_without_edges_has_no_blur() -> None:
    flat = np.full((300, 400, 3), 127, dtype=np.uint8)
    assert np.isnan(map_blur(flat).sigma_px).all()


def test_a_tiny_photograph_is_no_error() -> None:
    assert map_blur(draw_facade(1.0, size=(40, 50))).sigma_px.shape == (3, 4)
