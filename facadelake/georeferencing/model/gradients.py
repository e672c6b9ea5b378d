"""Image gradients of photographs: read one at a time, reduced while decoding, normalised by their surroundings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from facadelake.core.arrays import Float32Array, Float64Array, UInt8Array
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError

_IMREAD_FLAGS = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}
_MAX_PX = 16e6
_NOISE_GREY = 1.0  # grey values per pixel: smaller gradients are noise of the sensor and of JPEG
_WINDOW_SIGMAS = 6.0  # half width of the window whose gradients normalise a pixel
_MAX_REMAP_ROWS = 32_000


class GreyPhotographs(Protocol):
    """Photographs by row, as grey pixels (h, w) reduced by 1, 2, 4 or 8; pixel (x, y) lies at (x, y) / reduction."""

    def read_grey(self, row: int, reduction: int, /) -> UInt8Array: ...


@dataclass(frozen=True, kw_only=True)
class GreyFiles:
    """Photographs in files, each decoded when requested; EXIF's orientation is not applied."""

    paths: Sequence[Path]

    def read_grey(self, row: int, reduction: int, /) -> UInt8Array:
        """Grey pixels (h, w) of photograph ``row``; raises InputDataError where its file cannot be decoded."""
        path = self.paths[row]
        flags = _IMREAD_FLAGS[reduction] | cv2.IMREAD_IGNORE_ORIENTATION
        grey = cv2.imread(str(path), flags) if path.is_file() else None
        if grey is None:
            raise InputDataError(f"photograph {path} cannot be decoded; check that the file exists and is complete")
        return np.asarray(grey, dtype=np.uint8)


def choose_reduction(pixels: float, camera: Camera) -> int:
    """The largest of 1, 2, 4, 8 up to ``pixels``; a larger one where the photograph would exceed the memory."""
    wanted = max(n for n in _IMREAD_FLAGS if n == 1 or n <= pixels)
    return next(
        n for n in _IMREAD_FLAGS if n == 8 or (n >= wanted and camera.width_px * camera.height_px / n**2 <= _MAX_PX)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageGradients:
    """Gradients (h, w) of a reduced photograph, normalised by those around each pixel: lengths from 0 to 1."""

    x: Float32Array
    y: Float32Array
    reduction: int

    def sample_across(self, xy_img: Float64Array, normal_img: Float64Array) -> Float32Array:
        """Signed gradient (...) along unit normals (..., 2) at pixels (..., 2) of the full photograph; 0 outside."""
        xy = (xy_img / self.reduction - 0.5).astype(np.float32)
        shape = xy.shape[:-1]
        # OpenCV's remap takes maps of at most 32767 rows or columns.
        u, v = xy[..., 0].reshape(-1, 1), xy[..., 1].reshape(-1, 1)
        across = np.zeros(len(u), dtype=np.float32)
        normal = normal_img.reshape(-1, 2).astype(np.float32)
        for begin in range(0, len(u), _MAX_REMAP_ROWS):
            part = slice(begin, begin + _MAX_REMAP_ROWS)
            gx = cv2.remap(self.x, u[part], v[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
            gy = cv2.remap(self.y, u[part], v[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
            across[part] = gx[:, 0] * normal[part, 0] + gy[:, 0] * normal[part, 1]
        return across.reshape(shape)


def compute_gradients(grey: UInt8Array, *, reduction: int, sigma_px: float) -> ImageGradients:
    """Gradients of ``grey`` (h, w; already reduced), smoothed by ``sigma_px`` of its own pixels.

    Divided by the root of the squared length at the pixel plus the mean squared length around it, so that neither
    contrast nor texture counts, but how far an edge exceeds its surroundings.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), sigma_px)
    x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    squared = cv2.multiply(x, x)
    cv2.accumulateSquare(y, squared)
    window = 2 * int(np.ceil(_WINDOW_SIGMAS * sigma_px)) + 1
    mean = np.asarray(cv2.blur(squared, (window, window)), dtype=np.float32)
    length = np.sqrt(mean + np.asarray(squared, dtype=np.float32) + (_NOISE_GREY / max(sigma_px, 1.0)) ** 2)
    return ImageGradients(
        x=np.asarray(cv2.divide(x, length), dtype=np.float32),
        y=np.asarray(cv2.divide(y, length), dtype=np.float32),
        reduction=reduction,
    )
