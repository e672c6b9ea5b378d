"""Real surfaces without defects, cut from the pictures that may be learned from, beside the painted ones."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.reviews.training import Split
from training.data.cracks import read_cracks
from training.data.negatives import read_negatives
from training.data.sample import Sample
from training.generate.brickwork import Brick, read_bricks
from training.generate.canvas import Canvas, to_linear
from training.generate.surfaces import Ground, bricks, concrete, plaster, stones

MARGIN_PX = 12  # boxes are loose, yet a crack's end may lie outside
LEAST_PX = 180  # a narrower strip free of boxes shows too little to be mirrored
SKY = 0.22  # share of the height: calm parts whose middle is higher are taken for sky between clouds and wires
PER_SITE = 17  # pictures: no site's look takes over
NEVER = frozenset({"ac-11-_jpg", "ac-14-_jpg", "ac-15-_jpg", "ac-74-_jpg", "ac-80-_jpg", "a-1-50-_jpg", "a-1-107-_jpg",
                   "MAX_1631_4_2", "MAX_1644_2_4", "MAX_1641_9_3", "MAX_1641_12_6", "MAX_1647_7_18",
                   "MAX_1641_2_2", "MAX_1647_4_5", "MAX_1638_2_2", "20160316_142014_jpg", "a-1-127-_jpg", "040_jpg",
                   "b-1-175-_jpg", "b-1-176-_jpg", "b-1-177-_jpg"})  # fmt: skip
"""Seen to show a defect outside their boxes."""
NEVER_SITES = frozenset({"crack_boxes_640/web_a"})


@dataclass(frozen=True, kw_only=True)
class Grounds:
    """Surfaces to draw on: close views of real walls and floors, whole facades, painted walls; loose real bricks."""

    close: tuple[Ground, ...]
    facades: tuple[Ground, ...]
    painted: tuple[Ground, ...]
    bricks: tuple[Brick, ...]

    def start(self, rng: np.random.Generator, side_px: int) -> tuple[Canvas, Ground]:
        """A new picture on one of the surfaces, cut at a chance place, scale and mirror.

        Returns the canvas and what is known of its surface: kind and bricks in pixels of the picture, no image.
        """
        kinds = [(self.close, 0.42), (self.facades, 0.18), (self.painted, 0.4)]
        kinds = [(kind, weight) for kind, weight in kinds if kind]
        weights = np.array([weight for _, weight in kinds])
        kind = kinds[rng.choice(len(kinds), p=weights / weights.sum())][0]
        return _cut(kind[int(rng.integers(len(kind)))], rng, side_px)


def load_grounds(data: Path, *, seed: int = 0, painted: int = 120) -> Grounds:
    """Read every surface that may be learned from; `data` holds `defects` and `drone`. Takes about half a minute."""
    rng = np.random.default_rng(seed)
    makers = (bricks, bricks, plaster, plaster, concrete, concrete, stones)
    return Grounds(
        close=tuple(_close_views(read_cracks(data / "defects"))),
        facades=tuple(_facade(sample) for sample in read_negatives(data) if sample.split is Split.TRAIN),
        bricks=read_bricks(data / "defects"),
        painted=tuple(makers[number % len(makers)](rng) for number in range(painted)),
    )


def _close_views(samples: Iterable[Sample]) -> Iterable[Ground]:
    by_site: dict[str, list[Sample]] = {}
    for sample in samples:
        clean = sample.path.stem not in NEVER and sample.site not in NEVER_SITES
        if sample.split is Split.TRAIN and clean:
            by_site.setdefault(sample.site, []).append(sample)
    for site in sorted(by_site):
        kept = 0
        # An order that another picture does not change: what is kept was looked at.
        for sample in sorted(by_site[site], key=lambda sample: zlib.crc32(sample.path.stem.encode())):
            image = _without_boxes(sample)
            if image is not None and kept < PER_SITE:
                kept += 1
                yield Ground(image=image, free=np.full(image.shape[:2], 255, dtype=np.uint8), kind="close")


def _without_boxes(sample: Sample) -> NDArray[np.uint8] | None:
    """The largest upright part of the picture that no box touches, mirrored to a square of the picture's size."""
    image = sample.read()
    height, width = image.shape[:2]
    boxes = sample.boxes_px + MARGIN_PX * np.array([-1, -1, 1, 1])
    xs = np.unique(np.clip(np.concatenate([[0, width], boxes[:, 0], boxes[:, 2]]), 0, width).astype(int))
    ys = np.unique(np.clip(np.concatenate([[0, height], boxes[:, 1], boxes[:, 3]]), 0, height).astype(int))
    best, area = (0, 0, 0, 0), 0
    for x0 in xs:
        for x1 in xs[xs > x0]:
            for y0 in ys:
                for y1 in ys[ys > y0]:
                    touched = (boxes[:, 0] < x1) & (boxes[:, 2] > x0) & (boxes[:, 1] < y1) & (boxes[:, 3] > y0)
                    size = (x1 - x0) * (y1 - y0) if min(x1 - x0, y1 - y0) >= LEAST_PX * width / 640 else 0
                    if size > area and not touched.any():
                        best, area = (x0, y0, x1, y1), size
    if not area:
        return None
    part = image[best[1] : best[3], best[0] : best[2]]
    padded = cv2.copyMakeBorder(part, 0, height - part.shape[0], 0, width - part.shape[1], cv2.BORDER_REFLECT_101)
    return np.asarray(padded, dtype=np.uint8)


