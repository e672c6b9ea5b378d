"""One generated picture: a surface, things that are no defects, defects with their boxes, and the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from schemas.vocabulary import DefectClass
from training.data.sample import CLASSES
from training.generate import cracks, moisture
from training.generate.bars import chance_bars
from training.generate.brickwork import lay_wall
from training.generate.camera import photograph
from training.generate.canvas import Canvas, Place, to_linear
from training.generate.distractors import distract
from training.generate.grounds import Grounds
from training.generate.spalling import spall
from training.generate.surfaces import Ground

CRACK, SPALLING, MOISTURE = (CLASSES.index(name) for name in DefectClass)
LAID_SHARE = 0.04  # of pictures: walls laid from real bricks, of which there are few
LEAST_SIDE_PX = 10
LEAST_CONTRAST = 3.5  # of a crack: light lost times the root of its width, over the deviation of the surface
LEAST_CHANGE = 0.13  # of a patch: the mean share of light by which it differs from what was there
OVER_TEXTURE = 0.8  # of a patch: the same change over the deviation of what was there
Soaker = Callable[[Canvas, Place], NDArray[np.bool_]]


@dataclass(frozen=True, kw_only=True)
class Picture:
    """BGR 8 bit, and its boxes: (N, 4) x_min, y_min, x_max, y_max px, (N,) indices of `CLASSES`."""

    image: NDArray[np.uint8]
    boxes_px: NDArray[np.float64]
    classes: NDArray[np.int64]


def make_picture(grounds: Grounds, seed: int, *, side_px: int = 416) -> Picture:
    """The picture of this seed: the same seed and surfaces give the same picture."""
    rng = np.random.default_rng(seed)
    if grounds.bricks and rng.random() < LAID_SHARE:
        return _laid(rng, grounds, side_px)
    canvas, ground = grounds.start(rng, side_px)
    distract(canvas, int(rng.choice([0, 1, 2, 3], p=[0.3, 0.33, 0.25, 0.12])))
    boxes: list[list[float]] = []
    classes: list[int] = []
    wanted = rng.choice(3, int(rng.choice([0, 1, 2, 3], p=[0.12, 0.55, 0.25, 0.08])), p=[0.3, 0.33, 0.37])
    for kind in sorted(int(number) for number in wanted)[::-1]:
        if kind == SPALLING:
            found = _spalling(canvas, ground, grounds, boxes)
        else:
            found = (_crack if kind == CRACK else _moisture)(canvas, ground, boxes)
        boxes += found
        classes += [kind] * len(found)
    return Picture(
        image=photograph(canvas, noise=1.0),
        boxes_px=np.array(boxes, dtype=np.float64).reshape(-1, 4),
        classes=np.array(classes, dtype=np.int64),
    )


def _laid(rng: np.random.Generator, grounds: Grounds, side_px: int) -> Picture:
    """A wall of real bricks under another light."""
    image, boxes, classes = lay_wall(rng, grounds.bricks, side_px)
    canvas = Canvas(
        image=to_linear(image), free=np.ones(image.shape[:2], np.float32), rng=rng, light=np.array([0.0, -1.0])
    )
    return Picture(
        image=photograph(canvas, noise=1.0),
        boxes_px=np.array(boxes, dtype=np.float64).reshape(-1, 4),
        classes=np.array(classes, dtype=np.int64),
    )


def place_for(
    canvas: Canvas, size: tuple[int, int], taken: list[list[float]], *, outside: float, bottom: bool = False
) -> Place | None:
    """A place for a patch of this size (height, width) that is wall and not yet taken, or None.

    Up to `outside` of the patch may lie beyond the picture; `bottom`: it stands on the lower border.
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


def _crack(canvas: Canvas, ground: Ground, taken: list[list[float]]) -> list[list[float]]:
    """One crack with its branches, a stepped crack in a brick wall, or a net of cracks."""
    rng, side = canvas.rng, canvas.side_px
    mask = np.zeros((side * cracks.FINE, side * cracks.FINE), dtype=np.uint8)
    tone = canvas.image[::3, ::3].mean(axis=2)
    noise = float((tone - cv2.blur(tone, (15, 15))).std() / max(1e-3, float(tone.mean())))
    width = max(float(np.clip(rng.lognormal(np.log(1.9), 0.6), 0.8, 9)), 0.9 + 3 * noise)
    if ground.kind == "facade":
        width = min(width, 2.5)
    kind = rng.random()
    if ground.brick_px and kind < 0.65:
        path = cracks.along_joints(rng, ground.corner_px, ground.brick_px, side)
        cracks.draw(rng, mask, path, max(width, 0.06 * ground.brick_px[1]), (False, True))
    elif kind > 0.92:
        cracks.draw_net(rng, mask, side, width)
    else:
        cracks.draw_line(rng, mask, side, width)
    coverage = cracks.shrink(mask, side) * (canvas.free if ground.kind == "facade" else np.float32(1))
    box = _loose(rng, coverage > 0.25, side)
    if box is None or any(_overlap(box, other) > 0.5 for other in taken):
        return []
    depth = float(np.clip(rng.uniform(0.25, 0.97), min(0.9, 0.2 + noise), 0.97))
    if depth * np.sqrt(width) < LEAST_CONTRAST * noise:
        return []  # nobody could see it
    cracks.paint(canvas, coverage, depth=depth, halo=rng.choice([0.0, 0.05, 0.15, 0.3]))
    return [box]


