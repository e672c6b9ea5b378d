"""Photographs as grey gradients: read one at a time, reduced while decoding, comparable from place to place."""

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
_NOISE_GREY = 1.0  # grey values per pixel: gradients below are noise of the sensor and of JPEG
_WINDOW_SIGMAS = 6.0  # how far around a pixel its neighbours' gradients count


class GreyPhotographs(Protocol):
    """Photographs by row, as grey pixels (h, w) reduced by 1, 2, 4 or 8; pixel (x, y) lies at (x, y) / reduction."""

    def read_grey(self, row: int, reduction: int, /) -> UInt8Array: ...


@dataclass(frozen=True, kw_only=True)
class GreyFiles:
    """Photographs in files, each decoded when asked for; EXIF's orientation is not applied."""

    paths: Sequence[Path]

    def read_grey(self, row: int, reduction: int, /) -> UInt8Array:
        """Grey pixels of photograph ``row``; raises InputDataError where its file cannot be decoded."""
        path = self.paths[row]
        grey = (
            cv2.imread(str(path), _IMREAD_FLAGS[reduction] | cv2.IMREAD_IGNORE_ORIENTATION) if path.is_file() else None
        )
        if grey is None:
            raise InputDataError(f"photograph {path} cannot be decoded; is it there, and complete?")
        return np.asarray(grey, dtype=np.uint8)


def choose_reduction(pixels: float, camera: Camera) -> int:
    """The largest of 1, 2, 4, 8 that is no more than ``pixels``; more where the photograph would fill the memory."""
    wanted = max(n for n in _IMREAD_FLAGS if n == 1 or n <= pixels)
    return next(
        n for n in _IMREAD_FLAGS if n == 8 or (n >= wanted and camera.width_px * camera.height_px / n**2 <= _MAX_PX)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageGradients:
    """Gradients (h, w) of a reduced photograph, divided by what is usual around each pixel: lengths from 0 to 1."""

    x: Float32Array
    y: Float32Array
    reduction: int

    def sample_across(self, xy_img: Float64Array, normal_img: Float64Array) -> Float32Array:
        """Signed gradient along unit normals (..., 2) at pixels (..., 2) of the full photograph; 0 outside."""
        at = (xy_img / self.reduction - 0.5).astype(np.float32)
        shape = at.shape[:-1]
        # OpenCV's remap takes maps of at most 32767 rows or columns.
        u, v = at[..., 0].reshape(-1, 1), at[..., 1].reshape(-1, 1)
        found = np.zeros(len(u), dtype=np.float32)
        normal = normal_img.reshape(-1, 2).astype(np.float32)
        for begin in range(0, len(u), _MAX_REMAP_ROWS):
            part = slice(begin, begin + _MAX_REMAP_ROWS)
            gx = cv2.remap(self.x, u[part], v[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
            gy = cv2.remap(self.y, u[part], v[part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
            found[part] = gx[:, 0] * normal[part, 0] + gy[:, 0] * normal[part, 1]
        return found.reshape(shape)


_MAX_REMAP_ROWS = 32_000


def compute_gradients(grey: UInt8Array, *, reduction: int, sigma_px: float) -> ImageGradients:
    """Gradients of ``read_grey`` (already reduced) smoothed by ``sigma_px`` of its own pixels.

    Divided by the root of the squared length here and the mean squared length around, so that neither contrast nor a
    rough texture counts, only how far an edge stands out from its surroundings.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), sigma_px)
    x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    squared = cv2.multiply(x, x)
    cv2.accumulateSquare(y, squared)
    around = 2 * int(np.ceil(_WINDOW_SIGMAS * sigma_px)) + 1
    usual = np.asarray(cv2.blur(squared, (around, around)), dtype=np.float32)
    length = np.sqrt(usual + np.asarray(squared, dtype=np.float32) + (_NOISE_GREY / max(sigma_px, 1.0)) ** 2)
    return ImageGradients(
        x=np.asarray(cv2.divide(x, length), dtype=np.float32),
        y=np.asarray(cv2.divide(y, length), dtype=np.float32),
        reduction=reduction,
    )
