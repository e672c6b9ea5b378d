"""Exclusion masks: images beside the photographs whose black pixels are excluded."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray, Float64N, Float64Nx4
from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError

_BLACK_BELOW = 128  # masks saved as JPEG are not purely black and white


def read_mask(mask: Path, camera: Camera) -> BoolArray:
    """Where the mask is black (h, w), in pixels of the photograph.

    Raises InputDataError for a mask that cannot be decoded or is not of the photograph's size.
    """
    grey = cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION) if mask.is_file() else None
    if grey is None:
        raise InputDataError(
            f"mask {mask} cannot be decoded; save it as PNG, black where detections are to be excluded"
        )
    if grey.shape != (camera.height_px, camera.width_px):
        raise InputDataError(
            f"mask {mask} is {grey.shape[1]}x{grey.shape[0]} pixels, its photograph {camera.width_px}x"
            f"{camera.height_px}; save it in the size of the photograph"
        )
    return np.asarray(grey < _BLACK_BELOW)


def compute_masked_shares(mask: Path, camera: Camera, boxes_px: Float64Nx4) -> Float64N:
    """Share (n,) of each box (n, 4; x, y, width, height) that is black in the mask; 0 for a box outside the photograph.

    Raises InputDataError as ``read_mask`` does.
    """
    black = read_mask(mask, camera)
    shares = np.zeros(len(boxes_px))
    size = np.array([camera.width_px, camera.height_px])
    low = np.clip(np.floor(boxes_px[:, :2]), 0, size).astype(int)
    high = np.clip(np.ceil(boxes_px[:, :2] + boxes_px[:, 2:]), 0, size).astype(int)
    for i, ((left, top), (right, bottom)) in enumerate(zip(low, high, strict=True)):
        inside = black[top:bottom, left:right]
        if inside.size:
            shares[i] = float(inside.mean())
    return shares
