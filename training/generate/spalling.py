"""Spalling: a lost surface layer, the rough stuff beneath it, a lit and a shaded rim, rusty bars now and then."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from training.generate.canvas import Canvas, Field, Place, soft, step
from training.generate.surfaces import relief

RUBBLE_PX = 640
RUBBLES = 8


@cache
def _rubble(number: int) -> tuple[Field, Field]:
    """Broken concrete: pebbles in paste. Returns tone (h, w, 3) about 1 and height (h, w) of a few pixels."""
    rng = np.random.default_rng((7, number))
    seeds = np.full((RUBBLE_PX, RUBBLE_PX), 255, dtype=np.uint8)
    count = int(rng.uniform(500, 6000))
    points = rng.integers(0, RUBBLE_PX, (count, 2))
    seeds[points[:, 1], points[:, 0]] = 0
    distance, labels = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    radius = np.sqrt(RUBBLE_PX**2 / count / np.pi)
    size = rng.lognormal(-0.35, 0.45, labels.max() + 1).astype(np.float32)[labels] * np.float32(radius)
    stone = step(1 - distance / size, 0.18, 0.25)
    tone = rng.normal(1, 0.2, (labels.max() + 1, 1)) + rng.normal(0, 0.035, (labels.max() + 1, 3))
    paste = np.asarray(rng.normal(0.95, 0.04, 3), dtype=np.float32)
    colour = stone[..., None] * np.clip(tone, 0.4, 1.7).astype(np.float32)[labels] + (1 - stone[..., None]) * paste
    dome = np.sqrt(np.clip(1 - (distance / size) ** 2, 0, 1)) * np.minimum(size, 9)
    return np.asarray(colour, dtype=np.float32), np.asarray(dome, dtype=np.float32)


def patch_mask(canvas: Canvas, place: Place, *, rough: float) -> Field:
    """An irregular patch that nearly fills its place: negative outside, positive inside, about 1 deep inside."""
    height, width = place.height, place.width
    top, bottom, left, right = place.window
    y, x = np.mgrid[top : bottom : height * 1j, left : right : width * 1j].astype(np.float32)
    power = np.float32(canvas.between(1.6, 3.5))
    angle = np.float32(canvas.between(0, np.pi))
    u, v = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
    stretch = np.float32(canvas.between(1, 1.5))
    radius = (np.abs(u) ** power + np.abs(v * stretch) ** power) ** (1 / power)
    large = max(height, width) / 160
    edge = canvas.noise(height, width, slope=1.9, coarse=large) + canvas.noise(height, width, slope=1.3, coarse=large)
    field = 0.68 - radius + rough * edge / max(1e-3, float(edge.std()))
    field -= np.float32(2.5) * np.clip(np.hypot(x, y) - 0.9, 0, 1)
    return np.asarray(field, dtype=np.float32)


def spall(canvas: Canvas, place: Place, *, bars: int) -> NDArray[np.bool_]:
    """Break the surface off in this place; returns where, (height, width)."""
    rng = canvas.rng
    y, x, height, width = place.y, place.x, place.height, place.width
    field = patch_mask(canvas, place, rough=canvas.between(0.16, 0.42))
    sharp = canvas.between(0.015, 0.06)
    lost = step(field, 0, sharp)
    lost = _largest(lost)
    tone, dome = _rubble(int(rng.integers(RUBBLES)))
    scale = canvas.between(0.45, 1.6)
    need = round(height / scale) + 2, round(width / scale) + 2
    if max(need) > RUBBLE_PX:
        scale *= max(need) / RUBBLE_PX
        need = min(RUBBLE_PX, need[0]), min(RUBBLE_PX, need[1])
    at = int(rng.integers(RUBBLE_PX - need[0] + 1)), int(rng.integers(RUBBLE_PX - need[1] + 1))
    part = slice(at[0], at[0] + need[0]), slice(at[1], at[1] + need[1])
    inner = cv2.resize(tone[part], (width, height), interpolation=cv2.INTER_LINEAR)
    bumps = cv2.resize(dome[part], (width, height), interpolation=cv2.INTER_LINEAR)
    around = canvas.image[y : y + height, x : x + width].reshape(-1, 3).mean(axis=0)
    grey = np.array([0.85, 0.97, 1.06]) * float(around.mean())
    mix = canvas.between(0.1, 0.8)
    base = (around * mix + grey * (1 - mix)) * rng.choice([0.55, 0.75, 0.95, 1.25], p=[0.25, 0.3, 0.3, 0.15])
    rough = canvas.noise(height, width, slope=canvas.between(0.9, 1.4))
    inner = inner * base.astype(np.float32) * np.clip(1 + 0.14 * rough, 0.4, 1.7)[..., None]
    deep = canvas.between(1.5, 7)
    bowl = np.clip(field * canvas.between(1.5, 5), 0, 1)
    ground = bumps * np.float32(canvas.between(0.15, 0.7)) + rough * np.float32(canvas.between(0.3, 1.6)) - bowl * deep
    inner *= relief(canvas, cv2.GaussianBlur(ground, (0, 0), 0.7), canvas.between(0.25, 0.8))[..., None]
    if bars:
        _bars(canvas, inner, bars)
    inner *= _cast_shadow(canvas, lost, deep)[..., None]
    rim = _ring(canvas, lost)
    canvas.multiply(rim, y, x)
    canvas.cover(inner, lost, y, x)
    return np.asarray(lost > 0.5)


def _largest(lost: Field) -> Field:
    """The largest piece and such pieces as are not crumbs, so that a box round all is what a person would draw."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((lost > 0.5).astype(np.uint8))
    if count <= 2:
        return lost
    area = stats[1:, cv2.CC_STAT_AREA]
    keep = np.concatenate([[False], area == area.max()])
    return np.asarray(lost * cv2.dilate(keep[labels].astype(np.float32), np.ones((5, 5), np.uint8)), dtype=np.float32)


