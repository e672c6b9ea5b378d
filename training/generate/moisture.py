"""Moisture: damp patches with tide marks, rising damp, run-off, efflorescence, mould and algae."""

from __future__ import annotations

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray
from training.generate.canvas import Canvas, Field, Place, blur_mask, compute_ramp
from training.generate.spalling import generate_patch_field

BROWN = np.array([1.35, 1.08, 0.85])  # relative loss of blue, green and red in a brown stain
GREEN = np.array([1.15, 0.8, 1.1])


def paint_damp_patch(canvas: Canvas, place: Place) -> BoolArray:
    """Paint a damp patch with a soft or sharp edge, often with a brown or white tide mark; returns its mask (h, w)."""
    field = generate_patch_field(canvas, place, rough=canvas.draw_uniform(0.12, 0.3))
    return _paint_wet_area(canvas, field, place.y, place.x)


def paint_rising_damp(canvas: Canvas, place: Place) -> BoolArray:
    """Paint rising damp up to a wavy line; returns its mask (h, w)."""
    height, width = place.height, place.width
    up = np.linspace(-0.35, 1.0, height, dtype=np.float32)[:, None]
    wave = canvas.sample_noise(8, width, slope=1.6, coarse=1.5)[4][None, :]
    field = (
        up
        + canvas.draw_uniform(0.05, 0.2) * wave
        + canvas.draw_uniform(0.05, 0.15) * canvas.sample_noise(height, width, slope=1.6)
    )
    along = np.linspace(place.window[2], place.window[3], width, dtype=np.float32)[None, :]
    if canvas.draw_bernoulli(0.7):  # limited within the picture: higher in the centre
        field = field - np.abs(along) ** np.float32(canvas.draw_uniform(1.5, 5)) * np.float32(
            canvas.draw_uniform(0.5, 1.3)
        )
    return _paint_wet_area(canvas, np.asarray(field, dtype=np.float32), place.y, place.x)


def _paint_wet_area(canvas: Canvas, field: Field, y: int, x: int) -> BoolArray:
    """Darken the area where `field` (h, w) is positive, with an edge of random width; returns its mask (h, w)."""
    rng = canvas.rng
    height, width = field.shape
    edge = rng.choice([0.06, 0.15, 0.35, 0.7])
    wet = compute_ramp(field, edge * 0.4, edge)
    uneven = np.clip(0.8 + 0.25 * canvas.sample_noise(height, width, slope=1.5), 0.25, 1.3)
    loss = np.clip(wet * uneven * canvas.draw_uniform(0.28, 0.68), 0, 0.92)
    tint = BROWN if canvas.draw_bernoulli(0.6) else (GREEN if canvas.draw_bernoulli(0.35) else np.ones(3))
    mixed = 1 + (tint - 1) * rng.uniform(0.2, 1)
    canvas.multiply(np.clip(1 - loss[..., None] * mixed.astype(np.float32), 0.03, 1.2), y, x)
    if canvas.draw_bernoulli(0.55):
        uneven = np.clip(uneven, 0, 1)
        line = np.exp(-((field / np.float32(rng.uniform(0.02, 0.07))) ** 2)) * uneven
        if canvas.draw_bernoulli(0.5):
            canvas.multiply(1 - line[..., None] * (rng.uniform(0.1, 0.35) * BROWN).astype(np.float32), y, x)
        else:
            _paint_salts(canvas, line * np.float32(rng.uniform(0.3, 0.9)), y, x)
    if canvas.draw_bernoulli(0.35):
        dots = _generate_specks(canvas, np.clip(wet, 0, 1), round(height * width / rng.uniform(250, 2500)))
        canvas.multiply(1 - dots[..., None] * (rng.uniform(0.4, 0.85) * GREEN).clip(0, 1).astype(np.float32), y, x)
    return np.asarray(wet > 0.4)


