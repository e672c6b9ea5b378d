"""Spalling: a lost surface layer with the rough material beneath, a lit and a shaded rim, and sometimes rusty bars."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray
from training.generate.bars import Bars, paint_bars
from training.generate.canvas import Canvas, Field, Place, blur_mask, compute_ramp
from training.generate.surfaces import shade_relief

RUBBLE_PX = 640
RUBBLES = 8


@cache
def _generate_rubble(number: int) -> tuple[Field, Field]:
    """Broken concrete, aggregate in cement paste: tone (h, w, 3) of about 1 and height (h, w) of a few pixels."""
    rng = np.random.default_rng((7, number))
    seeds = np.full((RUBBLE_PX, RUBBLE_PX), 255, dtype=np.uint8)
    count = int(rng.uniform(500, 6000))
    points = rng.integers(0, RUBBLE_PX, (count, 2))
    seeds[points[:, 1], points[:, 0]] = 0
    distance, labels = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    radius = np.sqrt(RUBBLE_PX**2 / count / np.pi)
    size = rng.lognormal(-0.35, 0.45, labels.max() + 1).astype(np.float32)[labels] * np.float32(radius)
    stone = compute_ramp(1 - distance / size, 0.18, 0.25)
    tone = rng.normal(1, 0.2, (labels.max() + 1, 1)) + rng.normal(0, 0.035, (labels.max() + 1, 3))
    paste = np.asarray(rng.normal(0.95, 0.04, 3), dtype=np.float32)
    colour = stone[..., None] * np.clip(tone, 0.4, 1.7).astype(np.float32)[labels] + (1 - stone[..., None]) * paste
    dome = np.sqrt(np.clip(1 - (distance / size) ** 2, 0, 1)) * np.minimum(size, 9)
    return np.asarray(colour, dtype=np.float32), np.asarray(dome, dtype=np.float32)


def generate_patch_field(canvas: Canvas, place: Place, *, rough: float) -> Field:
    """Field (h, w) of an irregular patch: negative outside, about 1 in the centre; `rough`: roughness of its edge."""
    height, width = place.height, place.width
    top, bottom, left, right = place.window
    y, x = np.mgrid[top : bottom : height * 1j, left : right : width * 1j].astype(np.float32)
    power = np.float32(canvas.draw_uniform(1.6, 3.5))
    angle = np.float32(canvas.draw_uniform(0, np.pi))
    u, v = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
    stretch = np.float32(canvas.draw_uniform(1, 1.3))
    radius = (np.abs(u) ** power + np.abs(v * stretch) ** power) ** (1 / power)
    large = max(height, width) / 160
    edge = canvas.sample_noise(height, width, slope=1.9, coarse=large) + canvas.sample_noise(
        height, width, slope=1.3, coarse=large
    )
    field = 0.78 - radius + rough * edge / max(1e-3, float(edge.std()))
    field -= np.float32(2.5) * np.clip(np.hypot(x, y) - 0.9, 0, 1)
    return np.asarray(field, dtype=np.float32)


def paint_spalling(canvas: Canvas, place: Place, *, bars: tuple[Bars, ...], beneath: Field | None) -> BoolArray:
    """Paint spalling.

    Args:
        canvas: the picture.
        place: location of the patch.
        bars: bars that are exposed.
        beneath: wall (h, w, 3) under lost plaster; None for broken concrete or stone.

    Returns:
        Mask (h, w) of the lost surface.
    """
    field = generate_patch_field(canvas, place, rough=canvas.draw_uniform(0.16, 0.42))
    sharp = canvas.draw_uniform(0.015, 0.06)
    lost = compute_ramp(field, 0, sharp)
    lost = _keep_largest(lost)
    deep = canvas.draw_uniform(1.5, 7)
    inner = (
        _render_broken_surface(canvas, place, field, deep)
        if beneath is None
        else beneath * _generate_mortar_tone(canvas, place)
    )
    for layer in bars:
        paint_bars(canvas, inner, layer)
    inner *= _compute_shadow(canvas, lost, deep)[..., None]
    rim = _compute_rim(canvas, lost)
    canvas.multiply(rim, place.y, place.x)
    canvas.cover(inner, lost, place.y, place.x)
    return np.asarray(lost > 0.5)


def _keep_largest(lost: Field) -> Field:
    """Keep the largest component of the lost surface (h, w), so that it has one box."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((lost > 0.5).astype(np.uint8))
    if count <= 2:
        return lost
    area = stats[1:, cv2.CC_STAT_AREA]
    keep = np.concatenate([[False], area == area.max()])
    return np.asarray(lost * cv2.dilate(keep[labels].astype(np.float32), np.ones((5, 5), np.uint8)), dtype=np.float32)