def _spalling(canvas: Canvas, ground: Ground, grounds: Grounds, taken: list[list[float]]) -> list[list[float]]:
    """A hole, long or round, with bars, bricks or rubble in it; now and then a row of small ones."""
    rng, side = canvas.rng, canvas.side_px
    facade = ground.kind == "facade"
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
        place = place_for(canvas, (height, width), taken + boxes, outside=0 if facade or row else 0.45)
        if place is None:
            continue
        beneath = None
        if ground.kind in {"plaster", "facade", "close"} and rng.random() < 0.25:
            beneath = _bricks(canvas, grounds, place)
        armed = ground.kind != "brick" and beneath is None and rng.random() < 0.5
        bars = chance_bars(rng, place.height, place.width) if armed else ()
        boxes += _seen(canvas, place, partial(spall, canvas, place, bars=bars, beneath=beneath))
    return boxes


def _bricks(canvas: Canvas, grounds: Grounds, place: Place) -> NDArray[np.float32] | None:
    """A piece of brick wall of the place's size and of about the picture's brightness."""
    walls = [ground for ground in grounds.painted if ground.kind == "brick"]
    if not walls or max(place.height, place.width) > 600:
        return None
    image = walls[int(canvas.rng.integers(len(walls)))].image
    y, x = (int(canvas.rng.integers(image.shape[0] - size)) for size in (place.height, place.width))
    piece = to_linear(np.ascontiguousarray(image[y : y + place.height, x : x + place.width]))
    return piece * np.float32(0.75 * canvas.image.mean() / max(1e-3, float(piece.mean())))


def _moisture(canvas: Canvas, ground: Ground, taken: list[list[float]]) -> list[list[float]]:
    rng, side = canvas.rng, canvas.side_px
    facade = ground.kind == "facade"
    both = rng.lognormal(np.log(0.25 if facade else 0.5), 0.5) * side * rng.lognormal(0, 0.3, 2)
    height, width = np.clip(both, 40, (0.4 if facade else 1.4) * side).astype(int).tolist()
    makers: tuple[Soaker, ...] = (
        moisture.damp_patch,
        moisture.rising_damp,
        moisture.run_off,
        moisture.salts,
        moisture.mould,
    )
    maker = makers[rng.choice(5, p=[0.27, 0.16, 0.2, 0.13, 0.24])]
    if maker is moisture.rising_damp:
        width = int(width * rng.uniform(1, 2.5))
    foot = maker is moisture.rising_damp
    place = place_for(canvas, (height, width), taken, outside=0 if facade else 0.4, bottom=foot)
    if place is None:
        return []
    return _seen(canvas, place, partial(maker, canvas, place))


def _seen(canvas: Canvas, place: Place, paint: Callable[[], NDArray[np.bool_]]) -> list[list[float]]:
    """Paint a patch and give its box; when it can hardly be seen, take it away again."""
    part = canvas.image[place.y : place.y + place.height, place.x : place.x + place.width]
    before = part.copy()
    mask = paint()
    change = np.abs(part - before).mean(axis=2)[mask].mean() if mask.any() else 0.0
    boxes = _tight(canvas.rng, mask, place, canvas.side_px)
    texture = before[::2, ::2].mean(axis=2).std()
    if not boxes or change < max(LEAST_CHANGE * float(before.mean()), OVER_TEXTURE * float(texture)):
        part[:] = before
        return []
    return boxes


def _tight(rng: np.random.Generator, mask: NDArray[np.bool_], place: Place, side: int) -> list[list[float]]:
    """The box of a patch, as people draw them: a little too large or too small; none when it is a crumb."""
    rows, columns = np.flatnonzero(mask.mean(axis=1) > 0.01), np.flatnonzero(mask.mean(axis=0) > 0.01)
    if len(rows) < LEAST_SIDE_PX or len(columns) < LEAST_SIDE_PX:
        return []
    box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)
    box += [place.x, place.y, place.x, place.y]
    slack = 0.03 * np.minimum(box[2] - box[0], box[3] - box[1])
    box += np.array([-1, -1, 1, 1]) * rng.uniform(-0.3, 1, 4) * slack
    return [np.clip(box, 0, side).tolist()]


def _loose(rng: np.random.Generator, mask: NDArray[np.bool_], side: int) -> list[float] | None:
    """The box of a crack as the real sets have it: 1 to 5 % of the picture too large, to the border when it is near."""
    ys, xs = np.nonzero(mask)
    if len(ys) < 25 or max(np.ptp(ys), np.ptp(xs)) < 0.08 * side:
        return None
    box = np.array([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], dtype=np.float64)
    box += np.array([-1, -1, 1, 1]) * rng.uniform(0.01, 0.05, 4) * side
    snap = 0.025 * side
    box = np.where(box < snap, 0, np.where(box > side - snap, side, box))
    return [float(value) for value in box]


def _overlap(a: list[float], b: list[float]) -> float:
    """Shared area as a part of the smaller box."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    least = min((box[2] - box[0]) * (box[3] - box[1]) for box in (a, b))
    return max(0.0, width) * max(0.0, height) / max(least, 1e-9)
