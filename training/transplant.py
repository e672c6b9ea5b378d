"""Transplantation of real cracks to other walls: the other picture is multiplied by the crack's relative darkness."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Image
from training.view import View

_HALF_WIDTH_PX = 9  # half width of the zone along the path that belongs to the crack
_CLOSING_PX = 11  # size of the morphological closing, at half scale, that removes the crack from the wall
_TEXTURE_RATIO = 0.92  # of the wall's grey level; ratios above this are texture of the wall, not crack
_TRIES = 4
_CONTRAST_MIN = 10.0  # grey levels between crack and wall; also at least the standard deviation of the wall


def transplant_cracks(view: View, wall: UInt8Image, rng: np.random.Generator) -> View:
    """Transplant the cracks of a view, with their boxes, to a random piece of the picture ``wall`` (h, w, 3).

    Returns the view itself if it has no cracks or other defects too, or if its cracks would not be visible on the wall.
    """
    if not view.paths or any(path is None for path in view.paths):
        return view
    height, width = view.image.shape[:2]
    grey = cv2.cvtColor(view.image, cv2.COLOR_BGR2GRAY)
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    closed = cv2.blur(cv2.morphologyEx(half, cv2.MORPH_CLOSE, np.ones((_CLOSING_PX, _CLOSING_PX), np.uint8)), (9, 9))
    ratio = grey.astype(np.float32) / np.maximum(cv2.resize(closed, (width, height)), 8)
    ratio /= max(float(np.median(ratio[::4, ::4])), 0.1)
    lines = [np.round(path.points_px).astype(np.int32) for path in view.paths if path is not None]
    near = np.zeros((height, width), np.uint8)
    cv2.polylines(near, lines, False, 255, 2 * _HALF_WIDTH_PX)
    zone = cv2.GaussianBlur(near, (0, 0), 3).astype(np.float32) / 255
    factor = 1 - zone * (1 - np.clip(ratio / _TEXTURE_RATIO, 0.1, 1))
    darkness = min(
        1 - float(np.median(factor[line[:, 1].clip(0, height - 1), line[:, 0].clip(0, width - 1)])) for line in lines
    )
    for _ in range(_TRIES):
        piece = _cut_piece(wall, width, height, rng)
        tone = cv2.cvtColor(piece, cv2.COLOR_BGR2GRAY)[near > 0].astype(np.float32)
        if darkness * tone.mean() > max(_CONTRAST_MIN, tone.std()):
            return replace(view, image=np.asarray(cv2.multiply(piece, cv2.merge([factor] * 3), dtype=cv2.CV_8U)))
    return view


def _cut_piece(wall: UInt8Image, width: int, height: int, rng: np.random.Generator) -> UInt8Image:
    """Cut a random part (height, width, 3) of the wall, enlarged and mirrored at random."""
    shrink = min(wall.shape[1] / width, wall.shape[0] / height) / rng.uniform(1, 2)
    columns, rows = (max(2, int(side * shrink)) for side in (width, height))
    x, y = int(rng.integers(0, wall.shape[1] - columns + 1)), int(rng.integers(0, wall.shape[0] - rows + 1))
    part = wall[y : y + rows, x : x + columns]
    piece = cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR if shrink < 1 else cv2.INTER_AREA)
    return np.asarray(piece[:, ::-1] if rng.random() < 0.5 else piece, dtype=np.uint8)