def _compute_shadow(canvas: Canvas, lost: Field, deep: float) -> Field:
    """Factor (h, w) of the shadow of the rim inside the hole."""
    dx, dy = -canvas.light * deep * canvas.draw_uniform(0.6, 1.4)
    moved = cv2.warpAffine(lost, np.array([[1, 0, dx], [0, 1, dy]]), (lost.shape[1], lost.shape[0]))
    shadow = blur_mask(np.clip(lost - moved, 0, 1), canvas.draw_uniform(0.5, 1.6))
    return np.asarray(1 - canvas.draw_uniform(0.3, 0.8) * shadow, dtype=np.float32)


def _compute_rim(canvas: Canvas, lost: Field) -> Field:
    """Factor (h, w) of the surface beside the hole: a lit edge, dust or dirt."""
    near = np.clip(blur_mask(lost, canvas.draw_uniform(1, 4)) - lost, 0, 1)
    lit = shade_relief(canvas, -blur_mask(lost, 0.8) * 3, canvas.draw_uniform(0.1, 0.6))
    return np.asarray(lit * (1 + canvas.draw_uniform(-0.5, 0.35) * near), dtype=np.float32)


def _render_broken_surface(canvas: Canvas, place: Place, field: Field, deep: float) -> Field:
    """Inside of a hole (h, w, 3): broken concrete in a tone between that of the wall and grey."""
    rng = canvas.rng
    height, width = place.height, place.width
    tone, dome = _generate_rubble(int(rng.integers(RUBBLES)))
    scale = canvas.draw_uniform(0.45, 1.6)
    need = round(height / scale) + 2, round(width / scale) + 2
    if max(need) > RUBBLE_PX:
        scale *= max(need) / RUBBLE_PX
        need = min(RUBBLE_PX, need[0]), min(RUBBLE_PX, need[1])
    at = int(rng.integers(RUBBLE_PX - need[0] + 1)), int(rng.integers(RUBBLE_PX - need[1] + 1))
    part = slice(at[0], at[0] + need[0]), slice(at[1], at[1] + need[1])
    inner = cv2.resize(tone[part], (width, height), interpolation=cv2.INTER_LINEAR)
    bumps = cv2.resize(dome[part], (width, height), interpolation=cv2.INTER_LINEAR)
    around = canvas.image[place.y : place.y + height, place.x : place.x + width].reshape(-1, 3).mean(axis=0)
    grey = np.array([0.85, 0.97, 1.06]) * float(around.mean())
    mix = canvas.draw_uniform(0.1, 0.8)
    base = (around * mix + grey * (1 - mix)) * rng.choice([0.55, 0.75, 0.95, 1.25], p=[0.25, 0.3, 0.3, 0.15])
    rough = canvas.sample_noise(height, width, slope=canvas.draw_uniform(0.9, 1.4))
    inner = inner * base.astype(np.float32) * np.clip(1 + 0.14 * rough, 0.4, 1.7)[..., None]
    bowl = np.clip(field * canvas.draw_uniform(1.5, 5), 0, 1)
    height_field = (
        bumps * np.float32(canvas.draw_uniform(0.15, 0.7))
        + rough * np.float32(canvas.draw_uniform(0.3, 1.6))
        - bowl * deep
    )
    lit = shade_relief(canvas, cv2.GaussianBlur(height_field, (0, 0), 0.7), canvas.draw_uniform(0.25, 0.8))
    return np.asarray(inner * lit[..., None], dtype=np.float32)


def _generate_mortar_tone(canvas: Canvas, place: Place) -> Field:
    """Factor (h, w, 1) of remains of mortar on the wall beneath."""
    clouds = canvas.sample_noise(place.height, place.width, slope=1.4)
    return np.asarray(
        np.clip(canvas.draw_uniform(0.7, 1.2) * (1 + 0.15 * clouds), 0.4, 1.6)[..., None], dtype=np.float32
    )