def paint_run_off(canvas: Canvas, place: Place) -> BoolArray:
    """Paint streaks of run-off below a ledge: dark, rusty or green, decreasing downwards; returns their mask (h, w)."""
    y, x, height, width = place.y, place.x, place.height, place.width
    rng = canvas.rng
    columns = canvas.sample_noise(4, width, slope=rng.uniform(0.5, 1.1), coarse=rng.uniform(0.7, 2))[2]
    reach = np.clip(0.55 + 0.3 * canvas.sample_noise(4, width, slope=1.1, coarse=1.5)[2], 0.12, 1) * height
    down = np.arange(height, dtype=np.float32)[:, None]
    waver = (canvas.sample_noise(height, width, slope=2.0, coarse=2) * np.float32(rng.uniform(0.3, 1.5))).astype(
        np.float32
    )
    streak = np.broadcast_to(np.clip(0.45 + 0.5 * columns, 0, 1.2)[None, :], (height, width)).astype(np.float32)
    xs, ys = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    moved = cv2.remap(streak, xs + waver, ys, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    fade = np.clip(1 - down / reach[None, :], 0, 1) ** rng.uniform(0.4, 1.3)
    sides = np.clip(np.minimum(xs, width - 1 - xs) / max(2.0, 0.06 * width), 0, 1)
    wet = moved * fade * sides * np.clip(0.85 + 0.3 * canvas.sample_noise(height, width, slope=1.0), 0.2, 1.5)
    tint = [np.ones(3), BROWN, GREEN, np.array([1.5, 1.2, 0.5])][rng.choice(4, p=[0.45, 0.25, 0.15, 0.15])]
    if canvas.draw_bernoulli(0.18):
        _paint_salts(canvas, np.clip(wet, 0, 1) * np.float32(rng.uniform(0.5, 0.9)), y, x)
    else:
        loss = np.clip(wet * rng.uniform(0.4, 0.85), 0, 0.92)
        canvas.multiply(np.clip(1 - loss[..., None] * tint.astype(np.float32), 0.04, 1.2), y, x)
    return np.asarray(blur_mask(np.clip(wet, 0, 1).astype(np.float32), 3) > 0.18)


def paint_efflorescence(canvas: Canvas, place: Place) -> BoolArray:
    """Paint efflorescence: a white crust of varying thickness; returns its mask (h, w)."""
    y, x, height, width = place.y, place.x, place.height, place.width
    field = generate_patch_field(canvas, place, rough=canvas.draw_uniform(0.2, 0.4))
    crust = canvas.sample_noise(height, width, slope=canvas.draw_uniform(0.7, 1.3))
    cover = compute_ramp(field + canvas.draw_uniform(0.1, 0.35) * crust, 0.1, canvas.draw_uniform(0.15, 0.7))
    _paint_salts(canvas, cover * np.float32(canvas.draw_uniform(0.45, 0.95)), y, x)
    return np.asarray(blur_mask(cover, 2) > 0.4)


def paint_mould(canvas: Canvas, place: Place) -> BoolArray:
    """Paint mould: dark or green specks, dense in the centre, with a stain between them; returns its mask (h, w)."""
    y, x, height, width = place.y, place.x, place.height, place.width
    rng = canvas.rng
    field = generate_patch_field(canvas, place, rough=canvas.draw_uniform(0.15, 0.35))
    likely = np.clip(field * canvas.draw_uniform(0.7, 2) + 0.25, 0, 1)
    blots = _generate_specks(canvas, likely, round(height * width / rng.uniform(60, 420)))
    smudge = compute_ramp(field, 0.35, 0.9) * np.clip(0.5 + 0.5 * canvas.sample_noise(height, width, slope=1.1), 0, 1)
    cover = np.clip(blots + smudge * np.float32(rng.uniform(0, 0.7)), 0, 1) * np.float32(rng.uniform(0.5, 0.95))
    dark = np.array([[0.03, 0.035, 0.03], [0.02, 0.06, 0.05], [0.02, 0.08, 0.09], [0.05, 0.05, 0.05]])[rng.integers(4)]
    canvas.cover(dark * rng.uniform(0.4, 1.6), cover, y, x)
    return np.asarray(blur_mask(cover, 4) > 0.12)


def _generate_specks(canvas: Canvas, likely: Field, count: int) -> Field:
    """Blurred dots of varying size, 0 to 1, with a density that increases with `likely` (h, w; 0 to 1)."""
    rng = canvas.rng
    height, width = likely.shape
    mask = np.zeros((height, width), dtype=np.uint8)
    count = min(count, 1500)
    points = np.stack([rng.integers(0, width, count), rng.integers(0, height, count)], axis=1)
    kept = points[rng.random(count) < likely[points[:, 1], points[:, 0]] ** 1.5]
    size = np.clip(rng.lognormal(np.log(canvas.draw_uniform(0.8, 2.2)), 0.55, len(kept)), 0.5, 9)
    for (px, py), radius, tone in zip(kept.tolist(), size, rng.integers(110, 256, len(kept)).tolist(), strict=True):
        cv2.circle(mask, (px * 8, py * 8), max(4, round(radius * 8)), tone, -1, cv2.LINE_8, 3)
    ragged = blur_mask(mask, canvas.draw_uniform(0.5, 1.6))
    return np.asarray(
        np.clip(ragged * (1 + 0.35 * canvas.sample_noise(height, width, slope=0.7)), 0, 1), dtype=np.float32
    )


def _paint_salts(canvas: Canvas, cover: Field, y: int, x: int) -> None:
    """Paint white salts with coverage `cover` (h, w); the texture of the surface remains faintly visible."""
    height, width = cover.shape
    part = canvas.image[y : y + height, x : x + width]
    own = part.mean(axis=2, keepdims=True)
    white = np.array([0.97, 1, 1.0], dtype=np.float32) * np.float32(min(0.9, 2.2 * float(own.mean()) + 0.12))
    grain = np.clip(1 + 0.1 * canvas.sample_noise(height, width, slope=0.5), 0.5, 1.5)[..., None]
    canvas.cover(white * grain * (0.75 + 0.25 * own / max(1e-3, float(own.mean()))), np.clip(cover, 0, 1), y, x)
