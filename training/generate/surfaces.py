"""Synthetic walls of brick, plaster, concrete and stone, generated from noise."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array, UInt8Image
from training.generate.canvas import Canvas, Field, blur_mask, compute_ramp, stored_from_linear

SIDE_PX = 640


@dataclass(frozen=True, kw_only=True)
class Background:
    """A surface to draw on: image (h, w, 3: blue, green, red; 8 bit), and `free` (h, w): 255 on walls, 0 elsewhere.

    `brick_px`: width and height of a brick with joints; None without bricks. `corner_px`: a point (x, y) where a head
    joint meets the bed joint of an even course.
    """

    image: UInt8Image
    free: UInt8Image
    kind: str
    brick_px: tuple[float, float] | None = None
    corner_px: tuple[float, float] = (0.0, 0.0)


def _create_canvas(rng: np.random.Generator, colour: Float64Array) -> Canvas:
    angle = rng.uniform(0, 2 * np.pi)
    return Canvas(
        image=np.ones((SIDE_PX, SIDE_PX, 3), dtype=np.float32) * colour.astype(np.float32),
        free=np.ones((SIDE_PX, SIDE_PX), dtype=np.float32),
        rng=rng,
        light=np.array([np.cos(angle), np.sin(angle)]),
    )


def shade_relief(canvas: Canvas, height: Field, strength: float) -> Field:
    """Brightness (h, w) of a surface with heights (h, w) in the light of the canvas: about 1, more towards it."""
    slope_x = cv2.Sobel(height, cv2.CV_32F, 1, 0, ksize=3) / 8
    slope_y = cv2.Sobel(height, cv2.CV_32F, 0, 1, ksize=3) / 8
    towards = -(slope_x * np.float32(canvas.light[0]) + slope_y * np.float32(canvas.light[1]))
    return np.clip(1 + np.float32(strength) * towards, 0.35, 1.8)


def _choose_wall_colour(rng: np.random.Generator) -> Float64Array:
    """A random colour (3,; linear) of plaster or concrete: white, grey, ochre, pale green, pale red, blue grey."""
    tones = np.array([[1, 1, 1], [0.93, 0.98, 1], [0.6, 0.83, 1], [0.82, 1, 0.9], [0.75, 0.82, 1], [1.06, 1, 0.92]])
    tone = tones[int(rng.integers(len(tones)))] * rng.uniform(0.15, 0.75) * rng.normal(1, 0.03, 3)
    return np.asarray(tone, dtype=np.float64)


def generate_plaster(rng: np.random.Generator) -> Background:
    """Generate smooth to rough render with clouds of dirt."""
    canvas = _create_canvas(rng, _choose_wall_colour(rng))
    grain = canvas.sample_noise(SIDE_PX, SIDE_PX, slope=rng.uniform(0.2, 1.1), coarse=rng.uniform(0.8, 3.5))
    canvas.multiply(shade_relief(canvas, grain, rng.choice([0.05, 0.15, 0.35, 0.7])))
    canvas.multiply(1 + np.float32(rng.uniform(0.01, 0.05)) * canvas.sample_noise(SIDE_PX, SIDE_PX, slope=0.3))
    _add_clouds(canvas, rng.uniform(0.01, 0.09))
    return _create_background(canvas, "plaster")


def generate_concrete(rng: np.random.Generator) -> Background:
    """Generate concrete with clouds and pores, sometimes with marks of boards and with tie holes."""
    canvas = _create_canvas(rng, np.array([0.97, 1, 1.02]) * rng.uniform(0.15, 0.55))
    fine = canvas.sample_noise(SIDE_PX, SIDE_PX, slope=0.5, coarse=rng.uniform(1, 2))
    canvas.multiply(1 + np.float32(rng.uniform(0.02, 0.07)) * fine)
    _add_clouds(canvas, rng.uniform(0.04, 0.14))
    pores = np.zeros((SIDE_PX, SIDE_PX), dtype=np.uint8)
    for x, y in rng.integers(0, SIDE_PX, (int(rng.integers(0, 220)), 2)).tolist():
        cv2.circle(pores, (x, y), int(rng.choice([1, 1, 1, 2, 2, 3])), int(rng.integers(60, 255)), -1)
    hole = blur_mask(pores, 0.7)
    canvas.multiply(1 - np.float32(rng.uniform(0.2, 0.6)) * hole)
    if rng.random() < 0.35:
        boards = int(rng.integers(40, 110))
        tone = np.repeat(rng.normal(1, 0.05, SIDE_PX // boards + 2), boards)[:SIDE_PX].astype(np.float32)
        edge = (np.arange(SIDE_PX) % boards < 2).astype(np.float32) * np.float32(rng.uniform(0.05, 0.25))
        field = np.broadcast_to((tone - edge)[:, None], (SIDE_PX, SIDE_PX))
        canvas.multiply(np.ascontiguousarray(field if rng.random() < 0.5 else field.T))
    if rng.random() < 0.35:
        spacing = rng.uniform(120, 300)
        for x in np.arange(rng.uniform(0, spacing), SIDE_PX, spacing):
            for y in np.arange(rng.uniform(0, spacing), SIDE_PX, spacing):
                ring = np.zeros((SIDE_PX, SIDE_PX), dtype=np.uint8)
                cv2.circle(ring, (int(x), int(y)), int(rng.integers(4, 9)), 255, -1)
                canvas.multiply(1 - 0.6 * blur_mask(ring, 1))
    return _create_background(canvas, "concrete")


def generate_bricks(rng: np.random.Generator) -> Background:
    """Generate a brick wall in stretcher bond: bricks of varying tone, recessed joints, worn edges."""
    height = rng.uniform(16, 62)
    width = height * rng.uniform(2.4, 3.6)
    red = rng.random() < 0.7
    colour = (
        np.array([0.12, 0.17, 0.38]) if red else rng.choice([[0.2, 0.4, 0.55], [0.25, 0.27, 0.3], [0.6, 0.62, 0.65]])
    )
    canvas = _create_canvas(rng, np.asarray(colour) * rng.uniform(0.5, 1.4))
    wobble = max(0.4, height / 60)
    ys, xs = np.mgrid[0:SIDE_PX, 0:SIDE_PX].astype(np.float32)
    xs += canvas.sample_noise(SIDE_PX, SIDE_PX, slope=1.2, coarse=2) * np.float32(wobble)
    ys += canvas.sample_noise(SIDE_PX, SIDE_PX, slope=1.2, coarse=2) * np.float32(wobble)
    corner = rng.uniform(0, width), rng.uniform(0, height)
    row = np.floor((ys - corner[1]) / height)
    along = (xs - corner[0]) / width + 0.5 * (row % 2)
    column = np.floor(along)
    joint = rng.uniform(0.07, 0.16) * height
    edge = np.minimum(
        np.minimum((along - column) * width, (1 - along + column) * width),
        np.minimum((ys - corner[1]) % height, height - (ys - corner[1]) % height),
    )
    rough = canvas.sample_noise(SIDE_PX, SIDE_PX, slope=0.8)
    brick = compute_ramp(
        (edge + rough * np.float32(0.05 * height)).astype(np.float32), joint / 2, max(1.2, height * 0.05)
    )
    tone = rng.normal(1, 1, (200, 120, 3)) * [0.04, 0.05, 0.03] + rng.normal(1, rng.uniform(0.06, 0.25), (200, 120, 1))
    number = row.astype(int) % 200, column.astype(int) % 120
    canvas.multiply(np.clip(tone[number], 0.25, 2).astype(np.float32))
    canvas.multiply(1 + np.float32(rng.uniform(0.04, 0.14)) * canvas.sample_noise(SIDE_PX, SIDE_PX, slope=0.7))
    mortar = np.array([0.9, 0.97, 1]) * rng.uniform(0.08, 0.6) * np.ones((SIDE_PX, SIDE_PX, 1))
    mortar *= 1 + 0.1 * canvas.sample_noise(SIDE_PX, SIDE_PX, slope=0.4)[..., None]
    canvas.cover(mortar.astype(np.float32), 1 - brick)
    canvas.multiply(shade_relief(canvas, blur_mask(brick, 0.8) * 4 + rough * 0.25, rng.uniform(0.2, 0.9)))
    _add_clouds(canvas, rng.uniform(0.03, 0.1))
    if rng.random() < 0.2:  # painted over
        canvas.cover(
            _choose_wall_colour(rng) * canvas.image.mean(axis=2, keepdims=True) / canvas.image.mean(), brick * 0 + 0.85
        )
    return _create_background(canvas, "brick", (width, height), corner)


def generate_stones(rng: np.random.Generator) -> Background:
    """Generate ashlar: large blocks of varying tone with narrow joints."""
    canvas = _create_canvas(rng, np.array([0.8, 0.95, 1.05]) * rng.uniform(0.15, 0.5))
    joints = np.zeros((SIDE_PX, SIDE_PX), dtype=np.uint8)
    tone = np.ones((SIDE_PX, SIDE_PX), dtype=np.float32)
    y, course = -int(rng.integers(0, 60)), float(rng.uniform(50, 200))
    spread, thick = rng.uniform(0.03, 0.15), int(rng.integers(1, 7))
    while y < SIDE_PX:
        height = int(course * rng.uniform(0.75, 1.25))
        x = -int(rng.integers(0, 150))
        while x < SIDE_PX:
            length = int(course * rng.uniform(1.0, 2.8))
            tone[max(y, 0) : y + height, max(x, 0) : x + length] = rng.normal(1, spread)
            cv2.rectangle(joints, (x, y), (x + length, y + height), 255, thick)
            x += length
        y += height
    canvas.multiply(np.clip(tone, 0.4, 1.6))
    grain = canvas.sample_noise(SIDE_PX, SIDE_PX, slope=rng.uniform(0.5, 1.2), coarse=rng.uniform(1, 2))
    gap = compute_ramp(blur_mask(joints, 0.8) + 0.06 * grain, 0.5, 0.6)
    canvas.multiply(shade_relief(canvas, grain * 0.6 - gap * 3, rng.uniform(0.1, 0.6)))
    canvas.multiply(1 - gap * np.float32(rng.uniform(-0.3, 0.5)))
    _add_clouds(canvas, rng.uniform(0.04, 0.12))
    return _create_background(canvas, "stone")


def _add_clouds(canvas: Canvas, strength: float) -> None:
    canvas.multiply(np.clip(1 + np.float32(strength) * canvas.sample_noise(SIDE_PX, SIDE_PX, slope=1.6), 0.4, 1.6))


def _create_background(
    canvas: Canvas,
    kind: str,
    brick_px: tuple[float, float] | None = None,
    corner_px: tuple[float, float] = (0.0, 0.0),
) -> Background:
    free = np.full((SIDE_PX, SIDE_PX), 255, dtype=np.uint8)
    return Background(
        image=stored_from_linear(canvas.image), free=free, kind=kind, brick_px=brick_px, corner_px=corner_px
    )
