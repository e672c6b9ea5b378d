"""Distractors, which resemble defects: joints, cables, pipes, windows, shadows, paint, repairs, bolts."""

from __future__ import annotations

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array
from training.generate.canvas import Canvas, blur_mask, compute_ramp


def paint_joint(canvas: Canvas) -> None:
    """Paint a straight joint or edge across the wall, with a lit and a dark side."""
    rng, side = canvas.rng, canvas.side_px
    mask = np.zeros((side, side), dtype=np.uint8)
    at = rng.uniform(0.05, 0.95) * side
    lean = rng.normal(0, 0.03) * side if rng.random() < 0.8 else rng.uniform(-1, 1) * side
    ends = [(0.0, at), (side, at + lean)] if rng.random() < 0.5 else [(at, 0.0), (at + lean, side)]
    lines = [0.0] + ([rng.uniform(0.1, 0.4) * side] if rng.random() < 0.35 else [])
    for shift in lines:
        a, b = [tuple(int((v + shift * (i == (ends[0][0] == 0.0))) * 16) for i, v in enumerate(end)) for end in ends]
        cv2.line(mask, a, b, 255, int(rng.choice([1, 1, 2, 3, 5, 8])), cv2.LINE_AA, 4)
    line = blur_mask(mask, rng.uniform(0.3, 1.2))
    dx, dy = canvas.light * 1.5
    lit = cv2.warpAffine(line, np.array([[1, 0, -dx], [0, 1, -dy]]), (side, side))
    strength = rng.uniform(0.2, 0.85) if rng.random() < 0.85 else -rng.uniform(0.1, 0.5)
    canvas.multiply(np.clip(1 - strength * line, 0.05, 2) * (1 + rng.uniform(0, 0.25) * np.clip(lit - line, 0, 1)))


def paint_cable(canvas: Canvas) -> None:
    """Paint a cable on or in front of the wall, of constant width, with a smooth sag and a shadow."""
    rng, side = canvas.rng, canvas.side_px
    t = np.linspace(-0.1, 1.1, 40)
    start, end = rng.uniform(-0.1, 1.1, 2), rng.uniform(-0.1, 1.1, 2)
    if rng.random() < 0.6:
        end[0] = start[0] + rng.normal(0, 0.03)
        start[1], end[1] = -0.05, 1.05
    sag = rng.normal(0, 0.06)
    path = start + t[:, None] * (end - start) + np.stack([0 * t, sag * 4 * t * (1 - t)], axis=1)
    if rng.random() < 0.3:
        path = path[:, ::-1]
    thick = int(rng.choice([1, 1, 2, 3, 4, 6]))
    points = np.round(path * side * 16).astype(np.int32)
    for shadow in (True, False):
        if shadow and rng.random() < 0.4:
            continue
        away = (-canvas.light * rng.uniform(2, 14) * 16).astype(np.int32) if shadow else np.zeros(2, dtype=np.int32)
        mask = np.zeros((side, side), dtype=np.uint8)
        cv2.polylines(mask, [points + away], False, 255, thick, cv2.LINE_AA, 4)
        if shadow:
            canvas.multiply(1 - rng.uniform(0.2, 0.5) * blur_mask(mask, rng.uniform(0.6, 2)))
        else:
            canvas.cover(rng.uniform(0.005, 0.5) * rng.normal(1, 0.08, 3), blur_mask(mask, 0.5))


def paint_pipe(canvas: Canvas) -> None:
    """Paint a downpipe: a lit cylinder with a shadow."""
    rng, side = canvas.rng, canvas.side_px
    wide = rng.uniform(0.02, 0.1) * side
    at = rng.uniform(0.1, 0.9) * side
    x = (np.arange(side, dtype=np.float32) - np.float32(at)) / np.float32(wide / 2)
    shade = compute_ramp(1 - np.abs(x + np.float32(np.sign(canvas.light[0]) * 1.2)), 0, 0.4) * np.float32(
        rng.uniform(0.2, 0.5)
    )
    body = compute_ramp(1 - np.abs(x), 0, 0.12)
    light = np.float32(canvas.light[0])
    round_ = np.clip(0.55 + 0.4 * np.sqrt(np.clip(1 - x**2, 0, 1)) + 0.35 * light * x, 0.1, 1.4)
    turned = rng.random() < 0.25
    colour = rng.uniform(0.03, 0.6) * rng.normal(1, 0.12, 3).clip(0.6, 1.4)
    fields = [np.broadcast_to(field[None, :], (side, side)) for field in (shade, body, round_)]
    shade, body, round_ = (np.ascontiguousarray(field.T if turned else field) for field in fields)
    canvas.multiply(1 - shade)
    canvas.cover((round_[..., None] * colour).astype(np.float32), body)
    canvas.free[body > 0.1] = 0


