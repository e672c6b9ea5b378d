"""The blur over a photograph: lenses are less sharp towards the border, and a photograph may be moved or defocused."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx2, UInt8Image
from facadelake.measurement.blur import TYPICAL_BLUR, estimate_blur, grey_from_bgr, linearise_srgb

_PIECE_PX = 320
_COLUMNS, _ROWS = 4, 3
_LARGE_BLUR_PX = 1.5  # more is measured at half the resolution
_MIN_SIDE_PX = 100  # of a reduced photograph


@dataclass(frozen=True, kw_only=True, eq=False)
class BlurMap:
    """Standard deviation of the point spread (rows, columns), px, in equal parts of a photograph; NaN: unknown."""

    sigma_px: Float64Array
    width_px: int
    height_px: int

    def get_sigma_px(self, xy_img: Float64Nx2) -> Float64N:
        """The blur (n,) in the part of the photograph that contains each pixel (n, 2); NaN where it is unknown."""
        rows, columns = self.sigma_px.shape
        column = np.clip(xy_img[:, 0] * columns / self.width_px, 0, columns - 1).astype(np.int64)
        row = np.clip(xy_img[:, 1] * rows / self.height_px, 0, rows - 1).astype(np.int64)
        sigma: Float64N = self.sigma_px[row, column]
        return sigma


def map_blur(image: UInt8Image) -> BlurMap:
    """Measure the blur in the parts of a photograph (h, w, 3: blue, green, red), each at a piece in its centre.

    A part is given the median of itself and its neighbours, which is robust against pieces with soft edges only; parts
    without edges around them are given the median of the photograph, and NaN where it has too few edges anywhere.
    A large blur, as of a photograph out of focus, drowns in the noise at full resolution, which shows about 2 px for
    any of it or no edge at all: it is measured in the photograph reduced to a half, a quarter or an eighth.
    """
    height, width = image.shape[:2]
    sigma_px = _smooth_blur(_measure_parts(image))
    for reduction in (2, 4, 8):
        is_large = np.isnan(sigma_px) | (sigma_px > _LARGE_BLUR_PX * reduction / 2)
        if not is_large.any() or min(height, width) < reduction * _MIN_SIDE_PX:
            break
        size = (width // reduction, height // reduction)
        reduced = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        coarse = reduction * _smooth_blur(_measure_parts(reduced))
        sigma_px = np.where(is_large & ~np.isnan(coarse), np.fmax(sigma_px, coarse), sigma_px)
    return BlurMap(sigma_px=sigma_px, width_px=width, height_px=height)


def _measure_parts(image: UInt8Image) -> Float64Array:
    """Blur (rows, columns) of the piece in the centre of each part, px of ``image``; NaN: too few edges."""
    height, width = image.shape[:2]
    measured = np.full((_ROWS, _COLUMNS), np.nan)
    for row in range(_ROWS):
        for column in range(_COLUMNS):
            top = max(0, int((row + 0.5) * height / _ROWS) - _PIECE_PX // 2)
            left = max(0, int((column + 0.5) * width / _COLUMNS) - _PIECE_PX // 2)
            piece = image[top : top + _PIECE_PX, left : left + _PIECE_PX]
            blur = estimate_blur(linearise_srgb(grey_from_bgr(piece)))
            if blur is not TYPICAL_BLUR:
                measured[row, column] = blur.sigma_px
    return measured


def _smooth_blur(measured: Float64Array) -> Float64Array:
    if np.isnan(measured).all():
        return measured
    padded = np.pad(measured, 1, constant_values=np.nan)
    rows, columns = measured.shape
    around = np.stack([padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # parts without an edge around them
        smooth: Float64Array = np.nanmedian(around, axis=0)
    return np.where(np.isnan(smooth), np.nanmedian(measured), smooth)
