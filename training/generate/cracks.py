"""Cracks: irregular lines with branches, stepped lines along joints, and map cracking."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from facadelake.core.arrays import Float64Nx2, UInt8Image
from training.generate.canvas import Canvas, Field, blur_mask

FINE = 3  # resolution of the mask, relative to that of the picture


def generate_fractal_line(
    rng: np.random.Generator, start: Float64Nx2, end: Float64Nx2, rough: float, step_px: float = 2.5
) -> Float64Nx2:
    """Generate a fractal line between two points by midpoint displacement.

    Args:
        rng: random generator.
        start: first point (2,), px.
        end: last point (2,), px.
        rough: standard deviation of the first displacement as a share of the length; that of each further one is about
            0.6 of the previous.
        step_px: largest distance of consecutive points.

    Returns:
        Points (n, 2): x, y.
    """
    points = np.stack([start, end]).astype(np.float64)
    scale = rough * float(np.linalg.norm(end - start))
    decay = rng.uniform(0.52, 0.68)
    while np.linalg.norm(points[1] - points[0]) > step_px and len(points) < 600:
        middle = (points[:-1] + points[1:]) / 2
        along = points[1:] - points[:-1]
        normal = (
            np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(np.linalg.norm(along, axis=1), 1e-6)[:, None]
        )
        middle += normal * rng.normal(0, scale, (len(middle), 1))
        merged = np.empty((len(points) + len(middle), 2))
        merged[0::2], merged[1::2] = points, middle
        points, scale = merged, scale * decay
    return points


def generate_stepped_line(
    rng: np.random.Generator, corner: tuple[float, float], brick_px: tuple[float, float], side_px: int
) -> Float64Nx2:
    """Generate a stepped line down a brick wall in stretcher bond along bed and head joints.

    Args:
        rng: random generator.
        corner: a point (x, y) where a head joint meets the bed joint of an even course, px.
        brick_px: width and height of a brick with joints.
        side_px: width and height of the picture.

    Returns:
        Points (n, 2): x, y.
    """
    width, height = brick_px
    aside = rng.choice([-1, 1])
    row = int(np.floor((rng.uniform(-0.2, 0.5) * side_px - corner[1]) / height))
    x = rng.uniform(0.1, 0.9) * side_px
    points = [np.array([x, corner[1] + row * height])]
    for _ in range(int(rng.integers(4, 18))):
        if rng.random() < 0.15:
            aside = -aside
        first = corner[0] + 0.5 * (row % 2) * width
        number = np.floor((x - first) / width + 0.02 * aside) + (aside > 0)
        x = first + number * width
        points.append(np.array([x, points[-1][1]]))
        down = int(rng.choice([1, 1, 1, 1, 2]))  # 2: the crack continues through the brick below
        row += down
        points.append(np.array([x, points[-1][1] + down * height]))
        if not (-10 < x < side_px + 10 and points[-1][1] < side_px + 10):
            break
    return np.concatenate([generate_fractal_line(rng, a, b, 0.025) for a, b in pairwise(points)])


def draw_path(
    rng: np.random.Generator, mask: UInt8Image, path: Float64Nx2, width_px: float, taper: tuple[bool, bool]
) -> None:
    """Draw a line of varying width.

    Args:
        rng: random generator.
        mask: mask (side * FINE, side * FINE) to draw in.
        path: points (n, 2), pixels of the picture.
        width_px: mean width, pixels of the picture.
        taper: whether the line narrows at its start and at its end.
    """
    n = len(path)
    wave = np.interp(np.linspace(0, 1, n), np.linspace(0, 1, max(4, n // 8)), rng.normal(0, 0.35, max(4, n // 8)))
    width = width_px * np.exp(wave + rng.normal(0, 0.22, n))
    ramp = np.linspace(0, 1, n)
    if taper[0]:
        width *= np.clip(ramp * 3, 0.12, 1)
    if taper[1]:
        width *= np.clip((1 - ramp) * 3, 0.12, 1)
    fine = np.round(path * FINE).astype(np.int32)
    thick = np.maximum(1, np.round(width * FINE)).astype(np.int32)
    for a, b, t in zip(fine[:-1].tolist(), fine[1:].tolist(), thick.tolist(), strict=False):
        cv2.line(mask, a, b, 255, t)


def draw_line(rng: np.random.Generator, mask: UInt8Image, side: int, width: float) -> None:
    """Draw a crack across all or part of the picture with up to three branches."""
    angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)]) + rng.normal(0, 0.12)
    long = rng.random() < 0.65
    reach = side * (1.6 if long else rng.uniform(0.15, 0.6))
    middle = rng.uniform(0.15, 0.85, 2) * side
    away = np.array([np.cos(angle), np.sin(angle)]) * reach / 2
    path = generate_fractal_line(rng, middle - away, middle + away, rng.choice([0.02, 0.05, 0.09]))
    if long and rng.random() < 0.4:  # the crack ends within the picture
        path = path[: int(len(path) * rng.uniform(0.4, 0.75))]
        draw_path(rng, mask, path, width, (False, True))
    else:
        draw_path(rng, mask, path, width, (not long, not long))
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.55, 0.25, 0.13, 0.07]))):
        start = path[rng.integers(len(path))]
        turn = angle + rng.choice([-1, 1]) * rng.uniform(0.35, 1.2)
        end = start + np.array([np.cos(turn), np.sin(turn)]) * reach * rng.uniform(0.08, 0.25)
        draw_path(
            rng, mask, generate_fractal_line(rng, start, end, 0.08), width * rng.uniform(0.35, 0.8), (False, True)
        )


def draw_net(rng: np.random.Generator, mask: UInt8Image, side: int, width: float) -> None:
    """Draw map cracking: borders of the Voronoi cells of random points in a part of the picture."""
    size = rng.uniform(0.3, 0.95) * side
    corner = rng.uniform(0, side - size, 2)
    count = int(rng.integers(8, 26))
    points = rng.uniform(0, size, (count, 2))
    subdivision = cv2.Subdiv2D((0, 0, int(size) + 2, int(size) + 2))
    for x, y in points.tolist():
        subdivision.insert((x, y))
    facets, _ = subdivision.getVoronoiFacetList([])
    for facet in facets:
        ring = np.asarray(facet, dtype=np.float64)
        for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            inside = bool(((a > 0) & (a < size) & (b > 0) & (b < size)).all())
            if inside and tuple(a) < tuple(b) and rng.random() < 0.85:
                part = generate_fractal_line(rng, a + corner, b + corner, 0.07)
                draw_path(rng, mask, part, width * rng.uniform(0.4, 0.9), (False, False))


def reduce_mask(mask: UInt8Image, side_px: int) -> Field:
    """Coverage (side, side) of the picture's pixels by the mask, 0 to 1."""
    small = cv2.resize(mask, (side_px, side_px), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32) / np.float32(255)


def paint_crack(canvas: Canvas, coverage: Field, *, depth: float, halo: float) -> None:
    """Darken the picture at the crack; `depth`: share of the light lost there, `halo`: share lost by dirt beside it."""
    rng = canvas.rng
    uneven = canvas.sample_noise(canvas.side_px, canvas.side_px, slope=0.9, coarse=2)
    gap = np.clip(coverage * (depth + 0.12 * uneven), 0, 0.97)
    factor = 1 - gap
    if halo > 0:
        factor *= 1 - halo * np.clip(blur_mask(coverage, rng.uniform(2, 6)) * 3, 0, 1)
    dx, dy = canvas.light * rng.uniform(0.7, 1.8)
    move = np.array([[1, 0, -dx], [0, 1, -dy]], dtype=np.float64)
    far = cv2.warpAffine(coverage, move, (canvas.side_px, canvas.side_px))
    factor *= 1 + rng.uniform(0, 0.22) * np.clip(far - coverage, 0, 1)  # the edge towards the light
    tint = np.array([1.0, 1.0, 1.0]) - rng.uniform(0, 0.12) * np.array([0.0, 0.5, 1.0])
    canvas.multiply(np.asarray(factor[..., None] ** tint.astype(np.float32), dtype=np.float32))