def _cast_shadow(canvas: Canvas, lost: Field, deep: float) -> Field:
    """The rim on the lamp's side throws a shadow into the hole."""
    dx, dy = -canvas.light * deep * canvas.between(0.6, 1.4)
    moved = cv2.warpAffine(lost, np.array([[1, 0, dx], [0, 1, dy]]), (lost.shape[1], lost.shape[0]))
    shadow = soft(np.clip(lost - moved, 0, 1), canvas.between(0.5, 1.6))
    return np.asarray(1 - canvas.between(0.3, 0.8) * shadow, dtype=np.float32)


def _ring(canvas: Canvas, lost: Field) -> Field:
    """The skin beside the hole: a lit edge, dust or dirt."""
    near = np.clip(soft(lost, canvas.between(1, 4)) - lost, 0, 1)
    lit = relief(canvas, -soft(lost, 0.8) * 3, canvas.between(0.1, 0.6))
    return np.asarray(lit * (1 + canvas.between(-0.5, 0.35) * near), dtype=np.float32)


def _bars(canvas: Canvas, inner: Field, bars: int) -> None:
    """Rusty reinforcement across the hole, with its shadow and the rust that ran from it."""
    rng = canvas.rng
    height, width = inner.shape[:2]
    upright = rng.random() < 0.5
    lean = rng.normal(0, 0.12) if rng.random() < 0.75 else rng.uniform(-0.8, 0.8)
    thick = max(2.0, min(height, width) * rng.uniform(0.03, 0.11))
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    across, span = (x + lean * y, width) if upright else (y + lean * x, height)
    across = across + canvas.noise(height, width, slope=2.2, coarse=1.5) * np.float32(thick * 0.35)
    base = float(inner.mean())
    rust = (
        np.array([0.55, 0.8, 1.3]) * base * rng.uniform(0.12, 0.5)
        + np.array([0.0, 0.03, 0.08]) * rng.choice([0, 0, 1]) * base
    )
    patina = canvas.noise(height, width, slope=0.9)
    first = rng.uniform(0.15, 0.6) * span
    for number in range(bars):
        centre = first + number * span * rng.uniform(0.16, 0.4)
        offset = (across - np.float32(centre)) / np.float32(thick / 2)
        bar = step(1 - np.abs(offset), 0.05, 0.3)
        shade = step(1 - np.abs(offset - np.float32(rng.uniform(-0.9, 0.9))) / 1.5, 0, 0.8)
        stain = np.exp(-np.abs(offset) / np.float32(rng.uniform(1.5, 4))) * np.clip(0.5 + 0.4 * patina, 0, 1)
        inner *= 1 - np.float32(rng.uniform(0.1, 0.6)) * stain[..., None] * np.array([1, 0.75, 0.3], dtype=np.float32)
        inner *= 1 - 0.55 * shade[..., None]
        round_ = np.sqrt(np.clip(1 - offset**2, 0.05, 1)) * np.clip(1 + 0.35 * patina, 0.3, 2)
        inner += bar[..., None] * (round_[..., None] * rust.astype(np.float32) - inner)
