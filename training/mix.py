"""Random training examples: a picture of a random site is placed and augmented; some are composed of four pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, Float64Nx4, Int64Array, UInt8Image
from training.colour import augment_image
from training.transplant import transplant_cracks
from training.view import PAD_VALUE, Placement, View, place_boxes, place_image

_CRACK, _MOISTURE = 0, 2
_SCALES = (0.55, 2.2)
_CLOSE_SHARE = 0.5  # share of the pictures with spalling or moisture in which one defect is shown enlarged
_CLOSE_FILLS = (0.35, 1.3)  # its longer side as a share of the input's shorter side; beyond 1 it is cut
_CLOSE_GAIN_MAX = 4.0


@dataclass(frozen=True, kw_only=True)
class Example:
    """An input of the network (side, side, 3) with its boxes (n, 4: x_min, y_min, x_max, y_max) and classes (n,)."""

    image: UInt8Image
    boxes_px: Float64Nx4
    classes: Int64Array


@dataclass(frozen=True, kw_only=True)
class Pool:
    """Views of one kind, chosen with weight ``share``; ``weights``: probabilities (n,) of the views within the pool."""

    name: str
    share: float
    views: Sequence[View]
    weights: Float64Array

    def draw(self, rng: np.random.Generator) -> View:
        """Draw a view at random."""
        return self.views[int(rng.choice(len(self.views), p=self.weights))]


@dataclass(frozen=True, kw_only=True)
class Mix:
    """Pools of views; ``walls``: pictures without defects, to which real cracks are transplanted."""

    pools: Sequence[Pool]
    walls: Pool
    side_px: int
    transplant_share: float
    mosaic_share: float

    def draw_example(self, rng: np.random.Generator, *, mosaic_share: float | None = None) -> Example:
        """Draw a random example; with ``mosaic_share`` 0 always of a single picture."""
        share = self.mosaic_share if mosaic_share is None else mosaic_share
        return self._draw_mosaic(rng) if rng.random() < share else self._draw_single(rng)

    def _draw_view(self, rng: np.random.Generator) -> View:
        shares = np.array([pool.share for pool in self.pools])
        view = self.pools[int(rng.choice(len(self.pools), p=shares / shares.sum()))].draw(rng)
        if len(view.classes) and rng.random() < self.transplant_share:
            view = transplant_cracks(view, self.walls.draw(rng).image, rng)
        return view

    def _draw_single(self, rng: np.random.Generator) -> Example:
        view = self._draw_view(rng)
        placement = draw_placement(view, self.side_px, self.side_px, rng)
        boxes, classes = place_boxes(view, placement)
        return Example(image=augment_image(place_image(view.image, placement), rng), boxes_px=boxes, classes=classes)

    def _draw_mosaic(self, rng: np.random.Generator) -> Example:
        """Draw four pictures around a random centre."""
        side = self.side_px
        x, y = (int(v) for v in rng.uniform(0.3, 0.7, 2) * side)
        image = np.full((side, side, 3), PAD_VALUE, np.uint8)
        boxes, classes = [], []
        for left, top, right, bottom in ((0, 0, x, y), (x, 0, side, y), (0, y, x, side), (x, y, side, side)):
            view = self._draw_view(rng)
            placement = draw_placement(view, right - left, bottom - top, rng)
            image[top:bottom, left:right] = augment_image(place_image(view.image, placement), rng)
            placed, kinds = place_boxes(view, placement)
            boxes.append(placed + np.array([left, top, left, top]))
            classes.append(kinds)
        return Example(image=image, boxes_px=np.concatenate(boxes), classes=np.concatenate(classes))


def draw_placement(view: View, width_px: int, height_px: int, rng: np.random.Generator) -> Placement:
    """Draw rotation, scale and position of a view on an input of this size.

    At scale 1 the whole picture just fits, as at inference. Pictures with moisture, which runs down, are mirrored only;
    those with spalling are rotated by multiples of 90 degrees, those with cracks alone by any angle.
    """
    height, width = view.image.shape[:2]
    gain = max(width_px, height_px) / max(width, height) * np.exp(rng.uniform(*np.log(_SCALES)))
    areas = np.flatnonzero(view.classes != _CRACK)
    close = view.boxes_px[rng.choice(areas)] if len(areas) and rng.random() < _CLOSE_SHARE else None
    if close is not None:
        fills = rng.uniform(*_CLOSE_FILLS) * min(width_px, height_px)
        gain = min(_CLOSE_GAIN_MAX, fills / max(float((close[2:] - close[:2]).max()), 1.0))
    stretch = np.exp(rng.normal(0, 0.07))
    matrix = np.diag([gain * stretch, gain / stretch])
    if rng.random() < 0.5:
        matrix = matrix @ np.diag([-1, 1])
    if _MOISTURE not in view.classes:
        matrix = _create_rotation(90.0 * int(rng.integers(4)) if len(view.classes) else 0.0) @ matrix
        if rng.random() < 0.35 and all(path is not None for path in view.paths):
            matrix = _create_rotation(rng.uniform(-45, 45) if rng.random() < 0.3 else rng.normal(0, 7)) @ matrix
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) @ matrix.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = np.array([width_px, height_px]) - (high - low)
    shift = rng.uniform(0, 1, 2) * room
    if close is not None:
        corners = close[[0, 1, 2, 1, 2, 3, 0, 3]].reshape(4, 2) @ matrix.T
        close_low, close_high = corners.min(axis=0), corners.max(axis=0)
        spare = np.array([width_px, height_px]) - (close_high - close_low)
        shift = rng.uniform(0.0, 1.0, 2) * spare - (close_low - low)
    elif (room > 0).all() and rng.random() < 0.5:
        shift = np.zeros(2)  # in the top left corner, as at inference
    return Placement(input_from_image=np.column_stack([matrix, shift - low]), width_px=width_px, height_px=height_px)


def _create_rotation(degrees: float) -> Float64Array:
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[cos, -sin], [sin, cos]])
