"""Photographs read for detectors: pixels as stored, the EXIF orientation is ignored.

A module of its own, so that other packages read photographs without importing onnxruntime.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image as PilImage
from PIL.ExifTags import Base

from facadelake.core.arrays import UInt8Image


def read_photograph(path: Path) -> UInt8Image | None:
    """The photograph (h, w, 3: blue, green, red); None where it cannot be decoded."""
    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, MemoryError):  # a size beyond OpenCV's limit, or beyond memory
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


def has_exif_rotation(path: Path) -> bool:
    """Whether EXIF requests an orientation other than that of the stored pixels (a rotation or reflection)."""
    with PilImage.open(path) as image:
        return bool(image.getexif().get(Base.Orientation, 1) not in (0, 1))
