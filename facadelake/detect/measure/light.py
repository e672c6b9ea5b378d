"""A photograph's pixels as light: what blur and averaging act on is linear light, not the coded values of a file."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.float32]


def coded_grey(image_bgr: NDArray[np.uint8]) -> Grey:
    """Brightness (h, w), 0 to 1, as the file codes it: JPEG keeps this one channel at full resolution."""
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY) / np.float32(255), dtype=np.float32)


def linear(coded: Grey) -> Grey:
    """The light behind coded values, by sRGB's curve (IEC 61966-2-1); a camera's own tone curve is not known."""
    low = coded / np.float32(12.92)
    high = ((coded + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.asarray(np.where(coded <= 0.04045, low, high), dtype=np.float32)
