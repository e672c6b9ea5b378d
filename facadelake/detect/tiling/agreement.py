"""Whether parts seen in two tiles can be the same thing: by what each would show in the strip that both tiles share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from facadelake.frames import Array

Corners = Array  # (n, 4): left, top, right, bottom in pixels of the photograph
Shapes = Sequence[shapely.Geometry | None]

# A box that is filled to its corners agrees as a whole; a line that is straight in both goes before it.
_FILLED = 0.5


def agreement(a: Corners, b: Corners, window: Corners, *, masks_a: Shapes, masks_b: Shapes, slack_px: float) -> Array:
    """How well the parts a and b (n) agree within ``window`` (n), 0 to 1; edges may be wrong by ``slack_px``.

    Masks tell it where both have one: the share of the smaller that lies in the other. Of boxes, where a line along the
    same diagonal of both would run within the window, or both boxes as a whole for half as much.
    """
    lines = [_overlaps(_diagonal(a, window, up), _diagonal(b, window, up), slack_px) for up in (False, True)]
    filled = _overlaps(common(a, window), common(b, window), slack_px)
    fit = np.maximum(np.maximum(*lines), _FILLED * filled)
    for i, (one, two) in enumerate(zip(masks_a, masks_b, strict=True)):
        if one is not None and two is not None:
            fit[i] = _masks_agree(one, two, shapely.box(*window[i]), slack_px)
    return fit


def common(a: Corners, b: Corners) -> Corners:
    """What boxes a and b (n, 4) share; turned inside out where that is nothing."""
    return np.column_stack([np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, 2:], b[:, 2:])])


def areas(corners: Corners) -> Array:
    """Areas (n,) in square pixels, 0 of what is turned inside out."""
    area: Array = np.prod(np.clip(corners[:, 2:] - corners[:, :2], 0.0, None), axis=1)
    return area


def grown(corners: Corners, by_px: float) -> Corners:
    """Boxes with all sides moved outwards."""
    larger: Corners = corners + np.array([-by_px, -by_px, by_px, by_px])
    return larger


def shares(part: Corners, whole: Corners) -> Array:
    """How much (n,) of each part's area lies in its whole."""
    share: Array = areas(common(part, whole)) / np.maximum(areas(part), 1e-9)
    return share


def overlap(a: shapely.Geometry, b: shapely.Geometry) -> float:
    """Intersection over union of two areas."""
    both = a.intersection(b).area
    return float(both / max(a.area + b.area - both, 1e-9))


def _overlaps(a: Corners, b: Corners, slack_px: float) -> Array:
    """Intersection over union (n,) of boxes grown by the slack; 0 where one of them is turned inside out."""
    there = (a[:, 2:] >= a[:, :2]).all(axis=1) & (b[:, 2:] >= b[:, :2]).all(axis=1)
    a, b = grown(a, slack_px), grown(b, slack_px)
    both = areas(common(a, b))
    share: Array = np.where(there, both / np.maximum(areas(a) + areas(b) - both, 1e-9), 0.0)
    return share


def _diagonal(box: Corners, window: Corners, up: bool) -> Corners:
    """Bounds of a box's diagonal within the window: from its left top down, or from its left bottom ``up``."""
    start = np.column_stack([box[:, 0], box[:, 3] if up else box[:, 1]])
    step = np.column_stack([box[:, 2] - box[:, 0], (box[:, 1] - box[:, 3]) if up else (box[:, 3] - box[:, 1])])
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    at = np.stack([(window[:, :2] - start) / safe, (window[:, 2:] - start) / safe])
    low = np.clip(at.min(axis=0).max(axis=1), 0.0, None)[:, None]
    high = np.clip(at.max(axis=0).min(axis=1), None, 1.0)[:, None]
    ends = np.stack([start + low * step, start + high * step])
    bounds = np.column_stack([ends.min(axis=0), ends.max(axis=0)])
    return np.where(low <= high, bounds, np.array([1.0, 1.0, 0.0, 0.0]))


def _masks_agree(a: shapely.Geometry, b: shapely.Geometry, window: shapely.Geometry, slack_px: float) -> float:
    """How much of the smaller mask's part in the window lies in the other's, grown by the slack of its edges."""
    one, two = sorted((a.intersection(window), b.intersection(window)), key=lambda shape: float(shape.area))
    if one.area == 0:
        return 0.0
    return float(one.intersection(two.buffer(slack_px)).area / one.area)
