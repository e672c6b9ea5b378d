"""A photograph read as detectors read it: pixels as stored, whatever orientation its EXIF asks for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image as PilImage
from PIL.ExifTags import Base

from facadelake.core.arrays import UInt8Image


def read_photograph(path: Path) -> UInt8Image | None:
    """The photograph (h, w, 3: blue, green, red), or None where it cannot be decoded."""
    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except (cv2.error, MemoryError):  # a size beyond OpenCV's limit, or the machine's
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


def has_exif_rotation(path: Path) -> bool:
    """Whether EXIF asks for another orientation than the pixels of a readable photograph are stored in."""
    with PilImage.open(path) as image:
        return bool(image.getexif().get(Base.Orientation, 1) not in (0, 1))