def _facade(sample: Sample) -> Ground:
    """A whole facade; wall is where little happens, neither part of the sky nor high up in the picture."""
    image = sample.read()
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    change = cv2.blur(cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)), (15, 15))
    calm = (change < 14).astype(np.uint8)
    _, parts, _, centres = cv2.connectedComponentsWithStats(calm)
    high = np.flatnonzero(centres[:, 1] < SKY * len(image))
    calm[np.isin(parts, np.union1d(parts[:6], high))] = 0
    dark_or_bright = (grey < 40) | (grey > 250)
    calm[dark_or_bright] = 0
    return Ground(image=image, free=calm * np.uint8(255), kind="facade")


def _cut(ground: Ground, rng: np.random.Generator, side_px: int) -> tuple[Canvas, Ground]:
    height, width = ground.image.shape[:2]
    low, high = (0.55, 1.5) if ground.kind == "facade" else (0.65, 1.6)
    scale = max(float(np.exp(rng.uniform(np.log(low), np.log(high)))), side_px / min(height, width) * 1.001)
    need = side_px / scale
    x, y = rng.uniform(0, width - need), rng.uniform(0, height - need)
    mirrored = rng.random() < 0.5
    turned = ground.kind == "close" and rng.random() < 0.5
    part = (slice(int(y), int(y + need)), slice(int(x), int(x + need)))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    image = cv2.resize(ground.image[part], (side_px, side_px), interpolation=method)
    free = cv2.resize(ground.free[part], (side_px, side_px), interpolation=cv2.INTER_NEAREST)
    corner = (ground.corner_px[0] - int(x)) * scale, (ground.corner_px[1] - int(y)) * scale
    if mirrored:
        image, free, corner = image[:, ::-1], free[:, ::-1], (side_px - corner[0], corner[1])
    if turned:
        image, free = image.transpose(1, 0, 2), free.T
    angle = rng.uniform(0, 2 * np.pi)
    canvas = Canvas(
        image=to_linear(np.ascontiguousarray(image)),
        free=np.ascontiguousarray(free).astype(np.float32) / np.float32(255),
        rng=rng,
        light=np.array([np.cos(angle), np.sin(angle)]),
    )
    brick = ground.brick_px and (ground.brick_px[0] * scale, ground.brick_px[1] * scale)
    cut = Ground(image=ground.image[:0], free=ground.free[:0], kind=ground.kind, brick_px=brick, corner_px=corner)
    return canvas, cut
