"""Photographs of cracks of known width, rendered through a model of the camera.

A crack is drawn in linear light at several texels per pixel, blurred, averaged to pixels, given noise, mosaiced (Bayer
pattern) and stored as JPEG.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from facadelake.core.arrays import Float32Array, Float64Array, Float64N, Float64Nx2, UInt8Image

FINE = 8  # texels per pixel, along each axis


@dataclass(frozen=True, kw_only=True)
class ImageDegradation:
    """Model of image degradation: ``blur_px`` (sigma of the lens), ``noise`` (sigma, share of white), JPEG quality, and
    whether the sensor has a Bayer mosaic."""

    blur_px: float = 0.6
    noise: float = 0.01
    jpeg: int = 90
    mosaic: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnCrack:
    """A photograph (h, w, 3: blue, green, red) of one crack, with its true centreline (k, 2) and widths (k,) in pixels.

    ``box_px``: left, top, width and height of its bounding box. ``mask`` (h, w): share of each pixel that is crack.
    """

    image: UInt8Image
    line_px: Float64Nx2
    widths_px: Float64N
    mean_px: float
    max_px: float
    length_px: float
    box_px: tuple[float, float, float, float]
    mask: Float64Array


def draw_crack(
    rng: np.random.Generator,
    width_px: float,
    *,
    length_px: float = 180.0,
    darkness: float = 0.85,
    wall: str = "render",
    degradation: ImageDegradation | None = None,
    varying: float = 0.35,
    wander: float = 1.0,
) -> DrawnCrack:
    """Draw one crack and render its photograph.

    Args:
        rng: random generator.
        width_px: nominal mean width.
        length_px: length along the centreline.
        darkness: share of the wall's light that the crack absorbs; negative for a crack brighter than the wall.
        wall: ``render`` or ``brick``.
        degradation: model of the camera; None for the default one.
        varying: amplitude of the width along the crack, relative to the mean width.
        wander: deviation of the heading from a straight line; 1 is a standard deviation of 0.5 rad.
    """
    margin = 40
    side = int(length_px) + 2 * margin
    line = _generate_line(rng, length_px, side, wander)
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    waves = sum(np.sin(2 * np.pi * (along / long + rng.uniform())) for long in (length_px / 1.7, length_px / 4.3))
    widths = width_px * (1 + varying * np.asarray(waves) / 2)
    fine = np.zeros((side * FINE, side * FINE), dtype=np.uint8)
    tangent = np.gradient(line, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.linalg.norm(tangent, axis=1, keepdims=True)
    drawn = widths - 1 / FINE  # OpenCV fills texels on the border completely
    for i in range(len(line) - 1):
        corners = np.array(
            [
                line[i] + normal[i] * drawn[i] / 2,
                line[i + 1] + normal[i + 1] * drawn[i + 1] / 2,
                line[i + 1] - normal[i + 1] * drawn[i + 1] / 2,
                line[i] - normal[i] * drawn[i] / 2,
            ]
        )
        cv2.fillConvexPoly(fine, np.round((corners * FINE - 0.5) * 256).astype(np.int32), 255, cv2.LINE_8, 8)
    covered = fine > 0
    mask = cv2.resize(covered.astype(np.float64), (side, side), interpolation=cv2.INTER_AREA)
    light = _generate_wall(rng, side, wall)
    light[covered] *= np.float32(1 - darkness)
    _draw_window(light, line)
    image = render_photograph(rng, light, degradation or ImageDegradation())
    rows, columns = np.nonzero(mask > 0.05)
    box = (float(columns.min()), float(rows.min()), float(np.ptp(columns) + 1), float(np.ptp(rows) + 1))
    return DrawnCrack(
        image=image,
        line_px=line,
        widths_px=widths,
        mean_px=float(mask.sum() / along[-1]),
        max_px=float(widths.max()),
        length_px=float(along[-1]),
        box_px=box,
        mask=mask,
    )


def draw_wall(
    rng: np.random.Generator, side: int, wall: str = "render", degradation: ImageDegradation | None = None
) -> UInt8Image:
    """A photograph (side, side, 3) of a wall (``render`` or ``brick``) without a crack."""
    return render_photograph(rng, _generate_wall(rng, side, wall), degradation or ImageDegradation())


def _draw_window(light: Float32Array, line: Float64Array) -> None:
    """Draw a dark pane in the corner farthest from the crack: its sharp edges determine the photograph's blur."""
    side, pane = len(light), 34 * FINE
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    away = [np.linalg.norm(line * FINE - corner[::-1] * side, axis=1).min() for corner in corners]
    row, column = corners[int(np.argmax(away))] * (side - pane)
    light[row : row + pane, column : column + pane] *= np.float32(0.3)


