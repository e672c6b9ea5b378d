"""Spalling: a lost surface layer, the rough stuff beneath it, a lit and a shaded rim, rusty bars now and then."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from training.generate.bars import Bars, lay
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
    stretch = np.float32(canvas.between(1, 1.3))
    radius = (np.abs(u) ** power + np.abs(v * stretch) ** power) ** (1 / power)
    large = max(height, width) / 160
    edge = canvas.noise(height, width, slope=1.9, coarse=large) + canvas.noise(height, width, slope=1.3, coarse=large)
    field = 0.78 - radius + rough * edge / max(1e-3, float(edge.std()))
    field -= np.float32(2.5) * np.clip(np.hypot(x, y) - 0.9, 0, 1)
    return np.asarray(field, dtype=np.float32)


def spall(canvas: Canvas, place: Place, *, bars: tuple[Bars, ...], beneath: Field | None) -> NDArray[np.bool_]:
    """Break the surface off in this place; returns where, (height, width).

    `beneath` (height, width, 3) is the wall under a lost plaster; without it broken concrete or stone comes out.
    """
    field = patch_mask(canvas, place, rough=canvas.between(0.16, 0.42))
    sharp = canvas.between(0.015, 0.06)
    lost = step(field, 0, sharp)
    lost = _largest(lost)
    deep = canvas.between(1.5, 7)
    inner = _broken(canvas, place, field, deep) if beneath is None else beneath * _old_mortar(canvas, place)
    for layer in bars:
        lay(canvas, inner, layer)
    inner *= _cast_shadow(canvas, lost, deep)[..., None]
    rim = _ring(canvas, lost)
    canvas.multiply(rim, place.y, place.x)
    canvas.cover(inner, lost, place.y, place.x)
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


def _broken(canvas: Canvas, place: Place, field: Field, deep: float) -> Field:
    """The inside of a hole: pebbles in paste, uneven, in a tone near the wall's or greyer."""
    rng = canvas.rng
    height, width = place.height, place.width
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
    around = canvas.image[place.y : place.y + height, place.x : place.x + width].reshape(-1, 3).mean(axis=0)
    grey = np.array([0.85, 0.97, 1.06]) * float(around.mean())
    mix = canvas.between(0.1, 0.8)
    base = (around * mix + grey * (1 - mix)) * rng.choice([0.55, 0.75, 0.95, 1.25], p=[0.25, 0.3, 0.3, 0.15])
    rough = canvas.noise(height, width, slope=canvas.between(0.9, 1.4))
    inner = inner * base.astype(np.float32) * np.clip(1 + 0.14 * rough, 0.4, 1.7)[..., None]
    bowl = np.clip(field * canvas.between(1.5, 5), 0, 1)
    ground = bumps * np.float32(canvas.between(0.15, 0.7)) + rough * np.float32(canvas.between(0.3, 1.6)) - bowl * deep
    lit = relief(canvas, cv2.GaussianBlur(ground, (0, 0), 0.7), canvas.between(0.25, 0.8))
    return np.asarray(inner * lit[..., None], dtype=np.float32)


def _old_mortar(canvas: Canvas, place: Place) -> Field:
    """What clings to the wall beneath: darker and paler clouds."""
    clouds = canvas.noise(place.height, place.width, slope=1.4)
    return np.asarray(np.clip(canvas.between(0.7, 1.2) * (1 + 0.15 * clouds), 0.4, 1.6)[..., None], dtype=np.float32)
