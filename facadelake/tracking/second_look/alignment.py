"""The move of a patch in one photograph onto the same patch in another, within the accuracy of the poses."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import BoolArray

Detail = NDArray[np.float32]
_STRETCH_MAX_CELLS, _STRETCH_MAX_SHARE = 3.0, 0.05  # of a corner beyond the translation: more is no error of a pose
_BLUR_CELLS = 3
_STEPS, _STEP_MIN = 50, 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class Alignment:
    """Affine map (2, 3) from cells of the reference to those of the other patch, and the correlation of both once the
    patch is shifted as a whole."""

    warp: Detail
    correlation: float


def shift_patch(reference: Detail, view: Detail, reach_cells: float) -> Alignment:
    """The translation that fits best, in whole cells within ``reach_cells``."""
    height, width = reference.shape
    cells = max(1, min(round(reach_cells), (height - 9) // 2, (width - 9) // 2))
    scores = cv2.matchTemplate(view, reference[cells : height - cells, cells : width - cells], cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    warp = np.array([[1, 0, int(column) - cells], [0, 1, int(row) - cells]], dtype=np.float32)
    return Alignment(warp=warp, correlation=float(scores[row, column]))


def align_patch(reference: Detail, view: Detail, reach_cells: float, visible: BoolArray | None = None) -> Alignment:
    """The affine map, begun with a translation, which stands where no better map is found.

    Args:
        reference: detail (h, w) of the patch in one photograph.
        view: that of another photograph.
        reach_cells: largest displacement.
        visible: cells (h, w) of ``view`` that count; None: all.
    """
    start = shift_patch(reference, view, reach_cells)
    height, width = reference.shape
    counted = np.full(view.shape, 255, dtype=np.uint8) if visible is None else visible.astype(np.uint8) * np.uint8(255)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, _STEPS, _STEP_MIN)
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]).T
    with suppress(cv2.error):  # no convergence
        _, found = cv2.findTransformECC(
            reference, view, start.warp.copy(), cv2.MOTION_AFFINE, criteria, counted, _BLUR_CELLS
        )
        warp = np.asarray(found, dtype=np.float32)
        limit = _STRETCH_MAX_CELLS + _STRETCH_MAX_SHARE * max(height, width)
        if np.abs(warp @ corners - start.warp @ corners).max() <= limit:
            return Alignment(warp=warp, correlation=start.correlation)
    return start


def move_patch(view: Detail, warp: Detail) -> Detail:
    """A patch moved onto the reference of ``align_patch``."""
    height, width = view.shape
    flags = cv2.INTER_LINEAR + cv2.WARP_INVERSE_MAP
    moved = cv2.warpAffine(view, warp, (width, height), flags=flags, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(moved, dtype=np.float32)
