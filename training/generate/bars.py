"""Exposed reinforcement: rusty bars, their shadows, and stains of rust."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from training.generate.canvas import Canvas, Field, compute_ramp


@dataclass(frozen=True, kw_only=True)
class Bars:
    """Parallel bars: `upright` or level, number, thickness (px), spacing (px), and inclination (px per px)."""

    upright: bool
    count: int
    thick_px: float
    apart_px: float
    lean: float


def choose_bars(rng: np.random.Generator, height: int, width: int) -> tuple[Bars, ...]:
    """Choose bars for a hole of this size: one along a narrow hole, several or a mesh in a wide one."""
    upright = bool(height > width if max(height, width) > 2.2 * min(height, width) else rng.random() < 0.5)
    narrow = max(height, width) > 2.2 * min(height, width) and rng.random() < 0.75
    if narrow:
        thick = float(np.clip(min(height, width) * rng.uniform(0.15, 0.5), 2, 26))
        return (Bars(upright=upright, count=1, thick_px=thick, apart_px=0, lean=rng.normal(0, 0.03)),)
    thick = float(np.clip(min(height, width) * rng.uniform(0.03, 0.13), 2, 24))
    apart = thick * rng.uniform(2.2, 9)
    lean = float(rng.normal(0, 0.1) if rng.random() < 0.75 else rng.uniform(-0.7, 0.7))
    span = width if upright else height
    count = 1 if rng.random() < 0.3 else int(np.clip(span / apart * 0.9, 1, 12))
    first = Bars(upright=upright, count=count, thick_px=thick, apart_px=apart, lean=lean)
    if rng.random() < 0.6:
        return (first,)
    other = apart * rng.uniform(0.8, 3)
    across = int(np.clip((height if upright else width) / other * 0.9, 1, 12))
    return (
        first,
        Bars(upright=not upright, count=across, thick_px=thick * rng.uniform(0.5, 1.0), apart_px=other, lean=-lean),
    )


def paint_bars(canvas: Canvas, inner: Field, bars: Bars) -> None:
    """Paint the bars on the inside of the hole (h, w, 3), which is changed in place."""
    rng = canvas.rng
    height, width = inner.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    across, span = (x + bars.lean * y, width) if bars.upright else (y + bars.lean * x, height)
    across = across + canvas.sample_noise(height, width, slope=2.2, coarse=1.5) * np.float32(bars.thick_px * 0.2)
    base = float(inner.mean())
    kind = rng.choice(3, p=[0.5, 0.3, 0.2])  # brown, nearly black, orange
    rust = np.array([[0.35, 0.55, 0.95], [0.5, 0.6, 0.7], [0.25, 0.6, 1.5]])[kind] * base * rng.uniform(0.15, 0.6)
    patina = canvas.sample_noise(height, width, slope=0.9)
    ribs = 1 + rng.choice([0, 0.12, 0.25]) * np.sin(
        (y if bars.upright else x) * np.float32(6.3 / (0.6 * bars.thick_px))
    )
    first = (span - (bars.count - 1) * bars.apart_px) * rng.uniform(0.25, 0.75)
    shaded = np.float32(rng.uniform(-0.9, 0.9))
    for number in range(bars.count):
        centre = first + number * bars.apart_px + rng.normal(0, 0.06) * bars.apart_px
        offset = (across - np.float32(centre)) / np.float32(bars.thick_px / 2)
        whole = compute_ramp(np.asarray(1 - np.abs(offset), dtype=np.float32), 0.05, max(0.3, 2 / bars.thick_px))
        bar = whole * compute_ramp(
            np.asarray(patina + np.float32(2.2), dtype=np.float32), 0.5, 0.8
        )  # partly still covered
        shade = compute_ramp(np.asarray(1 - np.abs(offset - shaded) / 1.6, dtype=np.float32), 0, 0.8)
        stain = np.exp(-np.abs(offset) / np.float32(rng.uniform(1, 3))) * np.clip(0.5 + 0.4 * patina, 0, 1)
        take = rng.uniform(0.1, 0.6) * np.array([1, 0.75, 0.35])
        inner *= 1 - stain[..., None] * take.astype(np.float32)
        inner *= 1 - 0.6 * shade[..., None]
        round_ = np.sqrt(np.clip(1 - offset**2, 0.05, 1)) * np.clip(1 + 0.35 * patina, 0.3, 2) * ribs
        inner += bar[..., None] * (round_[..., None] * rust.astype(np.float32) - inner)
