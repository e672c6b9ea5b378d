"""Tiles about reviewed places: each holds its place whole, and shows nothing that nobody has judged."""

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

_CONTEXT_FACTOR = 1.2  # a tile's side over its place's, so that what surrounds it is seen too
_SHIFT_SHARE_MAX = (
    0.7  # how far a place may lie off the tile's centre, of what keeps it whole: models learn where boxes lie
)
_VISIBLE_SHARE_MIN = 0.3  # a defect of which less is in the tile is hidden rather than labelled
_FILL_GREY = 114  # what hides, as detectors' padding


@dataclass(frozen=True, kw_only=True)
class TrainingTile:
    """A part of a photograph, whole pixels: its left, top, width, height, and what is seen in it.

    ``defects`` are in the tile's own pixels; ``hidden`` are rectangles (left, top, right, bottom) of the tile to be
    made grey, ``kept`` those that must not be.
    """

    left_px: int
    top_px: int
    width_px: int
    height_px: int
    defects: tuple[TrainingBox, ...]
    hidden: tuple[tuple[int, int, int, int], ...]
    kept: tuple[tuple[int, int, int, int], ...]


def place_tiles(
    material: ReviewedPhotograph, *, image_width_px: int, image_height_px: int, side_px: int
) -> tuple[TrainingTile, ...]:
    """Tiles of ``side_px`` (larger where a place needs it) that hold every reviewed place of the photograph once."""
    places = [one.box for one in material.defects] + list(material.rejected)
    frames: list[tuple[int, int, int, int]] = []
    for box in sorted(places, key=lambda box: (-box.width_px * box.height_px, box.y_px, box.x_px)):
        if not any(_contains(frame, box) for frame in frames):
            frames.append(_place_frame(material.photo_id, box, image_width_px, image_height_px, side_px))
    return tuple(_build_tile(material, frame) for frame in frames)


def crop_tile(tile: TrainingTile, image_bgr: UInt8Image) -> UInt8Image:
    """The tile's pixels, with what nobody has judged in grey."""
    part = image_bgr[tile.top_px : tile.top_px + tile.height_px, tile.left_px : tile.left_px + tile.width_px].copy()
    cover = np.zeros(part.shape[:2], dtype=bool)
    for value, rectangles in ((True, tile.hidden), (False, tile.kept)):
        for left, top, right, bottom in rectangles:
            cover[top:bottom, left:right] = value
    part[cover] = _FILL_GREY
    return part


def _place_frame(photo_id: str, box: Box, width: int, height: int, side_px: int) -> tuple[int, int, int, int]:
    """Left, top, width, height of a tile about ``box``; the same place always gets the same tile."""
    dice = hashlib.sha256(f"{photo_id} {box.x_px:.1f} {box.y_px:.1f}".encode()).digest()
    side = max(side_px, round(_CONTEXT_FACTOR * max(box.width_px, box.height_px)))
    frame = []
    for first, extent, whole, byte in (
        (box.x_px, box.width_px, width, dice[0]),
        (box.y_px, box.height_px, height, dice[1]),
    ):
        size = min(side, whole)
        off = _SHIFT_SHARE_MAX * (byte / 255 - 0.5) * max(0.0, size - extent)
        frame.append((int(np.clip(round(first + extent / 2 - size / 2 + off), 0, whole - size)), size))
    (left, tile_width), (top, tile_height) = frame
    return left, top, tile_width, tile_height


def _contains(frame: tuple[int, int, int, int], box: Box) -> bool:
    left, top, width, height = frame
    across = left <= box.x_px and box.x_px + box.width_px <= left + width
    return across and top <= box.y_px and box.y_px + box.height_px <= top + height


def _build_tile(material: ReviewedPhotograph, frame: tuple[int, int, int, int]) -> TrainingTile:
    left, top, width, height = frame
    window = shapely.box(left, top, left + width, top + height)
    defects, kept, hidden = [], [], []
    for one in material.defects:
        seen = _clip_to_frame(one.box, frame)
        if seen is None:
            continue
        if seen.width_px * seen.height_px < _VISIBLE_SHARE_MIN * one.box.width_px * one.box.height_px:
            hidden.append(_round_outwards(seen))
            continue
        kept.append(_round_outwards(seen))
        if one.mask is None:
            defects.append(TrainingBox(box=seen, defect_class=one.defect_class))
        elif (mask := extract_polygons(affinity.translate(one.mask.intersection(window), -left, -top))) is not None:
            defects.append(TrainingBox(box=seen, defect_class=one.defect_class, mask=mask))
    kept += _clip_boxes(material.rejected, frame)
    hidden += _clip_boxes(material.unreviewed, frame)
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
    return [_round_outwards(seen) for box in boxes if (seen := _clip_to_frame(box, frame)) is not None]


def _clip_to_frame(box: Box, frame: tuple[int, int, int, int]) -> Box | None:
    """The box in the tile's pixels, cut to it; None where nothing of a pixel's size is left."""
    left, top, width, height = frame
    x, y = max(box.x_px - left, 0.0), max(box.y_px - top, 0.0)
    right, bottom = min(box.x_px + box.width_px - left, width), min(box.y_px + box.height_px - top, height)
    if right - x < 1 or bottom - y < 1:
        return None
    return Box(x_px=x, y_px=y, width_px=right - x, height_px=bottom - y)


def _round_outwards(box: Box) -> tuple[int, int, int, int]:
    """The whole pixels that a box touches."""
    return (
        int(np.floor(box.x_px)),
        int(np.floor(box.y_px)),
        int(np.ceil(box.x_px + box.width_px)),
        int(np.ceil(box.y_px + box.height_px)),
    )
