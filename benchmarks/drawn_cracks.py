"""Cracks of known width as a camera would show them: drawn fine in linear light, averaged to pixels, blurred, mosaiced,
made noisy and stored as JPEG."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

FINE = 8  # texels a pixel, each way
Image = NDArray[np.uint8]
Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """What the photograph adds: blur (sigma of the lens), noise (share of white), JPEG quality, and a Bayer mosaic."""

    blur_px: float = 0.6
    noise: float = 0.01
    jpeg: int = 90
    mosaic: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnCrack:
    """A photograph (h, w, 3: blue, green, red) of one crack: its line (k, 2) and widths (k,), px, and its true means.

    ``box_px``: left, top, width, height about it. ``mask`` (h, w): share of each pixel that is crack.
    """

    image: Image
    line_px: Array
    widths_px: Array
    mean_px: float
    max_px: float
    length_px: float
    box_px: tuple[float, float, float, float]
    mask: Array


def draw_crack(
    rng: np.random.Generator,
    width_px: float,
    *,
    length_px: float = 180.0,
    darkness: float = 0.85,
    wall: str = "render",
    camera: Camera | None = None,
    varying: float = 0.35,
    wander: float = 1.0,
) -> DrawnCrack:
    """A crack of mean ``width_px`` whose width goes up and down by ``varying`` of it, on a ``wall`` of render or brick.

    ``darkness``: share of the wall's light that the crack swallows (below 0: it is brighter than the wall).
    """
    margin = 40
    side = int(length_px) + 2 * margin
    line = _line(rng, length_px, side, wander)
    step = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    waves = sum(np.sin(2 * np.pi * (along / long + rng.uniform())) for long in (length_px / 1.7, length_px / 4.3))
    widths = width_px * (1 + varying * np.asarray(waves) / 2)
    fine = np.zeros((side * FINE, side * FINE), dtype=np.uint8)
    tangent = np.gradient(line, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.linalg.norm(tangent, axis=1, keepdims=True)
    drawn = widths - 1 / FINE  # OpenCV fills the rim's texels whole
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
    light = _wall(rng, side, wall)
    light[covered] *= np.float32(1 - darkness)
    _window(light, line)
    image = photographed(rng, light, camera or Camera())
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


def bare_wall(rng: np.random.Generator, side: int, wall: str = "render", camera: Camera | None = None) -> Image:
    """A photograph (side, side, 3) of a wall without any crack."""
    return photographed(rng, _wall(rng, side, wall), camera or Camera())


def _window(light: NDArray[np.float32], line: Array) -> None:
    """A dark pane in the corner away from the crack: photographs of facades have sharp edges that tell their blur."""
    side, pane = len(light), 34 * FINE
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    away = [np.linalg.norm(line * FINE - corner[::-1] * side, axis=1).min() for corner in corners]
    row, column = corners[int(np.argmax(away))] * (side - pane)
    light[row : row + pane, column : column + pane] *= np.float32(0.3)


def _line(rng: np.random.Generator, length_px: float, side: int, wander: float) -> Array:
    """A wandering line through the middle of the picture, points about 1 px apart."""
    count = int(length_px)
    turn = gaussian_filter1d(rng.normal(size=count), 6.0)
    heading = rng.uniform(0, np.pi) + wander * 0.5 * turn / np.std(turn)
    steps = np.column_stack([np.cos(heading), np.sin(heading)])
    line = np.vstack([[0, 0], np.cumsum(steps, axis=0)])
    line = line - (line.min(axis=0) + line.max(axis=0)) / 2
    return np.asarray(line + side / 2)


def _wall(rng: np.random.Generator, side: int, kind: str) -> NDArray[np.float32]:
    """Reflectance (side * FINE, the same) of a wall under light that falls off to one side."""
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


def photographed(rng: np.random.Generator, light: NDArray[np.float32], camera: Camera) -> Image:
    """Linear light (h FINE, w FINE) as a JPEG file's pixels (h, w, 3)."""
    side = light.shape[0] // FINE
    blurred = cv2.GaussianBlur(light, (0, 0), sigmaX=camera.blur_px * FINE)
    pixels = cv2.resize(blurred, (side, side), interpolation=cv2.INTER_AREA)[..., None] * [0.86, 0.97, 1.0]
    pixels = pixels + rng.normal(size=pixels.shape) * camera.noise * np.sqrt(0.1 + pixels)
    if camera.mosaic:
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
    done, stored = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg])
    if not done:
        raise RuntimeError("OpenCV could not write a JPEG")
    return np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR), dtype=np.uint8)
