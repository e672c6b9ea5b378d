"""Walls composed of real bricks (`wall_crops`, MIT): sound, cracked, spalled, and with efflorescence, with boxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from schemas.vocabulary import DefectClass
from training.data.sample import CLASSES

FOLDERS: Mapping[str, DefectClass | None] = {
    "intact": None,
    "crack": DefectClass.CRACK,
    "spalling": DefectClass.SPALLING,
    "efflorescence": DefectClass.MOISTURE,
}


@dataclass(frozen=True, kw_only=True)
class Brick:
    """A brick (h, w, 3: blue, green, red; wider than high), and the index of its defect in `CLASSES`; None if sound."""

    image: UInt8Image
    index: int | None


def read_bricks(defects: Path) -> tuple[Brick, ...]:
    """Bricks of the training part of `wall_crops`; those of its `val` part are for evaluation."""
    bricks = []
    for folder, kind in FOLDERS.items():
        for path in sorted((defects / "wall_crops" / "crops" / folder).glob("train__*.jpg")):
            image = np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR), dtype=np.uint8)
            flat = image if image.shape[1] > image.shape[0] else np.ascontiguousarray(np.rot90(image))
            bricks.append(Brick(image=flat, index=None if kind is None else CLASSES.index(kind)))
    return tuple(bricks)


def lay_wall(
    rng: np.random.Generator, bricks: tuple[Brick, ...], side_px: int
) -> tuple[UInt8Image, list[list[float]], list[int]]:
    """Compose a wall of random bricks.

    Returns the picture (side, side, 3), boxes x_min, y_min, x_max, y_max in pixels, and their class indices.
    """
    sound = [brick for brick in bricks if brick.index is None]
    damaged = [brick for brick in bricks if brick.index is not None]
    share = rng.choice([0.0, 0.04, 0.15])
    course = int(rng.uniform(0.08, 0.3) * side_px)
    joint = max(2, round(course * rng.uniform(0.04, 0.1)))
    mortar = rng.uniform(15, 140) * rng.normal(1, 0.04, 3)
    wall = np.clip(rng.normal(1, 0.08, (side_px, side_px, 1)) * mortar, 0, 255).astype(np.uint8)
    boxes: list[list[float]] = []
    classes: list[int] = []
    for y in range(-int(rng.integers(course)), side_px, course + joint):
        x = -int(rng.integers(course * 4))
        while x < side_px:
            chosen = damaged if rng.random() < share else sound
            brick = chosen[int(rng.integers(len(chosen)))]
            width = max(course, round(course * brick.image.shape[1] / brick.image.shape[0]))
            image = cv2.resize(brick.image, (width, course), interpolation=cv2.INTER_AREA)
            image = cv2.convertScaleAbs(image[:, :: rng.choice([-1, 1])], alpha=float(rng.normal(1, 0.07)))
            x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + width, side_px), min(y + course, side_px)
            if x1 > x0 and y1 > y0:
                wall[y0:y1, x0:x1] = image[y0 - y : y1 - y, x0 - x : x1 - x]
                if brick.index is not None and (x1 - x0) * (y1 - y0) > 0.3 * width * course:
                    boxes.append([float(x0), float(y0), float(x1), float(y1)])
                    classes.append(brick.index)
            x += width + joint
    return wall, boxes, classes
