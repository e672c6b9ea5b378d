"""Which photographs are of one camera, by their metadata."""

from __future__ import annotations

import math
from typing import Any

from facadelake.photos import FULL_FRAME_DIAGONAL_MM

# COLMAP's default where the metadata state no focal length: 1.2 times the longer side.
_DEFAULT_FOCAL_FACTOR = 1.2
# Photographs that differ in one of these, in size or in the prior of the focal length are of different cameras.
_CAMERA_COLUMNS = (
    "camera_make", "camera_model", "camera_serial", "lens_model", "image_source", "focal_length_mm", "digital_zoom",
    "exif_focal_length_35mm_mm",
)  # fmt: skip


def group_by_camera(rows: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[int]]:
    """The cameras of the photographs, and the camera (index) of each photograph.

    A camera is one body with one lens, image size, focal length and digital zoom. Where two of its photographs state
    different focal lengths by any tag, they are two cameras: one too many costs little, one too few bends the block.
    """
    index_of: dict[tuple[Any, ...], int] = {}
    cameras: list[dict[str, Any]] = []
    camera_index: list[int] = []
    for row in rows:
        width, height = row["image_width_px"], row["image_height_px"]
        focal_px, known = _choose_focal_px(row)
        body = tuple(row.get(name) for name in _CAMERA_COLUMNS)
        # Metadata state focal lengths with two or three digits: closer ones are one setting of the zoom.
        key = (*body, width, height, f"{focal_px:.2e}" if known else "")
        if key not in index_of:
            index_of[key] = len(cameras)
            cameras.append({"width_px": width, "height_px": height, "focal_px": focal_px, "focal_known": known})
        camera_index.append(index_of[key])
    return cameras, camera_index


def _choose_focal_px(row: dict[str, Any]) -> tuple[float, bool]:
    """The initial focal length, and whether it comes from the photograph's metadata."""
    width, height = row["image_width_px"], row["image_height_px"]
    if row.get("prior_focal_px"):
        return row["prior_focal_px"], True
    if row["focal_length_35mm_mm"]:
        return row["focal_length_35mm_mm"] * math.hypot(width, height) / FULL_FRAME_DIAGONAL_MM, True
    return _DEFAULT_FOCAL_FACTOR * max(width, height), False
