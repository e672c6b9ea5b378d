"""A generated picture: background, distractors, defects with their boxes, and image formation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Image
from schemas.vocabulary import DefectClass
from training.data.sample import CLASSES
from training.generate import cracks, moisture
from training.generate.backgrounds import Backgrounds
from training.generate.bars import choose_bars
from training.generate.brickwork import lay_wall
from training.generate.camera import render_photograph
from training.generate.canvas import Canvas, Place, linear_from_stored
from training.generate.distractors import paint_distractors
from training.generate.spalling import paint_spalling
from training.generate.surfaces import Background

CRACK, SPALLING, MOISTURE = (CLASSES.index(name) for name in DefectClass)
BRICK_WALL_SHARE = 0.04  # share of pictures of walls of real bricks, of which there are few
SIDE_MIN_PX = 10
CRACK_CONTRAST_MIN = 3.5  # of a crack: lost share of the light times root of the width, over the surface noise
PATCH_CHANGE_MIN = 0.13  # of a patch: mean change relative to the mean of the surface
PATCH_TEXTURE_RATIO_MIN = 0.8  # of a patch: mean change relative to the standard deviation of the surface
MoisturePainter = Callable[[Canvas, Place], BoolArray]


@dataclass(frozen=True, kw_only=True)
class Picture:
    """Picture (side, side, 3: blue, green, red; 8 bit), boxes (n, 4: x_min, y_min, x_max, y_max; px), classes (n,)."""

    image: UInt8Image
    boxes_px: Float64Array
    classes: Int64Array


def make_picture(backgrounds: Backgrounds, seed: int, *, side_px: int = 416) -> Picture:
    """Generate the picture of a seed; it depends on seed, backgrounds and size only."""
    rng = np.random.default_rng(seed)
    if backgrounds.bricks and rng.random() < BRICK_WALL_SHARE:
        return _make_brick_picture(rng, backgrounds, side_px)
    canvas, background = backgrounds.create_canvas(rng, side_px)
    paint_distractors(canvas, int(rng.choice([0, 1, 2, 3], p=[0.3, 0.33, 0.25, 0.12])))
    boxes: list[list[float]] = []
    classes: list[int] = []
    wanted = rng.choice(3, int(rng.choice([0, 1, 2, 3], p=[0.12, 0.55, 0.25, 0.08])), p=[0.3, 0.33, 0.37])
    for kind in sorted(int(number) for number in wanted)[::-1]:
        if kind == SPALLING:
            found = _add_spalling(canvas, background, backgrounds, boxes)
        else:
            found = (_add_crack if kind == CRACK else _add_moisture)(canvas, background, boxes)
        boxes += found
        classes += [kind] * len(found)
    return Picture(
        image=render_photograph(canvas, noise=1.0),
        boxes_px=np.array(boxes, dtype=np.float64).reshape(-1, 4),
        classes=np.array(classes, dtype=np.int64),
    )


def _make_brick_picture(rng: np.random.Generator, backgrounds: Backgrounds, side_px: int) -> Picture:
    """Picture of a wall of real bricks."""
    image, boxes, classes = lay_wall(rng, backgrounds.bricks, side_px)
    canvas = Canvas(
        image=linear_from_stored(image), free=np.ones(image.shape[:2], np.float32), rng=rng, light=np.array([0.0, -1.0])
    )
    return Picture(
        image=render_photograph(canvas, noise=1.0),
        boxes_px=np.array(boxes, dtype=np.float64).reshape(-1, 4),
        classes=np.array(classes, dtype=np.int64),
    )


def find_place(
    canvas: Canvas, size: tuple[int, int], taken: list[list[float]], *, outside: float, bottom: bool = False
) -> Place | None:
    """Find a place for a patch on a wall and outside other defects.

    Args:
        canvas: the picture.
        size: height and width of the patch, px.
        taken: boxes x_min, y_min, x_max, y_max of the other defects, px.
        outside: largest share of the patch's height and width outside the picture, at each side.
        bottom: whether the patch ends at the lower border of the picture.

    Returns:
        The place; None if none was found.
    """
    side = canvas.side_px
    if max(size) * (1 - 2 * outside) > side:
        return None
    for _ in range(14):
        over = outside * np.array(size)
        y, x = canvas.rng.uniform(-over, side - np.array(size) + over)
        if bottom:
            y = side - size[0]
        y0, x0 = max(0, int(y)), max(0, int(x))
        y1, x1 = min(side, int(y + size[0])), min(side, int(x + size[1]))
        apart = all(x0 > b[2] or x1 < b[0] or y0 > b[3] or y1 < b[1] for b in taken)
        if apart and float(canvas.free[y0:y1:4, x0:x1:4].mean()) > 0.75:
            window = [2 * (at - begin) / long - 1 for begin, long, ends in
                      ((y, size[0], (y0, y1)), (x, size[1], (x0, x1))) for at in ends]  # fmt: skip
            return Place(y=y0, x=x0, height=y1 - y0, width=x1 - x0, window=(window[0], window[1], window[2], window[3]))
    return None


def _add_crack(canvas: Canvas, background: Background, taken: list[list[float]]) -> list[list[float]]:
    """Add a crack with branches, a stepped crack in a brick wall, or map cracking; its box, if it is visible."""
    rng, side = canvas.rng, canvas.side_px
    mask = np.zeros((side * cracks.FINE, side * cracks.FINE), dtype=np.uint8)
    tone = canvas.image[::3, ::3].mean(axis=2)
    noise = float((tone - cv2.blur(tone, (15, 15))).std() / max(1e-3, float(tone.mean())))
    width = max(float(np.clip(rng.lognormal(np.log(1.9), 0.6), 0.8, 9)), 0.9 + 3 * noise)
    if background.kind == "facade":
        width = min(width, 2.5)
    kind = rng.random()
    if background.brick_px and kind < 0.65:
        path = cracks.generate_stepped_line(rng, background.corner_px, background.brick_px, side)
        cracks.draw_path(rng, mask, path, max(width, 0.06 * background.brick_px[1]), (False, True))
    elif kind > 0.92:
        cracks.draw_net(rng, mask, side, width)
    else:
        cracks.draw_line(rng, mask, side, width)
    coverage = cracks.reduce_mask(mask, side) * (canvas.free if background.kind == "facade" else np.float32(1))
    box = _box_crack(rng, coverage > 0.25, side)
    if box is None or any(_compute_overlap(box, other) > 0.5 for other in taken):
        return []
    depth = float(np.clip(rng.uniform(0.25, 0.97), min(0.9, 0.2 + noise), 0.97))
    if depth * np.sqrt(width) < CRACK_CONTRAST_MIN * noise:
        return []  # not visible
    cracks.paint_crack(canvas, coverage, depth=depth, halo=rng.choice([0.0, 0.05, 0.15, 0.3]))
    return [box]


def _add_spalling(
    canvas: Canvas, background: Background, backgrounds: Backgrounds, taken: list[list[float]]
) -> list[list[float]]:
    """Add spalling with bars, bricks or broken concrete inside, sometimes as a row of small holes; its boxes."""
    rng, side = canvas.rng, canvas.side_px
    facade = background.kind == "facade"
    stretch = (
        rng.lognormal(0, 0.35) if rng.random() < 0.65 else rng.choice([0.2, 0.3, 3.3, 5.0]) * rng.lognormal(0, 0.2)
    )
    size = rng.lognormal(np.log(0.2 if facade else 0.42), 0.65) * side
    row = not facade and rng.random() < 0.1
    if row:
        size *= 0.35
    both = size * np.array([stretch**-0.5, stretch**0.5])
    height, width = (
        np.clip(both, 14 if facade else 22, (0.35 if facade else 0.5 if row else 1.3) * side).astype(int).tolist()
    )
    boxes: list[list[float]] = []
    for _ in range(int(rng.integers(2, 6)) if row else 1):
        place = find_place(canvas, (height, width), taken + boxes, outside=0 if facade or row else 0.45)
        if place is None:
            continue
        beneath = None
        if background.kind in {"plaster", "facade", "close"} and rng.random() < 0.25:
            beneath = _cut_brickwork(canvas, backgrounds, place)
        armed = background.kind != "brick" and beneath is None and rng.random() < 0.5
        bars = choose_bars(rng, place.height, place.width) if armed else ()
        boxes += _paint_if_visible(canvas, place, partial(paint_spalling, canvas, place, bars=bars, beneath=beneath))
    return boxes


def _cut_brickwork(canvas: Canvas, backgrounds: Backgrounds, place: Place) -> Float32Array | None:
    """Part of a brick wall of the size of the place, about as bright as the picture; None if there is none."""
    walls = [background for background in backgrounds.synthetic if background.kind == "brick"]
    if not walls or max(place.height, place.width) > 600:
        return None
    image = walls[int(canvas.rng.integers(len(walls)))].image
    y, x = (int(canvas.rng.integers(image.shape[0] - size)) for size in (place.height, place.width))
    piece = linear_from_stored(np.ascontiguousarray(image[y : y + place.height, x : x + place.width]))
    return piece * np.float32(0.75 * canvas.image.mean() / max(1e-3, float(piece.mean())))


def _add_moisture(canvas: Canvas, background: Background, taken: list[list[float]]) -> list[list[float]]:
    """Add a random kind of moisture; its box, if it is visible."""
    rng, side = canvas.rng, canvas.side_px
    facade = background.kind == "facade"
    both = rng.lognormal(np.log(0.25 if facade else 0.5), 0.5) * side * rng.lognormal(0, 0.3, 2)
    height, width = np.clip(both, 40, (0.4 if facade else 1.4) * side).astype(int).tolist()
    painters: tuple[MoisturePainter, ...] = (
        moisture.paint_damp_patch,
        moisture.paint_rising_damp,
        moisture.paint_run_off,
        moisture.paint_efflorescence,
        moisture.paint_mould,
    )
    painter = painters[rng.choice(5, p=[0.27, 0.16, 0.2, 0.13, 0.24])]
    if painter is moisture.paint_rising_damp:
        width = int(width * rng.uniform(1, 2.5))
    foot = painter is moisture.paint_rising_damp
    place = find_place(canvas, (height, width), taken, outside=0 if facade else 0.4, bottom=foot)
    if place is None:
        return []
    return _paint_if_visible(canvas, place, partial(painter, canvas, place))


def _paint_if_visible(canvas: Canvas, place: Place, paint: Callable[[], BoolArray]) -> list[list[float]]:
    """Paint a patch and return its box; if it is hardly visible, restore the canvas and return no box."""
    part = canvas.image[place.y : place.y + place.height, place.x : place.x + place.width]
    before = part.copy()
    mask = paint()
    change = np.abs(part - before).mean(axis=2)[mask].mean() if mask.any() else 0.0
    boxes = _box_patch(canvas.rng, mask, place, canvas.side_px)
    texture = before[::2, ::2].mean(axis=2).std()
    if not boxes or change < max(PATCH_CHANGE_MIN * float(before.mean()), PATCH_TEXTURE_RATIO_MIN * float(texture)):
        part[:] = before
        return []
    return boxes


def _box_patch(rng: np.random.Generator, mask: BoolArray, place: Place, side: int) -> list[list[float]]:
    """Box of a patch with the variation of boxes drawn by people; none for very small patches."""
    rows, columns = np.flatnonzero(mask.mean(axis=1) > 0.01), np.flatnonzero(mask.mean(axis=0) > 0.01)
    if len(rows) < SIDE_MIN_PX or len(columns) < SIDE_MIN_PX:
        return []
    box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)
    box += [place.x, place.y, place.x, place.y]
    slack = 0.03 * np.minimum(box[2] - box[0], box[3] - box[1])
    box += np.array([-1, -1, 1, 1]) * rng.uniform(-0.3, 1, 4) * slack
    return [np.clip(box, 0, side).tolist()]


def _box_crack(rng: np.random.Generator, mask: BoolArray, side: int) -> list[float] | None:
    """Box of a crack as in the real sets, larger by 1 to 5 % of the picture, up to a near border; None if short."""
    ys, xs = np.nonzero(mask)
    if len(ys) < 25 or max(np.ptp(ys), np.ptp(xs)) < 0.08 * side:
        return None
    box = np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], dtype=np.float64)
    box += np.array([-1, -1, 1, 1]) * rng.uniform(0.01, 0.05, 4) * side
    snap = 0.025 * side
    box = np.where(box < snap, 0, np.where(box > side - snap, side, box))
    return [float(value) for value in box]


def _compute_overlap(a: list[float], b: list[float]) -> float:
    """Shared area of two boxes as a share of the smaller one."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    least = min((box[2] - box[0]) * (box[3] - box[1]) for box in (a, b))
    return max(0.0, width) * max(0.0, height) / max(least, 1e-9)
