"""What the network is shown: random pictures of random sites, laid out, disturbed, and put together now and then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.colour import disturbed
from training.transplant import transplanted
from training.view import PAD_VALUE, Placing, View, lay_boxes, lay_image

_CRACK, _MOISTURE = 0, 2
_SCALES = (0.55, 2.2)
_CLOSE_SHARE = 0.5  # of the pictures with spalling or moisture: one of them is shown close,
_CLOSE_FILLS = (0.35, 1.3)  # so that it fills this much of the input (more than 1: it is cut),
_CLOSE_MOST = 4.0  # enlarged so many times at most


@dataclass(frozen=True, kw_only=True)
class Example:
    """One input of the network and what is to be found in it."""

    image: NDArray[np.uint8]
    boxes_px: NDArray[np.float64]
    classes: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Pool:
    """Views of one kind, drawn with ``share``; a view is drawn with its own ``weights`` (they add up to 1)."""

    name: str
    share: float
    views: Sequence[View]
    weights: NDArray[np.float64]

    def draw(self, rng: np.random.Generator) -> View:
        """One view."""
        return self.views[int(rng.choice(len(self.views), p=self.weights))]


@dataclass(frozen=True, kw_only=True)
class Mix:
    """Pools to draw from; ``walls`` are pictures without defects, onto which real cracks are transplanted."""

    pools: Sequence[Pool]
    walls: Pool
    side_px: int
    transplant_share: float
    mosaic_share: float

    def example(self, rng: np.random.Generator, *, mosaic_share: float | None = None) -> Example:
        """A random example; ``mosaic_share`` 0 shows single pictures alone."""
        share = self.mosaic_share if mosaic_share is None else mosaic_share
        return self._mosaic(rng) if rng.random() < share else self._single(rng)

    def _view(self, rng: np.random.Generator) -> View:
        shares = np.array([pool.share for pool in self.pools])
        view = self.pools[int(rng.choice(len(self.pools), p=shares / shares.sum()))].draw(rng)
        if len(view.classes) and rng.random() < self.transplant_share:
            view = transplanted(view, self.walls.draw(rng).image, rng)
        return view

    def _single(self, rng: np.random.Generator) -> Example:
        view = self._view(rng)
        placing = random_placing(view, self.side_px, self.side_px, rng)
        boxes, classes = lay_boxes(view, placing)
        return Example(image=disturbed(lay_image(view.image, placing), rng), boxes_px=boxes, classes=classes)

    def _mosaic(self, rng: np.random.Generator) -> Example:
        """Four pictures about a random centre."""
        side = self.side_px
        x, y = (int(v) for v in rng.uniform(0.3, 0.7, 2) * side)
        image = np.full((side, side, 3), PAD_VALUE, np.uint8)
        boxes, classes = [], []
        for left, top, right, bottom in ((0, 0, x, y), (x, 0, side, y), (0, y, x, side), (x, y, side, side)):
            view = self._view(rng)
            placing = random_placing(view, right - left, bottom - top, rng)
            image[top:bottom, left:right] = disturbed(lay_image(view.image, placing), rng)
            laid, kinds = lay_boxes(view, placing)
            boxes.append(laid + np.array([left, top, left, top]))
            classes.append(kinds)
        return Example(image=image, boxes_px=np.concatenate(boxes), classes=np.concatenate(classes))


def random_placing(view: View, width_px: int, height_px: int, rng: np.random.Generator) -> Placing:
    """A random turn, size and place of a view on an input of that size.

    Size 1 is the whole picture just fitting in, as the finished detector sees a small one. Moisture runs down and is
    only mirrored; areas are turned by right angles, cracks by any.
    """
    height, width = view.image.shape[:2]
    gain = max(width_px, height_px) / max(width, height) * np.exp(rng.uniform(*np.log(_SCALES)))
    areas = np.flatnonzero(view.classes != _CRACK)
    close = view.boxes_px[rng.choice(areas)] if len(areas) and rng.random() < _CLOSE_SHARE else None
    if close is not None:
        fills = rng.uniform(*_CLOSE_FILLS) * min(width_px, height_px)
        gain = min(_CLOSE_MOST, fills / max(float((close[2:] - close[:2]).max()), 1.0))
    stretch = np.exp(rng.normal(0, 0.07))
    matrix = np.diag([gain * stretch, gain / stretch])
    if rng.random() < 0.5:
        matrix = matrix @ np.diag([-1, 1])
    if _MOISTURE not in view.classes:
        matrix = _turn(90.0 * int(rng.integers(4)) if len(view.classes) else 0.0) @ matrix
        if rng.random() < 0.35 and all(path is not None for path in view.paths):
            matrix = _turn(rng.uniform(-45, 45) if rng.random() < 0.3 else rng.normal(0, 7)) @ matrix
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) @ matrix.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = np.array([width_px, height_px]) - (high - low)
    shift = rng.uniform(0, 1, 2) * room
    if close is not None:
        corners = close[[0, 1, 2, 1, 2, 3, 0, 3]].reshape(4, 2) @ matrix.T
        at = corners.min(axis=0), corners.max(axis=0)
        spare = np.array([width_px, height_px]) - (at[1] - at[0])
        shift = rng.uniform(0.0, 1.0, 2) * spare - (at[0] - low)
    elif (room > 0).all() and rng.random() < 0.5:
        shift = np.zeros(2)  # at the left top corner, as the letterbox has it
    return Placing(input_from_image=np.column_stack([matrix, shift - low]), width_px=width_px, height_px=height_px)


def _turn(degrees: float) -> NDArray[np.float64]:
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[cos, -sin], [sin, cos]])
