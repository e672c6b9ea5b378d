"""A real crack on another wall: its darkness, as a share of the wall about it, multiplied onto the other picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from training.view import View

_REACH_PX = 9  # how far from its way a crack may be dark
_WALL_PX = 11  # closing dark gaps of this size, at half the scale, leaves the wall without its crack
_NOTHING = 0.92  # of the wall's grey; what is lighter is the wall's own grain
_TRIES = 4
_VISIBLE = 10.0  # grey levels that a crack must be darker than the wall, and as much as the wall's own grain


def transplanted(view: View, wall: NDArray[np.uint8], rng: np.random.Generator) -> View:
    """The view's cracks, with their boxes, on a random piece of ``wall``.

    The view itself where it has no crack, or where its cracks would be lost (in a tree, at night).
    """
    if not view.paths or any(path is None for path in view.paths):
        return view
    height, width = view.image.shape[:2]
    grey = cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY)
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    closed = cv2.blur(cv2.morphologyEx(half, cv2.MORPH_CLOSE, np.ones((_WALL_PX, _WALL_PX), np.uint8)), (9, 9))
    share = grey.astype(np.float32) / np.maximum(cv2.resize(closed, (width, height)), 8)
    share /= max(float(np.median(share[::4, ::4])), 0.1)
    lines = [np.round(path.points_px).astype(np.int32) for path in view.paths if path is not None]
    near = np.zeros((height, width), np.uint8)
    cv2.polylines(near, lines, False, 255, 2 * _REACH_PX)
    soft = cv2.GaussianBlur(near, (0, 0), 3).astype(np.float32) / 255
    factor = 1 - soft * (1 - np.clip(share / _NOTHING, 0.1, 1))
    darker = min(
        1 - float(np.median(factor[line[:, 1].clip(0, height - 1), line[:, 0].clip(0, width - 1)])) for line in lines
    )
    for _ in range(_TRIES):
        piece = _piece(wall, width, height, rng)
        tone = cv2.cvtColor(piece, cv2.COLOR_BGR2GRAY)[near > 0].astype(np.float32)
        if darker * tone.mean() > max(_VISIBLE, tone.std()):
            return replace(view, image=np.asarray(cv2.multiply(piece, cv2.merge([factor] * 3), dtype=cv2.CV_8U)))
    return view


def _piece(wall: NDArray[np.uint8], width: int, height: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """A part of the wall, at most twice enlarged, mirrored now and then."""
    shrink = min(wall.shape[1] / width, wall.shape[0] / height) / rng.uniform(1, 2)
    columns, rows = (max(2, int(side * shrink)) for side in (width, height))
    x, y = int(rng.integers(0, wall.shape[1] - columns + 1)), int(rng.integers(0, wall.shape[0] - rows + 1))
    part = wall[y : y + rows, x : x + columns]
    piece = cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR if shrink < 1 else cv2.INTER_AREA)
    return np.asarray(piece[:, ::-1] if rng.random() < 0.5 else piece, dtype=np.uint8)
