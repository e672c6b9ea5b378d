"""Textures of the facades without light: render, stone, brick, windows, doors and weathering.

Nothing repeats: every block, brick, spot and curtain has its own random numbers, so that matches are unambiguous.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array
from facadelake.demo.building.charts import Chart
from facadelake.demo.recipe import DemoBuilding, OpeningRow
from facadelake.demo.textures.canvas import Colour, TextureCanvas

RENDER: Colour = (203, 184, 146)
TOP_RENDER: Colour = (196, 198, 194)
STONE: Colour = (168, 160, 147)
BRICK: Colour = (150, 82, 60)
BAND: Colour = (176, 148, 120)


def paint_facade(chart: Chart, building: DemoBuilding, rng: np.random.Generator) -> TextureCanvas:
    """The texture of a facade of the building, without defects."""
    top = chart.name.startswith("top")
    canvas = TextureCanvas(chart, rng, TOP_RENDER if top else RENDER)
    _paint_render(canvas)
    if not top:
        floors = [s.floor_m for s in building.storeys]
        paint_ashlar(canvas, 0.0, 0.0, chart.size_m[0], floors[1] - 0.15)
        paint_bricks(canvas, 0.0, floors[2], chart.size_m[0], floors[2] + 0.55, BRICK)
        for u0 in (0.0, chart.size_m[0] - 0.45):
            paint_bricks(canvas, u0, floors[1], u0 + 0.45, chart.size_m[1], BRICK)
        for floor in floors[1:]:
            canvas.fill(0, floor - 0.15, chart.size_m[0], floor, BAND)
            region = canvas.find_region(0, floor - 0.15, chart.size_m[0], floor)
            canvas.add(9 * canvas.sample_noise(0.25, region) + 7 * canvas.sample_noise(0.03, region), region)
    rows = [r for r in building.openings if r.facade == chart.name]
    base = building.shoulder_m if top else 0.0
    for row in rows:
        for u in row.centres_u_m:
            _paint_architrave(canvas, row, u, building.storeys[row.storey].floor_m - base)
    _add_weathering(canvas)
    for row in rows:
        for u in row.centres_u_m:
            _paint_window(canvas, row, u, building.storeys[row.storey].floor_m - base)
    return canvas


def _paint_render(canvas: TextureCanvas) -> None:
    """Trowelled render: variations of all wavelengths, spots, and patches of other years."""
    tone = (
        6 * canvas.sample_noise(2.2)
        + 5 * canvas.sample_noise(0.6)
        + 4 * canvas.sample_noise(0.15)
        + 5 * canvas.sample_noise(0.04)
        + 4 * canvas.sample_noise(0.012)
    )
    canvas.add(tone)
    canvas.image[..., 2] += 4 * canvas.sample_noise(1.1)
    add_patches(canvas, 0.10, (0.12, 0.5), 9)
    canvas.add_speckles(22, (0.006, 0.03), 13)
    canvas.add_speckles(16, (0.015, 0.06), 15)


def add_patches(canvas: TextureCanvas, per_m2: float, radius_m: tuple[float, float], strength: float) -> None:
    """Irregular areas of slightly different tone with a faint rim, like repaired render.

    Args:
        canvas: the texture.
        per_m2: number of patches per square metre.
        radius_m: smallest and largest radius.
        strength: standard deviation of their tone, grey levels.
    """
    rng = canvas.rng
    tone: Float32Array = np.zeros(canvas.image.shape[:2], dtype=np.float32)
    width, height = canvas.chart.size_m
    for _ in range(int(per_m2 * width * height)):
        u, v, r = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(*radius_m)
        ring = [canvas.texel_from_uv(u + x * r, v + y * r) for x, y in sample_blob(rng, 18, 0.35)]
        points = np.round(ring).astype(np.int32)
        cv2.fillPoly(tone, [points], float(rng.normal(scale=strength)))
        cv2.polylines(tone, [points], True, float(-strength * 0.7), 2)
    canvas.add(tone)


def sample_blob(rng: np.random.Generator, corners: int, rough: float) -> list[tuple[float, float]]:
    """Corners of an irregular closed outline, approximately inside the unit circle."""
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    radius = 1 - rough * rng.uniform(0, 1, corners)
    return [(float(r * np.cos(a)), float(r * np.sin(a))) for r, a in zip(radius, angle, strict=True)]


def paint_ashlar(canvas: TextureCanvas, u0: float, v0: float, u1: float, v1: float) -> None:
    """Courses of stone blocks with open joints, each block of its own tone and length.

    Args:
        canvas: the texture.
        u0: left edge, metres.
        v0: lower edge, metres.
        u1: right edge, metres.
        v1: upper edge, metres.
    """
    rng, v = canvas.rng, v0
    while v < v1 - 0.05:
        block_height = min(float(rng.uniform(0.30, 0.42)), v1 - v)
        u = u0 - float(rng.uniform(0, 0.6))
        while u < u1:
            block_length = float(rng.uniform(0.45, 0.95))
            region = canvas.find_region(max(u, u0), v, min(u + block_length, u1), v + block_height)
            if canvas.image[region].size:
                tint = rng.normal(scale=10) + rng.normal(scale=(3.0, 1.5, 3.5))
                canvas.image[region] = np.array(STONE) + tint
                canvas.add(7 * canvas.sample_noise(0.18, region) + 7 * canvas.sample_noise(0.03, region), region)
                joint = canvas.image[region]
                joint[:3], joint[:, :3] = (118, 110, 98), (118, 110, 98)
            u += block_length
        v += block_height
    region = canvas.find_region(u0, v0, u1, v1)
    canvas.add(5 * canvas.sample_noise(1.4, region) + 4 * canvas.sample_noise(0.012, region), region)


def paint_bricks(canvas: TextureCanvas, u0: float, v0: float, u1: float, v1: float, colour: Colour) -> None:
    """Running bond, 0.25 by 0.075 m, each brick of a slightly different tone.

    Args:
        canvas: the texture.
        u0: left edge, metres.
        v0: lower edge, metres.
        u1: right edge, metres.
        v1: upper edge, metres.
        colour: mean colour of the bricks, 0 to 255.
    """
    rng = canvas.rng
    region = canvas.find_region(u0, v0, u1, v1)
    rows, columns = canvas.image[region].shape[:2]
    if rows == 0 or columns == 0:
        return
    brick_height, brick_length = 0.075 * canvas.per_v, 0.25 * canvas.per_u
    r, c = np.mgrid[0:rows, 0:columns].astype(np.float32)
    course = (r / brick_height).astype(int)
    shifted = c / brick_length + 0.5 * (course % 2)
    index = course * 5003 + shifted.astype(int)
    count = int(index.max()) + 1
    tones = (rng.normal(scale=14, size=(count, 1)) + rng.normal(scale=(6, 4, 3), size=(count, 3))).astype(np.float32)
    brick = np.array(colour, dtype=np.float32) + tones[index]
    joint = ((r / brick_height) % 1 * brick_height < 3) | (shifted % 1 * brick_length < 3)
    brick[joint] = (172, 164, 150)
    canvas.image[region] = brick
    canvas.add(5 * canvas.sample_noise(0.03, region) + 4 * canvas.sample_noise(0.5, region), region)


def _paint_architrave(canvas: TextureCanvas, row: OpeningRow, u: float, floor_m: float) -> None:
    """A painted architrave around an opening."""
    v, w = floor_m + row.sill_m, row.width_m / 2
    region = canvas.find_region(u - w - 0.12, v - 0.08, u + w + 0.12, v + row.height_m + 0.12)
    canvas.image[region] = (214, 208, 196)
    canvas.add(4 * canvas.sample_noise(0.2, region) + 5 * canvas.sample_noise(0.02, region), region)


def _add_weathering(canvas: TextureCanvas) -> None:
    """Dirt in streaks from above and rising damp at the ground."""
    rows, columns = canvas.image.shape[:2]
    streak = cv2.GaussianBlur(canvas.rng.standard_normal((4, columns), dtype=np.float32), (0, 0), sigmaX=6)
    field = np.asarray(cv2.resize(streak, (columns, rows), interpolation=cv2.INTER_CUBIC), dtype=np.float32)
    runs = -26 * np.clip(field, 0, None) * (0.5 + 0.5 * np.tanh(canvas.sample_noise(1.2)))
    canvas.add(np.asarray(runs, dtype=np.float32))
    if not canvas.chart.name.startswith("top"):
        height = (np.arange(rows, 0, -1, dtype=np.float32) / canvas.per_v)[:, None]
        damp = -30 * np.exp(-height / 0.25) * (1 + 0.5 * np.tanh(canvas.sample_noise(0.5)))
        canvas.add(np.asarray(damp, dtype=np.float32))


def _paint_window(canvas: TextureCanvas, row: OpeningRow, u: float, floor_m: float) -> None:
    """Frame, panes and what is visible behind them; no two windows are equal."""
    rng = canvas.rng
    v, w, h = floor_m + row.sill_m, row.width_m, row.height_m
    left, right, top = u - w / 2, u + w / 2, v + h
    if row.kind == "door":
        _paint_door(canvas, left, v, right, top)
        return
    frame = (226, 224, 218)
    canvas.fill(left, v, right, top, frame)
    sashes = 2 if w > 0.9 else 1
    step = w / sashes
    curtain, blind = rng.uniform(0.1, 0.42), rng.uniform(-0.6, 0.55)
    curtain_colour = tuple(float(x) for x in rng.uniform(150, 215) + rng.uniform((-5, -12, -25), (15, 5, 5)))
    for i in range(sashes):
        a, b = left + i * step + 0.07, left + (i + 1) * step - 0.07
        region = canvas.find_region(a, v + 0.08, b, top - 0.08)
        rows = canvas.image[region].shape[0]
        depth = np.linspace(70, 34, rows, dtype=np.float32)[:, None, None] * np.array(
            [0.85, 0.98, 1.12], dtype=np.float32
        )
        canvas.image[region] = depth
        canvas.add(6 * canvas.sample_noise(0.35, region), region)
        _paint_interior(canvas, a, v, b, top)
        side = (a, a + curtain * (b - a)) if i == 0 else (b - curtain * (b - a), b)
        _paint_curtain(canvas, side[0], v + 0.08, side[1], top - 0.08, curtain_colour)
        if blind > 0:
            _paint_blind(canvas, a, top - 0.08 - blind * h, b, top - 0.08)
    if sashes == 2:
        canvas.fill(right - 0.012 - step + 0.05, v + h * 0.45, right - step + 0.06, v + h * 0.53, (90, 90, 90))


def _paint_interior(canvas: TextureCanvas, a: float, v: float, b: float, top: float) -> None:
    """Dim shapes behind the glass: a lamp, furniture, a plant."""
    rng = canvas.rng
    for _ in range(int(rng.integers(1, 5))):
        u, size = rng.uniform(a, b), rng.uniform(0.06, 0.22)
        low = rng.uniform(v + 0.1, v + 0.5 * (top - v))
        r, g, b_ = (float(x) for x in rng.uniform(45, 140) + rng.normal(scale=8, size=3))
        canvas.fill(max(a, u - size), low, min(b, u + size), min(low + 1.6 * size, top - 0.1), (r, g, b_))


def _paint_curtain(canvas: TextureCanvas, u0: float, v0: float, u1: float, v1: float, colour: Sequence[float]) -> None:
    """A curtain with vertical folds."""
    region = canvas.find_region(u0, v0, u1, v1)
    rows, columns = canvas.image[region].shape[:2]
    if rows and columns:
        folds = cv2.GaussianBlur(canvas.rng.standard_normal((1, columns), dtype=np.float32), (0, 0), sigmaX=5) * 38
        canvas.image[region] = np.array(colour, dtype=np.float32) + folds.reshape(1, columns, 1)
        canvas.add(4 * canvas.sample_noise(0.05, region), region)


def _paint_blind(canvas: TextureCanvas, u0: float, v0: float, u1: float, v1: float) -> None:
    """A blind with horizontal slats."""
    region = canvas.find_region(u0, v0, u1, v1)
    rows, columns = canvas.image[region].shape[:2]
    if rows and columns:
        wave = 14 * np.sin(np.arange(rows, dtype=np.float32) * 2 * np.pi / (0.05 * canvas.per_v))
        canvas.image[region] = np.array((188, 186, 178), dtype=np.float32) + wave[:, None, None]
        canvas.add(4 * canvas.sample_noise(0.2, region), region)


def _paint_door(canvas: TextureCanvas, left: float, v: float, right: float, top: float) -> None:
    """A wooden door with panels and a pane."""
    canvas.fill(left, v, right, top, (70, 48, 36))
    region = canvas.find_region(left + 0.07, v, right - 0.07, top - 0.07)
    canvas.image[region] = (112, 68, 44)
    grain = cv2.resize(
        canvas.rng.standard_normal((3, canvas.image[region].shape[1]), dtype=np.float32),
        canvas.image[region].shape[1::-1],
        interpolation=cv2.INTER_CUBIC,
    )
    canvas.add(np.asarray(8 * grain, dtype=np.float32), region)
    centre = (left + right) / 2
    for low, high in ((0.15, 0.85), (0.95, 1.35)):
        for a, b in ((left + 0.16, centre - 0.06), (centre + 0.06, right - 0.16)):
            canvas.fill(a, v + low, b, v + high, (88, 52, 34))
            canvas.fill(a + 0.03, v + low + 0.03, b - 0.03, v + high - 0.03, (124, 78, 50))
    canvas.fill(left + 0.16, v + 1.5, right - 0.16, top - 0.2, (58, 66, 74))
    canvas.fill(right - 0.2, v + 1.0, right - 0.14, v + 1.08, (205, 190, 120))
