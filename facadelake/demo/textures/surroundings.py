"""Textures of the surroundings: neighbours, a container, ground, roofs and sky."""

from __future__ import annotations

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Array
from facadelake.demo.building.charts import Chart
from facadelake.demo.building.solids import SCAFFOLD_BAY_M, SCAFFOLD_LIFT_M
from facadelake.demo.recipe import BoxVolume
from facadelake.demo.textures.canvas import Colour, TextureCanvas
from facadelake.demo.textures.facades import add_patches, paint_bricks


def paint_box_side(chart: Chart, look: str, rng: np.random.Generator) -> TextureCanvas:
    """One side of a neighbour or an obstacle."""
    if look == "container":
        return _paint_container(chart, rng)
    if look == "scaffold":
        return _paint_sheeting(chart, rng)
    canvas = TextureCanvas(chart, rng, (190, 170, 150))
    width, height = chart.size_m
    if look == "brick":
        paint_bricks(canvas, 0, 0, width, height, (128, 74, 58))
    else:
        canvas.add(6 * canvas.sample_noise(1.5) + 5 * canvas.sample_noise(0.3) + 4 * canvas.sample_noise(0.05))
        add_patches(canvas, 0.1, (0.2, 0.6), 10)
    canvas.add_speckles(4, (0.02, 0.08), 11)
    for v in np.arange(1.0, height - 1.6, 2.8):
        for u in np.arange(1.4, width - 1.2, 2.6):
            canvas.fill(u - 0.6, v - 0.06, u + 0.6, v + 1.46, (222, 218, 208))
            region = canvas.find_region(u - 0.5, v, u + 0.5, v + 1.4)
            canvas.image[region] = rng.uniform(45, 95)
            canvas.add(9 * canvas.sample_noise(0.4, region), region)
            canvas.fill(u - 0.03, v, u + 0.03, v + 1.4, (222, 218, 208))
    return canvas


def _paint_container(chart: Chart, rng: np.random.Generator) -> TextureCanvas:
    """A side of a container of corrugated steel."""
    canvas = TextureCanvas(chart, rng, (44, 92, 128))
    columns = canvas.image.shape[1]
    wave = 20 * np.sign(np.sin(np.arange(columns, dtype=np.float32) * 2 * np.pi / (0.28 * canvas.per_u)))
    canvas.image += cv2.GaussianBlur(wave.reshape(1, -1), (0, 0), sigmaX=3).reshape(1, -1, 1)
    canvas.add(5 * canvas.sample_noise(0.8) + 4 * canvas.sample_noise(0.05))
    canvas.add_speckles(6, (0.01, 0.06), 20)
    width, height = chart.size_m
    canvas.fill(0.3, height - 0.75, min(1.9, width - 0.2), height - 0.35, (226, 226, 220))
    return canvas


def _paint_sheeting(chart: Chart, rng: np.random.Generator) -> TextureCanvas:
    """A side of a scaffold: sheeting with folds, tied to tubes that show through it, with seams and a banner."""
    canvas = TextureCanvas(chart, rng, (188, 200, 194))
    width, height = chart.size_m
    columns = canvas.image.shape[1]
    folds = rng.standard_normal((1, columns), dtype=np.float32)
    canvas.image += 40 * cv2.GaussianBlur(folds, (0, 0), sigmaX=0.06 * canvas.per_u).reshape(1, -1, 1)
    canvas.add(9 * canvas.sample_noise(0.9) + 6 * canvas.sample_noise(0.2) + 4 * canvas.sample_noise(0.05))
    for u in np.arange(0.0, width, SCAFFOLD_BAY_M):
        canvas.fill(u, 0.0, u + 0.05, height, (150, 160, 158))
    for v in np.arange(0.0, height, SCAFFOLD_LIFT_M):
        canvas.fill(0.0, v, width, v + 0.06, (142, 152, 150))
        for u in np.arange(0.1, width, 0.4):
            canvas.fill(u, v + 0.09, u + 0.03, v + 0.12, (70, 76, 74))
    canvas.fill(0.3, height - 1.9, min(2.3, width - 0.2), height - 0.9, (36, 84, 122))
    canvas.fill(0.45, height - 1.6, min(2.0, width - 0.4), height - 1.45, (232, 232, 226))
    canvas.add_speckles(9, (0.01, 0.06), 14)
    return canvas


