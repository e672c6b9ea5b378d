"""Boxes in pixels of the photograph as stored: left, top, width, height (COCO).

(0, 0) is the corner of the first pixel; its centre is (0.5, 0.5), as in COLMAP.
"""

from __future__ import annotations

from dataclasses import dataclass

# A smaller overhang is rounding by the tool that wrote the box; it is cut without a remark.
ROUNDING_PX = 1.0


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box in pixels; ``x_px``, ``y_px`` is its left top corner."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float


@dataclass(frozen=True, kw_only=True)
class ClippedBox:
    """The part of a box inside the photograph, None where no usable part is; ``remark``: the reason."""

    inside: Box | None
    remark: str = ""


def clip_box(box: Box, *, image_width_px: int, image_height_px: int) -> ClippedBox:
    """Clip ``box`` (of positive size) to the photograph.

    Annotation tools and detectors let boxes overhang the border: a box partly outside is clipped, with a remark. A box
    of which less than a pixel remains is outside.
    """
    left, top = max(box.x_px, 0.0), max(box.y_px, 0.0)
    right = min(box.x_px + box.width_px, float(image_width_px))
    bottom = min(box.y_px + box.height_px, float(image_height_px))
    stated = f"box {describe_box(box)}"
    image = f"the photograph ({image_width_px} x {image_height_px} px)"
    if right <= left or bottom <= top:
        return ClippedBox(inside=None, remark=f"{stated} lies outside {image}")
    if right - left < min(1.0, box.width_px) or bottom - top < min(1.0, box.height_px):
        return ClippedBox(inside=None, remark=f"{stated} has less than a pixel inside {image}")
    overhang = max(left - box.x_px, top - box.y_px, box.x_px + box.width_px - right, box.y_px + box.height_px - bottom)
    if overhang <= 0:
        return ClippedBox(inside=box)
    inside = Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top)
    if overhang <= ROUNDING_PX:
        return ClippedBox(inside=inside)
    return ClippedBox(inside=inside, remark=f"{stated} extends beyond {image} by {overhang:.1f} px and was clipped")


def describe_box(box: Box) -> str:
    """``at x, y of width x height px``, for a message."""
    return f"at {box.x_px:g}, {box.y_px:g} of {box.width_px:g} x {box.height_px:g} px"
