"""Reading of photographs at full or reduced resolution."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import UInt8Array
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError

_REDUCTION_FLAGS = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


def choose_reduction(pixel_m: float, cell_m: float) -> int:
    """The largest reduction of 1, 2, 4 and 8 at which a reduced pixel is no larger than a cell.

    ``pixel_m``: size of a full-resolution pixel on the surface; ``cell_m``: size of a cell; both in metres.
    """
    return max(n for n in _REDUCTION_FLAGS if n == 1 or n * pixel_m <= cell_m)


def name_photograph_files(photo_ids: Iterable[str]) -> dict[str, str]:
    """A file name without suffix for each photograph, by photo_id, unique also where upper and lower case are one.

    It is the photo_id with "_" for "/" and without suffix; where several would be the same, a hash of each is added.
    """
    names = {photo_id: photo_id.replace("/", "_").rsplit(".", 1)[0] for photo_id in photo_ids}
    counts = Counter(name.lower() for name in names.values())
    return {
        photo_id: name if counts[name.lower()] == 1 else f"{name}_{hashlib.sha256(photo_id.encode()).hexdigest()[:8]}"
        for photo_id, name in names.items()
    }


def decode_image(path: Path, flags: int) -> UInt8Array:
    """BGR pixels (h, w, 3) decoded by OpenCV with ``flags``; raises InputDataError where decoding fails."""
    bgr = cv2.imread(str(path), flags) if path.is_file() else None  # OpenCV prints a warning for a missing file
    if bgr is None:
        raise InputDataError(f"photograph {path} cannot be decoded; check that the file exists and is complete")
    return np.asarray(bgr, dtype=np.uint8)


def read_photograph(path: Path, camera: Camera, reduction: int = 1) -> UInt8Array:
    """RGB pixels (h, w, 3) in the pixel grid of the camera model, reduced by 1, 2, 4 or 8.

    A pixel (x, y) of the full photograph is at (x, y) / reduction. The EXIF orientation is applied only where the
    file's size matches the camera's size only with it. Raises InputDataError for a file that cannot be decoded or whose
    size differs from the camera's.
    """
    width, height = -(-camera.width_px // reduction), -(-camera.height_px // reduction)
    sizes = []
    for orientation in (cv2.IMREAD_IGNORE_ORIENTATION, 0):
        bgr = decode_image(path, _REDUCTION_FLAGS[reduction] | orientation)
        if abs(bgr.shape[1] - width) <= 1 and abs(bgr.shape[0] - height) <= 1:
            return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
        sizes.append(f"{bgr.shape[1]}x{bgr.shape[0]}")
    raise InputDataError(
        f"photograph {path} has {sizes[0]} pixels at reduction 1/{reduction}, its camera has {width}x{height}; "
        "restore the file as it was at ingestion"
    )
