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


def read_exif_orientation(path: Path) -> int:
    """EXIF orientation, by which viewers turn the photograph (1 to 8); 1, as stored, where none is stated."""
    try:
        with PilImage.open(path) as image:
            orientation = image.getexif().get(Base.Orientation)
    except (OSError, SyntaxError, ValueError):
        return 1
    return orientation if isinstance(orientation, int) and 1 <= orientation <= 8 else 1
