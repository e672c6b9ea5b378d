"""Walls laid from real bricks (`wall_crops`, MIT): sound ones, and cracked, spalled or white ones with their boxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

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
    """One brick lying flat, BGR, and the index of what it has in `CLASSES`; None: it is sound."""

    image: NDArray[np.uint8]
    index: int | None


def read_bricks(defects: Path) -> tuple[Brick, ...]:
    """The set's own training part; its `val` bricks are left to be judged by."""
    bricks = []
    for folder, kind in FOLDERS.items():
        for path in sorted((defects / "wall_crops" / "crops" / folder).glob("train__*.jpg")):
            image = np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR), dtype=np.uint8)
            flat = image if image.shape[1] > image.shape[0] else np.ascontiguousarray(np.rot90(image))
            bricks.append(Brick(image=flat, index=None if kind is None else CLASSES.index(kind)))
    return tuple(bricks)


def lay_wall(
    rng: np.random.Generator, bricks: tuple[Brick, ...], side_px: int
) -> tuple[NDArray[np.uint8], list[list[float]], list[int]]:
    """A wall of chance bricks: the picture (side, side, 3), boxes x_min, y_min, x_max, y_max px, and their classes."""
    sound = [brick for brick in bricks if brick.index is None]
    hurt = [brick for brick in bricks if brick.index is not None]
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
            chosen = hurt if rng.random() < share else sound
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
