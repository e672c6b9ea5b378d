"""Boxes in pixels of the photograph as stored: left, top, width, height, with (0, 0) the corner of the first pixel.

That is COCO's convention, and ours: the centre of the top left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass

# A box that sticks out by less is rounding of the tool that wrote it; it is cut without a remark.
ROUNDING_PX = 1.0


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box in pixels."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float


@dataclass(frozen=True, kw_only=True)
class ClippedBox:
    """What of a box lies inside the photograph; ``inside`` is None where nothing usable does; ``remark`` says why."""

    inside: Box | None
    remark: str = ""


def clip_box(box: Box, *, image_width_px: int, image_height_px: int) -> ClippedBox:
    """Cut ``box`` (of positive size) to the photograph.

    A box partly outside is kept as far as it lies inside, with a remark, because annotation tools and detectors let
    boxes overhang the border. One of which less than a pixel remains is outside.
    """
    left, top = max(box.x_px, 0.0), max(box.y_px, 0.0)
    right = min(box.x_px + box.width_px, float(image_width_px))
    bottom = min(box.y_px + box.height_px, float(image_height_px))
    whole = f"box {describe_box(box)}"
    image = f"the photograph ({image_width_px} x {image_height_px} px)"
    if right <= left or bottom <= top:
        return ClippedBox(inside=None, remark=f"{whole} lies outside {image}")
    if right - left < min(1.0, box.width_px) or bottom - top < min(1.0, box.height_px):
        return ClippedBox(inside=None, remark=f"{whole} has less than a pixel inside {image}")
    overhang = max(left - box.x_px, top - box.y_px, box.x_px + box.width_px - right, box.y_px + box.height_px - bottom)
    if overhang <= 0:
        return ClippedBox(inside=box)
    inside = Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top)
    if overhang <= ROUNDING_PX:
        return ClippedBox(inside=inside)
    return ClippedBox(inside=inside, remark=f"{whole} sticks out of {image} by {overhang:.1f} px; cut to it")


def describe_box(box: Box) -> str:
    """``x, y, width x height`` for a message."""
    return f"at {box.x_px:g}, {box.y_px:g} of {box.width_px:g} x {box.height_px:g} px"