def paint_window(canvas: Canvas) -> None:
    """Paint a window with reveal, frame, dark or reflecting panes, and a sill."""
    rng, side = canvas.rng, canvas.side_px
    width, height = rng.uniform(0.15, 0.6) * side, rng.uniform(0.2, 0.7) * side
    x0, y0 = int(rng.uniform(-0.2, 0.9) * side), int(rng.uniform(-0.2, 0.9) * side)
    x1, y1 = int(x0 + width), int(y0 + height)
    border = max(2, int(rng.uniform(0.02, 0.08) * width))

    def fill_rectangle(ax: int, ay: int, bx: int, by: int, colour: Float64Array) -> None:
        canvas.image[max(ay, 0) : max(by, 0), max(ax, 0) : max(bx, 0)] = colour.astype(np.float32)

    if rng.random() < 0.5:
        band = border * int(rng.integers(1, 4))
        part = (slice(max(y0 - band, 0), max(y1 + band, 0)), slice(max(x0 - band, 0), max(x1 + band, 0)))
        canvas.image[part] *= np.float32(rng.choice([0.6, 0.8, 1.2, 1.5]))
    frame = rng.uniform(0.05, 0.8) * rng.normal(1, 0.06, 3)
    fill_rectangle(x0, y0, x1, y1, frame)
    columns, rows = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    for i in range(columns):
        for j in range(rows):
            ax, bx = (int(x0 + border + k * (x1 - x0 - border) / columns) for k in (i, i + 1))
            ay, by = (int(y0 + border + k * (y1 - y0 - border) / rows) for k in (j, j + 1))
            bx, by = bx - border, by - border
            if bx <= max(ax, 0) or by <= max(ay, 0) or ax >= side or ay >= side:
                continue
            fill_rectangle(ax, ay, bx, by, rng.uniform(0.01, 0.25) * np.array([1.1, 1, 0.9]))
            pane = canvas.image[max(ay, 0) : by, max(ax, 0) : bx]
            if pane.size:
                mirrored = canvas.sample_noise(pane.shape[0], pane.shape[1], slope=1.8)
                pane += np.clip(mirrored, 0, 3)[..., None] * np.float32(rng.uniform(0, 0.12))
    cast = int(max(1, border * rng.uniform(0.3, 1.5)))
    canvas.image[max(y0, 0) : max(y0 + cast, 0), max(x0, 0) : max(x1, 0)] *= np.float32(rng.uniform(0.3, 0.8))
    if rng.random() < 0.6:
        sill = int(border * rng.uniform(0.8, 2))
        fill_rectangle(x0 - border, y1, x1 + border, y1 + sill, rng.uniform(0.1, 0.7) * np.ones(3))
        below = slice(max(y1 + sill, 0), max(y1 + 2 * sill, 0)), slice(max(x0 - border, 0), max(x1 + border, 0))
        canvas.image[below] *= np.float32(rng.uniform(0.4, 0.85))
    canvas.free[max(y0 - border, 0) : max(y1 + 2 * border, 0), max(x0 - border, 0) : max(x1 + border, 0)] = 0


def paint_shadow(canvas: Canvas) -> None:
    """Paint the shadow of a tree or of an edge: darker and bluer, with the texture of the wall."""
    rng, side = canvas.rng, canvas.side_px
    if rng.random() < 0.55:
        leaves = canvas.sample_noise(side, side, slope=rng.uniform(0.9, 1.5), coarse=rng.uniform(0.5, 2))
        where = canvas.sample_noise(side, side, slope=2.2)
        mask = compute_ramp(
            leaves + where * np.float32(rng.uniform(0, 1)), rng.uniform(-0.3, 1.0), rng.uniform(0.3, 1.0)
        )
        if rng.random() < 0.4:
            branches = np.zeros((side, side), dtype=np.uint8)
            for _ in range(int(rng.integers(2, 8))):
                points = np.cumsum(rng.normal(0, side / 9, (9, 2)), axis=0) + rng.uniform(0, side, 2)
                cv2.polylines(branches, [points.astype(np.int32)], False, 255, int(rng.integers(2, 9)), cv2.LINE_AA)
            mask = np.maximum(mask * np.float32(0.6), blur_mask(branches, rng.uniform(1.5, 4)))
    else:
        y, x = np.mgrid[0:side, 0:side].astype(np.float32)
        angle = rng.uniform(0, 2 * np.pi)
        ramp = (x - side / 2) * np.float32(np.cos(angle)) + (y - side / 2) * np.float32(np.sin(angle))
        mask = compute_ramp(ramp, rng.uniform(-0.4, 0.4) * side, rng.uniform(1, 14))
        if rng.random() < 0.4:
            mask = mask * (1 - compute_ramp(ramp, rng.uniform(0.05, 0.4) * side, rng.uniform(1, 14)))
    tint = np.array([0.75, 0.95, 1.05]) * rng.uniform(0.3, 0.7)
    canvas.multiply(1 - mask[..., None] * np.clip(tint, 0, 0.8).astype(np.float32))


