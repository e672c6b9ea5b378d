"""Dark lines in a picture: how much each pixel looks like one, and how wide it would be."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.detect.measure.light import Grey

_SCALES_PX = (0.8, 1.2, 1.8, 2.7, 4.0, 6.0, 9.0, 13.5)
_WIDTH_OF_SCALE = 2.0  # sigma**2 times the second derivative of a bar is largest where sigma is half its width
_GAMMA = 1.5  # instead of 2: of two lines equally dark the narrower is the crack, the wider a course of bricks
_THIN = 20.0  # a crack is this many times longer than its ridge's scale, or more


@dataclass(frozen=True, kw_only=True, eq=False)
class Ridges:
    """``strength`` (h, w): curvature across the darkest line through a pixel, over the scales; ``width_px`` (h, w)."""

    strength: Grey
    width_px: Grey


def dark_lines(coded: Grey, length_px: float) -> Ridges:
    """Ridges of darkness in brightness (h, w) from the Hessian at the scales of a crack about ``length_px`` long.

    A blob bends both ways: what it bends along the line is taken off. Sources: Lindeberg, "Edge Detection and Ridge
    Detection with Automatic Scale Selection", IJCV 1998; Frangi et al., MICCAI 1998.
    """
    strength, width = np.zeros_like(coded), np.full_like(coded, _WIDTH_OF_SCALE * _SCALES_PX[0])
    for scale in _SCALES_PX:
        if scale > max(length_px / _THIN, _SCALES_PX[1]):
            break
        smooth = cv2.GaussianBlur(coded, (0, 0), sigmaX=scale, borderType=cv2.BORDER_REFLECT)
        found = _across(np.asarray(smooth, dtype=np.float32)) * np.float32(scale**_GAMMA)
        better = found > strength
        strength[better] = found[better]
        width[better] = _WIDTH_OF_SCALE * scale
    return Ridges(strength=strength, width_px=width)


def _across(smooth: Grey) -> Grey:
    xx = cv2.filter2D(smooth, -1, np.array([[1, -2, 1]], dtype=np.float32), borderType=cv2.BORDER_REFLECT)
    yy = cv2.filter2D(smooth, -1, np.array([[1], [-2], [1]], dtype=np.float32), borderType=cv2.BORDER_REFLECT)
    corner = np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 1]], dtype=np.float32) / 4
    xy = cv2.filter2D(smooth, -1, corner, borderType=cv2.BORDER_REFLECT)
    mean, away = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    most, least = mean + away, np.abs(mean - away)
    return np.asarray(np.maximum(most - least, 0), dtype=np.float32)
