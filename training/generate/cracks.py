"""Cracks: wandering lines with branches, steps along joints and nets, darkened as deep gaps are."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from training.generate.canvas import Canvas, Field, soft

Path2d = NDArray[np.float64]
FINE = 3  # times finer than the picture: the mask is drawn there


def wander(rng: np.random.Generator, start: Path2d, end: Path2d, rough: float, step_px: float = 2.5) -> Path2d:
    """A fractal line between two points, (n, 2) x, y: midpoints moved aside again and again.

    `rough` is the first shift as a share of the length; each next one is smaller by about 0.6.
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


def along_joints(
    rng: np.random.Generator, corner: tuple[float, float], brick_px: tuple[float, float], side_px: int
) -> Path2d:
    """A stepped line down a brick wall in stretcher bond: bed joint, head joint, bed joint.

    `brick_px` is width and height with joints, `corner` (x, y) where a head joint stands on an even course's bed joint.
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
        down = int(rng.choice([1, 1, 1, 1, 2]))  # 2: through the brick below
        row += down
        points.append(np.array([x, points[-1][1] + down * height]))
        if not (-10 < x < side_px + 10 and points[-1][1] < side_px + 10):
            break
    return np.concatenate([wander(rng, a, b, 0.025) for a, b in pairwise(points)])


def draw(
    rng: np.random.Generator, mask: NDArray[np.uint8], path: Path2d, width_px: float, taper: tuple[bool, bool]
) -> None:
    """Lay one line of changing width into the finer mask; `taper` thins its start and its end."""
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


def draw_line(rng: np.random.Generator, mask: NDArray[np.uint8], side: int, width: float) -> None:
    """A crack across all or part of the picture, with up to three branches."""
    angle = rng.choice([0, np.pi / 2, rng.uniform(0, np.pi)]) + rng.normal(0, 0.12)
    long = rng.random() < 0.65
    reach = side * (1.6 if long else rng.uniform(0.15, 0.6))
    middle = rng.uniform(0.15, 0.85, 2) * side
    away = np.array([np.cos(angle), np.sin(angle)]) * reach / 2
    path = wander(rng, middle - away, middle + away, rng.choice([0.02, 0.05, 0.09]))
    if long and rng.random() < 0.4:  # it ends within the picture
        path = path[: int(len(path) * rng.uniform(0.4, 0.75))]
        draw(rng, mask, path, width, (False, True))
    else:
        draw(rng, mask, path, width, (not long, not long))
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.55, 0.25, 0.13, 0.07]))):
        start = path[rng.integers(len(path))]
        turn = angle + rng.choice([-1, 1]) * rng.uniform(0.35, 1.2)
        end = start + np.array([np.cos(turn), np.sin(turn)]) * reach * rng.uniform(0.08, 0.25)
        draw(rng, mask, wander(rng, start, end, 0.08), width * rng.uniform(0.35, 0.8), (False, True))


def draw_net(rng: np.random.Generator, mask: NDArray[np.uint8], side: int, width: float) -> None:
    """Map cracking: the borders of cells about chance points within a part of the picture."""
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
                part = wander(rng, a + corner, b + corner, 0.07)
                draw(rng, mask, part, width * rng.uniform(0.4, 0.9), (False, False))


def shrink(mask: NDArray[np.uint8], side_px: int) -> Field:
    """The finer mask as coverage of the picture's own pixels, 0 to 1."""
    small = cv2.resize(mask, (side_px, side_px), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32) / np.float32(255)


def paint(canvas: Canvas, coverage: Field, *, depth: float, halo: float) -> None:
    """Darken the picture where the crack is; `depth` is how much of the light is lost, `halo` the dirt beside it."""
    rng = canvas.rng
    uneven = canvas.noise(canvas.side_px, canvas.side_px, slope=0.9, coarse=2)
    gap = np.clip(coverage * (depth + 0.12 * uneven), 0, 0.97)
    factor = 1 - gap
    if halo > 0:
        factor *= 1 - halo * np.clip(soft(coverage, rng.uniform(2, 6)) * 3, 0, 1)
    dx, dy = canvas.light * rng.uniform(0.7, 1.8)
    move = np.array([[1, 0, -dx], [0, 1, -dy]], dtype=np.float64)
    far = cv2.warpAffine(coverage, move, (canvas.side_px, canvas.side_px))
    factor *= 1 + rng.uniform(0, 0.22) * np.clip(far - coverage, 0, 1)  # the edge that faces the light
    tint = np.array([1.0, 1.0, 1.0]) - rng.uniform(0, 0.12) * np.array([0.0, 0.5, 1.0])
    canvas.multiply(np.asarray(factor[..., None] ** tint.astype(np.float32), dtype=np.float32))