def paint_strokes(canvas: Canvas) -> None:
    """Paint graffiti, chalk and painted lines: constant width, round ends, opaque."""
    rng, side = canvas.rng, canvas.side_px
    mask = np.zeros((side, side), dtype=np.uint8)
    thick = int(rng.choice([1, 2, 4, 8, 14, 24]))
    for _ in range(int(rng.integers(1, 4))):
        t = np.linspace(0, 1, 40)
        if rng.random() < 0.45:
            path = rng.uniform(0, side, 2) + t[:, None] * rng.normal(0, side / 2, 2)
        else:
            swing = sum(rng.normal(0, side / 9, (2, 1)) * np.sin(k * 3 * t + rng.uniform(0, 6)) for k in range(1, 5))
            path = rng.uniform(0, side, 2) + np.asarray(swing).T + t[:, None] * rng.normal(0, side / 3, 2)
        cv2.polylines(mask, [path.astype(np.int32)], False, 255, thick, cv2.LINE_AA)
    colour = rng.uniform(0, 0.85, 3) if rng.random() < 0.6 else np.ones(3) * rng.choice([0.02, 0.7, 0.85])
    worn = np.clip(rng.uniform(0.5, 1.1) + 0.25 * canvas.sample_noise(side, side, slope=0.8), 0, 1)
    canvas.cover(colour, blur_mask(mask, rng.uniform(0.4, 1.2)) * worn * np.float32(rng.uniform(0.5, 0.98)))


def paint_repair(canvas: Canvas) -> None:
    """Paint a repair: flat, of another tone, with straight or irregular edges."""
    rng, side = canvas.rng, canvas.side_px
    mask = np.zeros((side, side), dtype=np.uint8)
    centre, size = rng.uniform(0, side, 2), rng.uniform(0.06, 0.35, 2) * side
    if rng.random() < 0.6:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size + rng.normal(0, 0.04 * side, (4, 2))
    else:
        angle = np.linspace(0, 2 * np.pi, 14)[:-1, None]
        corners = np.hstack([np.cos(angle), np.sin(angle)]) * size * rng.uniform(0.75, 1.15, (13, 1))
    cv2.fillPoly(mask, [(corners + centre).astype(np.int32)], 255, cv2.LINE_AA)
    flat = blur_mask(mask, rng.uniform(0.5, 1.5))
    smooth = cv2.GaussianBlur(canvas.image, (0, 0), 3)
    tone = rng.choice([0.7, 0.82, 1.18, 1.35]) * rng.normal(1, 0.03, 3)
    canvas.cover(smooth * tone.astype(np.float32) * 0.6 + canvas.image * tone.astype(np.float32) * 0.4, flat)


def paint_bolts(canvas: Canvas) -> None:
    """Paint screws, anchors, lamps or small signs: round or rectangular, sharp, with a shadow."""
    rng, side = canvas.rng, canvas.side_px
    for _ in range(int(rng.integers(1, 7))):
        mask = np.zeros((side, side), dtype=np.uint8)
        x, y = (int(v) for v in rng.uniform(0, side, 2))
        size = int(rng.choice([2, 3, 5, 9, 16]))
        if rng.random() < 0.6:
            cv2.circle(mask, (x, y), size, 255, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(mask, (x, y), (x + size * 2, y + int(size * rng.uniform(0.6, 2.5))), 255, -1)
        part = (slice(max(y - 40, 0), y + 60), slice(max(x - 40, 0), x + 60))
        moved = np.roll(mask, tuple(np.round(-canvas.light[::-1] * size * 0.5).astype(int).tolist()), (0, 1))
        canvas.multiply(1 - rng.uniform(0.2, 0.6) * blur_mask(moved[part], 1.5), part[0].start, part[1].start)
        canvas.cover(rng.uniform(0.01, 0.6, 3), blur_mask(mask[part], 0.5), part[0].start, part[1].start)


PAINTERS = (
    paint_joint, paint_cable, paint_pipe, paint_window, paint_shadow, paint_strokes, paint_repair, paint_bolts,
)  # fmt: skip
WEIGHTS = np.array([0.2, 0.13, 0.08, 0.12, 0.17, 0.1, 0.1, 0.1])


def paint_distractors(canvas: Canvas, count: int) -> None:
    """Paint `count` random distractors."""
    for number in canvas.rng.choice(len(PAINTERS), count, p=WEIGHTS):
        PAINTERS[int(number)](canvas)
