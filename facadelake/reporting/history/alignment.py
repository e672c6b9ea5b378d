"""Two rectified pictures of one place brought into agreement, and their difference without the light.

The alignment is that of the second look; here the wall around the defect alone decides, in what is visible of it.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, UInt8Image
from facadelake.reporting.cards.patch_view import EMPTY_GREY, PatchView
from facadelake.reporting.drawing.palette import bgr_from_hex
from facadelake.tracking import align_patch, extract_detail

DARKER, LIGHTER = "#d55e00", "#0072b2"  # Okabe and Ito 2008
_ALIGNED_MIN = 0.2  # correlation below which the pictures show different things
_SIGMAS_FROM, _SIGMAS_TO = 2.5, 8.0  # a difference begins to be coloured, and is fully coloured
_BORDER = 6  # cells beside the border or beside hidden ones, where the detail has no surroundings
_FILL_SIGMA_PX = 6.0
_NOISE_FLOOR = 0.01  # of log grey values
_MAD_TO_SIGMA = 1.4826
_EDGE_SIGMAS = 4.0


def find_alignment(reference: PatchView, view: PatchView, reach_px: float) -> Float64Array | None:
    """The affine map (2, 3) from pixels of ``reference`` to those of ``view``; None where they do not agree.

    The wall around the defect decides: the defect itself may have changed.

    Args:
        reference: rectified photograph.
        view: another one of the same place.
        reach_px: largest displacement.
    """
    first, second = (_extract_surroundings(one) for one in (reference, view))
    found = align_patch(first, second, reach_px, view.visible)
    return None if found.correlation < _ALIGNED_MIN else found.warp.astype(np.float64)


def apply_alignment(view: PatchView, warp: Float64Array) -> PatchView:
    """The view in the pixels of the reference of ``find_alignment``."""
    height, width = view.visible.shape
    flags = cv2.INTER_LINEAR + cv2.WARP_INVERSE_MAP
    empty = (EMPTY_GREY,) * 3
    picture = cv2.warpAffine(view.picture, warp, (width, height), flags=flags, borderValue=empty)
    visible = cv2.warpAffine(view.visible.astype(np.uint8) * 255, warp, (width, height), flags=flags) > 250
    return replace(view, picture=np.asarray(picture, dtype=np.uint8), visible=visible)


def render_difference(before: PatchView, after: PatchView) -> UInt8Image:
    """The later picture in pale grey, with what became darker and what became lighter in two colours.

    Light is removed first. A difference is coloured by how far it is beyond the differences that prevail in the
    picture, most of which shows what did not change.

    Args:
        before: the earlier view.
        after: the later view, aligned.

    Returns:
        The picture (h, w, 3), RGB.
    """
    first, second = (_extract(one.picture, one.visible) for one in (before, after))
    both = (before.visible & after.visible).astype(np.uint8)
    kernel = np.ones((2 * _BORDER + 1, 2 * _BORDER + 1), np.uint8)
    used = cv2.erode(both, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0).astype(bool)
    grey = cv2.cvtColor(after.picture, cv2.COLOR_RGB2GRAY)
    picture = np.repeat((150 + 0.4 * grey)[..., None], 3, axis=2)
    if used.any():
        energy = float(first[used] @ first[used])
        gain = float(np.clip(first[used] @ second[used] / energy, 0.5, 2.0)) if energy > 0 else 1.0
        difference = cv2.GaussianBlur(second - gain * first, (0, 0), 1.0)
        sigma = max(_NOISE_FLOOR, _MAD_TO_SIGMA * float(np.median(np.abs(difference[used]))))
        share = np.clip((np.abs(difference) / sigma - _SIGMAS_FROM) / (_SIGMAS_TO - _SIGMAS_FROM), 0, 1) * used
        darker, lighter = (np.array(bgr_from_hex(colour)[::-1], dtype=np.float64) for colour in (DARKER, LIGHTER))
        colour = np.where((difference < 0)[..., None], darker, lighter)
        picture += share[..., None] * (colour - picture)
    return np.clip(picture + 0.5, 0, 255).astype(np.uint8)


def _extract_surroundings(view: PatchView) -> Float32Array:
    """Detail (h, w) around the defect, limited so that a few strong edges do not decide; zero on the defect."""
    detail = _extract(view.picture, view.visible)
    cells = len(detail)
    defect = np.zeros(detail.shape, dtype=np.uint8)
    for ring in view.rings_m:
        corners = np.column_stack([ring[:, 0], -ring[:, 1]]) / view.cell_m + cells / 2
        cv2.fillPoly(defect, [np.round(corners).astype(np.int32)], 1)
    defect = np.asarray(cv2.dilate(defect, np.ones((_BORDER, _BORDER), np.uint8)), dtype=np.uint8)
    around = view.visible & (defect == 0)
    if not around.any():
        return detail
    limit = _EDGE_SIGMAS * max(_NOISE_FLOOR, _MAD_TO_SIGMA * float(np.median(np.abs(detail[around]))))
    limited: Float32Array = np.where(around, np.clip(detail, -limit, limit), 0).astype(np.float32)
    return limited


def _extract(picture: UInt8Image, visible: BoolArray) -> Float32Array:
    """Detail (h, w) of a picture; cells that are not visible take the mean of what is near, so that they have none."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    weight = visible.astype(np.float32)
    near = cv2.GaussianBlur(grey * weight, (0, 0), _FILL_SIGMA_PX)
    known = cv2.GaussianBlur(weight, (0, 0), _FILL_SIGMA_PX)
    mean = float(grey[visible].mean()) if visible.any() else 0.0
    filled = np.where(visible, grey, np.where(known > 1e-3, near / np.maximum(known, 1e-3), mean))
    detail: Float32Array = extract_detail(filled.astype(np.float32))
    return detail