def _generate_line(rng: np.random.Generator, length_px: float, side: int, wander: float) -> Float64Array:
    """A random curve through the centre of the photograph, (k, 2) in pixels, with points about 1 px apart."""
    count = int(length_px)
    turn = gaussian_filter1d(rng.normal(size=count), 6.0)
    heading = rng.uniform(0, np.pi) + wander * 0.5 * turn / np.std(turn)
    steps = np.column_stack([np.cos(heading), np.sin(heading)])
    line = np.vstack([[0, 0], np.cumsum(steps, axis=0)])
    line = line - (line.min(axis=0) + line.max(axis=0)) / 2
    return np.asarray(line + side / 2)


def _generate_wall(rng: np.random.Generator, side: int, kind: str) -> Float32Array:
    """Light (side * FINE, side * FINE) reflected by a wall whose illumination decreases to one side."""
    size = side * FINE
    light = np.full((size, size), 0.42, dtype=np.float32)
    if kind == "brick":
        high, long, joint = 26 * FINE, 70 * FINE, 5 * FINE
        row, column = np.mgrid[0:size, 0:size]
        course = row // high
        shifted = column + (course % 2) * long // 2
        tone = rng.normal(0.30, 0.045, size=(size // high + 2, size // long + 3))
        light = tone[course, shifted // long].astype(np.float32)
        light[(row % high < joint) | (shifted % long < joint)] = 0.45
    for grain_px, strength in ((0.7, 0.05), (2.5, 0.05), (9.0, 0.04), (40.0, 0.05)):
        cells = max(2, round(side / grain_px))
        noise = rng.normal(size=(cells, cells)).astype(np.float32)
        light *= 1 + strength * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    light *= np.linspace(0.85, 1.1, size, dtype=np.float32)
    return np.clip(light, 0.01, 1.0)


def render_photograph(rng: np.random.Generator, light: Float32Array, degradation: ImageDegradation) -> UInt8Image:
    """Pixels (h, w, 3: blue, green, red) of the JPEG photograph of linear light (h * FINE, w * FINE)."""
    side = light.shape[0] // FINE
    blurred = cv2.GaussianBlur(light, (0, 0), sigmaX=degradation.blur_px * FINE)
    pixels = cv2.resize(blurred, (side, side), interpolation=cv2.INTER_AREA)[..., None] * [0.86, 0.97, 1.0]
    pixels = pixels + rng.normal(size=pixels.shape) * degradation.noise * np.sqrt(0.1 + pixels)
    if degradation.mosaic:
        raw = pixels[..., 0].copy()
        raw[0::2, 1::2], raw[1::2, 0::2], raw[1::2, 1::2] = (
            pixels[0::2, 1::2, 1],
            pixels[1::2, 0::2, 1],
            pixels[1::2, 1::2, 2],
        )
        sixteen = np.clip(raw * 60000, 0, 65535).astype(np.uint16)
        pixels = cv2.cvtColor(sixteen, cv2.COLOR_BayerRGGB2BGR).astype(np.float64) / 60000
    encoded = np.where(pixels <= 0.0031308, 12.92 * pixels, 1.055 * np.maximum(pixels, 1e-9) ** (1 / 2.4) - 0.055)
    eight: Any = np.clip(encoded * 255 + 0.5, 0, 255).astype(np.uint8)
    done, stored = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, degradation.jpeg])
    if not done:
        raise RuntimeError("OpenCV could not write a JPEG")
    return np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR), dtype=np.uint8)
