"""Tiles around the reviewed locations of a photograph; detections without a review are painted over."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import affinity

from facadelake.core.arrays import UInt8Image
from facadelake.detection import Box
from facadelake.detection.coco import extract_polygons
from facadelake.reviews.training.reviewed_photographs import ReviewedPhotograph, TrainingBox

_CONTEXT_FACTOR = 1.2  # least side of a tile over that of its box, so that the tile shows the surroundings
# Largest shift of a box from the tile's centre, as a share of what keeps the box inside the tile. If all boxes were at
# the centre, a model would learn that position.
_SHIFT_SHARE_MAX = 0.7
_VISIBLE_SHARE_MIN = 0.3  # a defect with a smaller share of its area in the tile is painted over, not labelled
_FILL_GREY = 114  # the padding of common detectors


@dataclass(frozen=True, kw_only=True)
class TrainingTile:
    """A part of a photograph in whole pixels, with its labels.

    ``defects`` are in pixels of the tile, and so are the rectangles (left, top, right, bottom): ``hidden`` are painted
    grey except where ``kept`` overlap them.
    """

    left_px: int
    top_px: int
    width_px: int
    height_px: int
    defects: tuple[TrainingBox, ...]
    hidden: tuple[tuple[int, int, int, int], ...]
    kept: tuple[tuple[int, int, int, int], ...]


def place_tiles(
    photograph: ReviewedPhotograph, *, image_width_px: int, image_height_px: int, side_px: int
) -> tuple[TrainingTile, ...]:
    """Place tiles so that each reviewed box of a photograph lies inside at least one.

    Args:
        photograph: The reviewed photograph.
        image_width_px: Its width.
        image_height_px: Its height.
        side_px: Side of a tile; a larger box gets a larger tile.
    """
    boxes = [one.box for one in photograph.defects] + list(photograph.rejected)
    frames: list[tuple[int, int, int, int]] = []
    for box in sorted(boxes, key=lambda box: (-box.width_px * box.height_px, box.y_px, box.x_px)):
        if not any(_contains(frame, box) for frame in frames):
            frames.append(_place_frame(photograph.photo_id, box, image_width_px, image_height_px, side_px))
    return tuple(_build_tile(photograph, frame) for frame in frames)


def crop_tile(tile: TrainingTile, image_bgr: UInt8Image) -> UInt8Image:
    """The tile's pixels (h, w, 3); rectangles without a review are grey."""
    part = image_bgr[tile.top_px : tile.top_px + tile.height_px, tile.left_px : tile.left_px + tile.width_px].copy()
    cover = np.zeros(part.shape[:2], dtype=bool)
    for value, rectangles in ((True, tile.hidden), (False, tile.kept)):
        for left, top, right, bottom in rectangles:
            cover[top:bottom, left:right] = value
    part[cover] = _FILL_GREY
    return part


def _place_frame(photo_id: str, box: Box, width: int, height: int, side_px: int) -> tuple[int, int, int, int]:
    """Left, top, width, height of a tile around ``box``. The shift is the same for the same photograph and box."""
    digest = hashlib.sha256(f"{photo_id} {box.x_px:.1f} {box.y_px:.1f}".encode()).digest()
    side = max(side_px, round(_CONTEXT_FACTOR * max(box.width_px, box.height_px)))
    frame = []
    for first, extent, length, byte in (
        (box.x_px, box.width_px, width, digest[0]),
        (box.y_px, box.height_px, height, digest[1]),
    ):
        size = min(side, length)
        shift = _SHIFT_SHARE_MAX * (byte / 255 - 0.5) * max(0.0, size - extent)
        frame.append((int(np.clip(round(first + extent / 2 - size / 2 + shift), 0, length - size)), size))
    (left, tile_width), (top, tile_height) = frame
    return left, top, tile_width, tile_height


def _contains(frame: tuple[int, int, int, int], box: Box) -> bool:
    left, top, width, height = frame
    across = left <= box.x_px and box.x_px + box.width_px <= left + width
    return across and top <= box.y_px and box.y_px + box.height_px <= top + height


def _build_tile(photograph: ReviewedPhotograph, frame: tuple[int, int, int, int]) -> TrainingTile:
    left, top, width, height = frame
    window = shapely.box(left, top, left + width, top + height)
    defects, kept, hidden = [], [], []
    for one in photograph.defects:
        clipped = _clip_to_frame(one.box, frame)
        if clipped is None:
            continue
        if clipped.width_px * clipped.height_px < _VISIBLE_SHARE_MIN * one.box.width_px * one.box.height_px:
            hidden.append(_round_outwards(clipped))
            continue
        kept.append(_round_outwards(clipped))
        if one.mask is None:
            defects.append(TrainingBox(box=clipped, defect_class=one.defect_class))
        elif (mask := extract_polygons(affinity.translate(one.mask.intersection(window), -left, -top))) is not None:
            defects.append(TrainingBox(box=clipped, defect_class=one.defect_class, mask=mask))
    kept += _clip_boxes(photograph.rejected, frame)
    hidden += _clip_boxes(photograph.unreviewed, frame)
    return TrainingTile(
        left_px=left,
        top_px=top,
        width_px=width,
        height_px=height,
        defects=tuple(defects),
        hidden=tuple(hidden),
        kept=tuple(kept),
    )


def _clip_boxes(boxes: Sequence[Box], frame: tuple[int, int, int, int]) -> list[tuple[int, int, int, int]]:
    return [_round_outwards(clipped) for box in boxes if (clipped := _clip_to_frame(box, frame)) is not None]


def _clip_to_frame(box: Box, frame: tuple[int, int, int, int]) -> Box | None:
    """The box clipped to the tile, in pixels of the tile; None where it is smaller than a pixel."""
    left, top, width, height = frame
    x, y = max(box.x_px - left, 0.0), max(box.y_px - top, 0.0)
    right, bottom = min(box.x_px + box.width_px - left, width), min(box.y_px + box.height_px - top, height)
    if right - x < 1 or bottom - y < 1:
        return None
    return Box(x_px=x, y_px=y, width_px=right - x, height_px=bottom - y)


def _round_outwards(box: Box) -> tuple[int, int, int, int]:
    """The length pixels that a box touches."""
    return (
        int(np.floor(box.x_px)),
        int(np.floor(box.y_px)),
        int(np.ceil(box.x_px + box.width_px)),
        int(np.ceil(box.y_px + box.height_px)),
    )