def paint_ground(
    chart: Chart, keep_out_m: tuple[float, float, float, float], lawn: Colour, rng: np.random.Generator
) -> TextureCanvas:
    """Lawn, with paving around the building and a gravel drive to the south.

    Args:
        chart: the ground.
        keep_out_m: plan of the building: x0, y0, x1, y1.
        lawn: colour of the lawn.
        rng: draws the ground.
    """
    canvas = TextureCanvas(chart, rng, lawn)
    canvas.add(
        11 * canvas.sample_noise(5.0)
        + 9 * canvas.sample_noise(1.0)
        + 9 * canvas.sample_noise(0.2)
        + 9 * canvas.sample_noise(0.06)
    )
    ox, oy = float(chart.origin_m[0]), float(chart.origin_m[1])
    x0, y0, x1, y1 = keep_out_m
    drive = canvas.find_region(x0 + 7 - ox, -20 - oy, x0 + 11 - ox, y0 - oy)
    canvas.image[drive] = (150, 142, 128)
    canvas.add(
        9 * canvas.sample_noise(0.08, drive)
        + 8 * canvas.sample_noise(0.7, drive)
        + 10 * canvas.sample_noise(0.05, drive),
        drive,
    )
    slab, margin = 0.6, 1.8
    for x in np.arange(x0 - margin, x1 + margin, slab):
        for y in np.arange(y0 - margin, y1 + margin, slab):
            region = canvas.find_region(x - ox, y - oy, x + slab - ox, y + slab - oy)
            canvas.image[region] = 150 + rng.normal(scale=9)
            canvas.add(7 * canvas.sample_noise(0.1, region) + 5 * canvas.sample_noise(0.05, region), region)
            canvas.image[region][:1], canvas.image[region][:, :1] = 96, 96
    canvas.add_speckles(3, (0.03, 0.15), 16)
    return canvas


def paint_roof(chart: Chart, rng: np.random.Generator) -> TextureCanvas:
    """Gravel on terrace and roof."""
    canvas = TextureCanvas(chart, rng, (142, 138, 130))
    canvas.add(7 * canvas.sample_noise(2.0) + 12 * canvas.sample_noise(0.06) + 8 * canvas.sample_noise(0.03))
    canvas.add_speckles(10, (0.02, 0.06), 18)
    add_patches(canvas, 0.08, (0.2, 0.8), 10)
    return canvas


def paint_concrete(size_px: int, rng: np.random.Generator) -> UInt8Array:
    """A tile of concrete for all small parts, mean 225, tinted where it is used."""
    tile = np.full((size_px, size_px), 225, dtype=np.float32)
    for cells, strength in ((8, 5), (32, 6), (128, 7), (512, 8)):
        coarse = rng.standard_normal((cells, cells), dtype=np.float32)
        tile += strength * np.asarray(cv2.resize(coarse, (size_px, size_px), interpolation=cv2.INTER_CUBIC))
    return np.asarray(np.repeat(np.clip(tile, 0, 255).astype(np.uint8)[..., None], 3, axis=2))


def paint_sky(rng: np.random.Generator, overcast: float = 0.0) -> UInt8Array:
    """The texture of the dome: columns are azimuth; rows go from the zenith to slightly below the horizon.

    ``overcast``: 0 is a fair sky with some clouds, 1 a closed grey one.
    """
    rows, columns = 512, 2048
    sine_elevation = np.linspace(1, -0.15, rows, dtype=np.float32)[:, None, None]
    zenith, haze = np.array([96, 146, 208], dtype=np.float32), np.array([214, 224, 232], dtype=np.float32)
    sky = haze + (zenith - haze) * np.clip(sine_elevation, 0, 1) ** 0.6 * np.ones((rows, columns, 1), dtype=np.float32)
    clouds = np.zeros((rows, columns), dtype=np.float32)
    for cells, strength in ((6, 1.0), (14, 0.7), (34, 0.4), (90, 0.2)):
        coarse = rng.standard_normal((cells, 3 * cells), dtype=np.float32)
        coarse[:, -2:] = coarse[:, :2]  # continuous across the seam of the dome
        clouds += strength * np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC))
    cover = (np.clip(clouds - 0.5, 0, 1.2) / 1.2)[..., None] * np.clip(1.2 - sine_elevation, 0, 1)
    sky += cover * (np.array([246, 247, 249], dtype=np.float32) - sky)
    if overcast:
        grey = np.array([190, 194, 198], dtype=np.float32) + 7 * np.clip(clouds, -1.5, 1.5)[..., None]
        sky += overcast * (grey - sky)
    hills = cv2.GaussianBlur(rng.standard_normal((1, columns), dtype=np.float32), (0, 0), sigmaX=40)[0] * 0.25 + 0.035
    below = sine_elevation[:, :, 0] < hills[None, :]
    sky[below] = (128, 146, 140)
    return np.asarray(np.clip(sky, 0, 255).astype(np.uint8))


def has_roof(box: BoxVolume) -> bool:
    """Whether a box has a gable roof: houses have one."""
    return box.look in ("brick", "plaster")
