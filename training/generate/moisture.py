"""Moisture: damp patches and tide lines, run-off, white salts, mould and algae."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from training.generate.canvas import Canvas, Field, Place, soft, step
from training.generate.spalling import patch_mask

BROWN = np.array([1.35, 1.08, 0.85])  # how much more blue and green than red a damp stain takes away
GREEN = np.array([1.15, 0.8, 1.1])


def damp_patch(canvas: Canvas, place: Place) -> NDArray[np.bool_]:
    """A dark wet cloud with a soft or a sharp edge, often with a brown or white line where it dried."""
    field = patch_mask(canvas, place, rough=canvas.between(0.12, 0.3))
    return _soak(canvas, field, place.y, place.x)


def rising_damp(canvas: Canvas, place: Place) -> NDArray[np.bool_]:
    """Wet from the foot of the wall up to a wavy line."""
    height, width = place.height, place.width
    up = np.linspace(-0.35, 1.0, height, dtype=np.float32)[:, None]
    wave = canvas.noise(8, width, slope=1.6, coarse=1.5)[4][None, :]
    field = up + canvas.between(0.05, 0.2) * wave + canvas.between(0.05, 0.15) * canvas.noise(height, width, slope=1.6)
    along = np.linspace(place.window[2], place.window[3], width, dtype=np.float32)[None, :]
    if canvas.chance(0.7):  # it ends within the picture: higher in the middle
        field = field - np.abs(along) ** np.float32(canvas.between(1.5, 5)) * np.float32(canvas.between(0.5, 1.3))
    return _soak(canvas, np.asarray(field, dtype=np.float32), place.y, place.x)


def _soak(canvas: Canvas, field: Field, y: int, x: int) -> NDArray[np.bool_]:
    """Darken where `field` > 0; the edge is as wide as chance makes it."""
    rng = canvas.rng
    height, width = field.shape
    edge = rng.choice([0.06, 0.15, 0.35, 0.7])
    wet = step(field, edge * 0.4, edge)
    uneven = np.clip(0.8 + 0.25 * canvas.noise(height, width, slope=1.5), 0.25, 1.3)
    loss = np.clip(wet * uneven * canvas.between(0.28, 0.68), 0, 0.92)
    tint = BROWN if canvas.chance(0.6) else (GREEN if canvas.chance(0.35) else np.ones(3))
    mixed = 1 + (tint - 1) * rng.uniform(0.2, 1)
    canvas.multiply(np.clip(1 - loss[..., None] * mixed.astype(np.float32), 0.03, 1.2), y, x)
    if canvas.chance(0.55):
        uneven = np.clip(uneven, 0, 1)
        line = np.exp(-((field / np.float32(rng.uniform(0.02, 0.07))) ** 2)) * uneven
        if canvas.chance(0.5):
            canvas.multiply(1 - line[..., None] * (rng.uniform(0.1, 0.35) * BROWN).astype(np.float32), y, x)
        else:
            _bloom(canvas, line * np.float32(rng.uniform(0.3, 0.9)), y, x)
    if canvas.chance(0.35):
        dots = _specks(canvas, np.clip(wet, 0, 1), round(height * width / rng.uniform(250, 2500)))
        canvas.multiply(1 - dots[..., None] * (rng.uniform(0.4, 0.85) * GREEN).clip(0, 1).astype(np.float32), y, x)
    return np.asarray(wet > 0.4)


def run_off(canvas: Canvas, place: Place) -> NDArray[np.bool_]:
    """Streaks down a wall from a ledge: dark, rusty or green, fading."""
    y, x, height, width = place.y, place.x, place.height, place.width
    rng = canvas.rng
    columns = canvas.noise(4, width, slope=rng.uniform(0.5, 1.1), coarse=rng.uniform(0.7, 2))[2]
    reach = np.clip(0.55 + 0.3 * canvas.noise(4, width, slope=1.1, coarse=1.5)[2], 0.12, 1) * height
    down = np.arange(height, dtype=np.float32)[:, None]
    waver = (canvas.noise(height, width, slope=2.0, coarse=2) * np.float32(rng.uniform(0.3, 1.5))).astype(np.float32)
    streak = np.broadcast_to(np.clip(0.45 + 0.5 * columns, 0, 1.2)[None, :], (height, width)).astype(np.float32)
    xs, ys = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    moved = cv2.remap(streak, xs + waver, ys, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    fade = np.clip(1 - down / reach[None, :], 0, 1) ** rng.uniform(0.4, 1.3)
    sides = np.clip(np.minimum(xs, width - 1 - xs) / max(2.0, 0.06 * width), 0, 1)
    wet = moved * fade * sides * np.clip(0.85 + 0.3 * canvas.noise(height, width, slope=1.0), 0.2, 1.5)
    tint = [np.ones(3), BROWN, GREEN, np.array([1.5, 1.2, 0.5])][rng.choice(4, p=[0.45, 0.25, 0.15, 0.15])]
    if canvas.chance(0.18):
        _bloom(canvas, np.clip(wet, 0, 1) * np.float32(rng.uniform(0.5, 0.9)), y, x)
    else:
        loss = np.clip(wet * rng.uniform(0.4, 0.85), 0, 0.92)
        canvas.multiply(np.clip(1 - loss[..., None] * tint.astype(np.float32), 0.04, 1.2), y, x)
    return np.asarray(soft(np.clip(wet, 0, 1).astype(np.float32), 3) > 0.18)


def salts(canvas: Canvas, place: Place) -> NDArray[np.bool_]:
    """Efflorescence: a white, crusty bloom, thick and thin."""
    y, x, height, width = place.y, place.x, place.height, place.width
    field = patch_mask(canvas, place, rough=canvas.between(0.2, 0.4))
    crust = canvas.noise(height, width, slope=canvas.between(0.7, 1.3))
    cover = step(field + canvas.between(0.1, 0.35) * crust, 0.1, canvas.between(0.15, 0.7))
    _bloom(canvas, cover * np.float32(canvas.between(0.45, 0.95)), y, x)
    return np.asarray(soft(cover, 2) > 0.4)


def mould(canvas: Canvas, place: Place) -> NDArray[np.bool_]:
    """Colonies: many dark or green blots, close in the middle, with a smudge between them."""
    y, x, height, width = place.y, place.x, place.height, place.width
    rng = canvas.rng
    field = patch_mask(canvas, place, rough=canvas.between(0.15, 0.35))
    likely = np.clip(field * canvas.between(0.7, 2) + 0.25, 0, 1)
    blots = _specks(canvas, likely, round(height * width / rng.uniform(60, 420)))
    smudge = step(field, 0.35, 0.9) * np.clip(0.5 + 0.5 * canvas.noise(height, width, slope=1.1), 0, 1)
    cover = np.clip(blots + smudge * np.float32(rng.uniform(0, 0.7)), 0, 1) * np.float32(rng.uniform(0.5, 0.95))
    dark = np.array([[0.03, 0.035, 0.03], [0.02, 0.06, 0.05], [0.02, 0.08, 0.09], [0.05, 0.05, 0.05]])[rng.integers(4)]
    canvas.cover(dark * rng.uniform(0.4, 1.6), cover, y, x)
    return np.asarray(soft(cover, 4) > 0.12)


def _specks(canvas: Canvas, likely: Field, count: int) -> Field:
    """Blurred dots of unlike size, more where `likely`; 0 to 1."""
    rng = canvas.rng
    height, width = likely.shape
    mask = np.zeros((height, width), dtype=np.uint8)
    count = min(count, 1500)
    points = np.stack([rng.integers(0, width, count), rng.integers(0, height, count)], axis=1)
    kept = points[rng.random(count) < likely[points[:, 1], points[:, 0]] ** 1.5]
    size = np.clip(rng.lognormal(np.log(canvas.between(0.8, 2.2)), 0.55, len(kept)), 0.5, 9)
    for (px, py), radius, tone in zip(kept.tolist(), size, rng.integers(110, 256, len(kept)).tolist(), strict=True):
        cv2.circle(mask, (px * 8, py * 8), max(4, round(radius * 8)), tone, -1, cv2.LINE_8, 3)
    ragged = soft(mask, canvas.between(0.5, 1.6))
    return np.asarray(np.clip(ragged * (1 + 0.35 * canvas.noise(height, width, slope=0.7)), 0, 1), dtype=np.float32)


def _bloom(canvas: Canvas, cover: Field, y: int, x: int) -> None:
    """White salts over the surface; its texture stays faintly."""
    height, width = cover.shape
    part = canvas.image[y : y + height, x : x + width]
    own = part.mean(axis=2, keepdims=True)
    white = np.array([0.97, 1, 1.0], dtype=np.float32) * np.float32(min(0.9, 2.2 * float(own.mean()) + 0.12))
    grain = np.clip(1 + 0.1 * canvas.noise(height, width, slope=0.5), 0.5, 1.5)[..., None]
    canvas.cover(white * grain * (0.75 + 0.25 * own / max(1e-3, float(own.mean()))), np.clip(cover, 0, 1), y, x)
