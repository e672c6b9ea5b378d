"""Surfaces without defects to draw on: parts of the real training pictures, and synthetic ones."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from facadelake.reviews.training import Split
from training.data.cracks import read_cracks
from training.data.negatives import read_negatives
from training.data.sample import Sample
from training.generate.brickwork import Brick, read_bricks
from training.generate.canvas import Canvas, linear_from_stored
from training.generate.surfaces import Background, generate_bricks, generate_concrete, generate_plaster, generate_stones

MARGIN_PX = 12  # a crack may extend beyond its box
SIDE_MIN_PX = 180  # narrower parts without boxes are too small to be extended by reflection
SKY_SHARE = 0.22  # share of the height; uniform parts with their centre above are assumed to be sky
SITE_PICTURES_MAX = 17  # number of pictures, so that no site dominates
EXCLUDED_PICTURES = frozenset({
    "ac-11-_jpg", "ac-14-_jpg", "ac-15-_jpg", "ac-74-_jpg", "ac-80-_jpg", "a-1-50-_jpg", "a-1-107-_jpg",
    "MAX_1631_4_2", "MAX_1644_2_4", "MAX_1641_9_3", "MAX_1641_12_6", "MAX_1647_7_18", "MAX_1641_2_2", "MAX_1647_4_5",
    "MAX_1638_2_2", "20160316_142014_jpg", "a-1-127-_jpg", "040_jpg", "b-1-175-_jpg", "b-1-176-_jpg", "b-1-177-_jpg",
})  # fmt: skip
"""Pictures with a visible defect outside their boxes."""
EXCLUDED_SITES = frozenset({"crack_boxes_640/web_a"})


@dataclass(frozen=True, kw_only=True)
class Backgrounds:
    """Surfaces to draw on: close views of real walls and floors, whole facades, synthetic walls; single real bricks."""

    close: tuple[Background, ...]
    facades: tuple[Background, ...]
    synthetic: tuple[Background, ...]
    bricks: tuple[Brick, ...]

    def create_canvas(self, rng: np.random.Generator, side_px: int) -> tuple[Canvas, Background]:
        """Cut a canvas from a random surface, at a random place and scale, mirrored or not.

        Returns the canvas (side, side), and the surface without its image: kind and bricks, in pixels of the canvas.
        """
        kinds = [(self.close, 0.42), (self.facades, 0.18), (self.synthetic, 0.4)]
        kinds = [(kind, weight) for kind, weight in kinds if kind]
        weights = np.array([weight for _, weight in kinds])
        kind = kinds[rng.choice(len(kinds), p=weights / weights.sum())][0]
        return _cut_canvas(kind[int(rng.integers(len(kind)))], rng, side_px)


def load_backgrounds(data: Path, *, seed: int = 0, synthetic: int = 120) -> Backgrounds:
    """Read all real surfaces of train sites, and generate `synthetic` walls; takes about half a minute.

    `data`: folder with `defects` and `drone`.
    """
    rng = np.random.default_rng(seed)
    generators = (
        generate_bricks,
        generate_bricks,
        generate_plaster,
        generate_plaster,
        generate_concrete,
        generate_concrete,
        generate_stones,
    )
    return Backgrounds(
        close=tuple(_list_close_views(read_cracks(data / "defects"))),
        facades=tuple(_read_facade(sample) for sample in read_negatives(data) if sample.split is Split.TRAIN),
        bricks=read_bricks(data / "defects"),
        synthetic=tuple(generators[number % len(generators)](rng) for number in range(synthetic)),
    )


def _list_close_views(samples: Iterable[Sample]) -> Iterable[Background]:
    by_site: dict[str, list[Sample]] = {}
    for sample in samples:
        clean = sample.path.stem not in EXCLUDED_PICTURES and sample.site not in EXCLUDED_SITES
        if sample.split is Split.TRAIN and clean:
            by_site.setdefault(sample.site, []).append(sample)
    for site in sorted(by_site):
        kept = 0
        # The order does not change with further pictures: the selected ones were inspected.
        for sample in sorted(by_site[site], key=lambda sample: zlib.crc32(sample.path.stem.encode())):
            image = _cut_part_without_boxes(sample)
            if image is not None and kept < SITE_PICTURES_MAX:
                kept += 1
                yield Background(image=image, free=np.full(image.shape[:2], 255, dtype=np.uint8), kind="close")


def _cut_part_without_boxes(sample: Sample) -> UInt8Image | None:
    """The largest rectangle outside all boxes, extended by reflection to the size of the picture; None if none."""
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
                    size = (x1 - x0) * (y1 - y0) if min(x1 - x0, y1 - y0) >= SIDE_MIN_PX * width / 640 else 0
                    if size > area and not touched.any():
                        best, area = (x0, y0, x1, y1), size
    if not area:
        return None
    part = image[best[1] : best[3], best[0] : best[2]]
    padded = cv2.copyMakeBorder(part, 0, height - part.shape[0], 0, width - part.shape[1], cv2.BORDER_REFLECT_101)
    return np.asarray(padded, dtype=np.uint8)


def _read_facade(sample: Sample) -> Background:
    """A whole facade; uniform parts are assumed to be wall, except the largest ones and those near the top (sky)."""
    image = sample.read()
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    change = cv2.blur(cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)), (15, 15))
    calm = (change < 14).astype(np.uint8)
    _, parts, _, centres = cv2.connectedComponentsWithStats(calm)
    high = np.flatnonzero(centres[:, 1] < SKY_SHARE * len(image))
    calm[np.isin(parts, np.union1d(parts[:6], high))] = 0
    dark_or_bright = (grey < 40) | (grey > 250)
    calm[dark_or_bright] = 0
    return Background(image=image, free=calm * np.uint8(255), kind="facade")


def _cut_canvas(background: Background, rng: np.random.Generator, side_px: int) -> tuple[Canvas, Background]:
    height, width = background.image.shape[:2]
    low, high = (0.55, 1.5) if background.kind == "facade" else (0.65, 1.6)
    scale = max(float(np.exp(rng.uniform(np.log(low), np.log(high)))), side_px / min(height, width) * 1.001)
    need = side_px / scale
    x, y = rng.uniform(0, width - need), rng.uniform(0, height - need)
    mirrored = rng.random() < 0.5
    turned = background.kind == "close" and rng.random() < 0.5
    part = (slice(int(y), int(y + need)), slice(int(x), int(x + need)))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    image = cv2.resize(background.image[part], (side_px, side_px), interpolation=method)
    free = cv2.resize(background.free[part], (side_px, side_px), interpolation=cv2.INTER_NEAREST)
    corner = (background.corner_px[0] - int(x)) * scale, (background.corner_px[1] - int(y)) * scale
    if mirrored:
        image, free, corner = image[:, ::-1], free[:, ::-1], (side_px - corner[0], corner[1])
    if turned:
        image, free = image.transpose(1, 0, 2), free.T
    angle = rng.uniform(0, 2 * np.pi)
    canvas = Canvas(
        image=linear_from_stored(np.ascontiguousarray(image)),
        free=np.ascontiguousarray(free).astype(np.float32) / np.float32(255),
        rng=rng,
        light=np.array([np.cos(angle), np.sin(angle)]),
    )
    brick = background.brick_px and (background.brick_px[0] * scale, background.brick_px[1] * scale)
    cut = Background(
        image=background.image[:0], free=background.free[:0], kind=background.kind, brick_px=brick, corner_px=corner
    )
    return canvas, cut
