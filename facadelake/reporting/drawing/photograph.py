"""Reading a photograph's pixels, small where small will do."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Array
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError

_REDUCED = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


def choose_reduction(pixel_m: float, cell_m: float) -> int:
    """The largest of 1, 2, 4, 8 at which a reduced pixel of ``pixel_m`` stays no larger than ``cell_m``."""
    return max(n for n in _REDUCED if n == 1 or n * pixel_m <= cell_m)


def decode_image(path: Path, flags: int) -> UInt8Array:
    """BGR pixels (h, w, 3) by OpenCV; raises InputDataError where there are none."""
    bgr = cv2.imread(str(path), flags) if path.is_file() else None  # OpenCV prints a warning for a missing file
    if bgr is None:
        raise InputDataError(f"photograph {path} cannot be decoded; is it there, and complete?")
    return np.asarray(bgr, dtype=np.uint8)


def read_photograph(path: Path, camera: Camera, reduction: int = 1) -> UInt8Array:
    """RGB pixels (h, w, 3) as the camera model counts them, reduced by 1, 2, 4 or 8.

    A pixel (x, y) of the full photograph lies at (x, y) / reduction. Raises InputDataError for a file that cannot be
    decoded or has another size than its camera; the EXIF orientation is applied only where the size asks for it.
    """
    width, height = -(-camera.width_px // reduction), -(-camera.height_px // reduction)
    sizes = []
    for orientation in (cv2.IMREAD_IGNORE_ORIENTATION, 0):
        bgr = decode_image(path, _REDUCED[reduction] | orientation)
        if abs(bgr.shape[1] - width) <= 1 and abs(bgr.shape[0] - height) <= 1:
            return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
        sizes.append(f"{bgr.shape[1]}x{bgr.shape[0]}")
    raise InputDataError(
        f"photograph {path} is {sizes[0]} pixels at 1/{reduction}, its camera says {width}x{height}; "
        "was the file changed after it was ingested?"
    )
