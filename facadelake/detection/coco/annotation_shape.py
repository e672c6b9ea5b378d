"""Box and mask of a COCO annotation, in pixels of the photograph as stored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import shapely
import shapely.affinity

from facadelake.detection.boxes import Box, describe_box
from facadelake.detection.coco.coco_records import CocoAnnotation, is_same_area, parse_box_values, parse_number
from facadelake.detection.coco.exif_view import BoxView
from facadelake.detection.coco.mask import extract_polygons, shape_from_segmentation

_MIN_SIDE_PX = 1.0
_SAME_SIDE_PX = 1.0  # sides of a mask and its box, rounded to whole pixels
_SAME_SIDE_SHARE = 0.01


@dataclass(frozen=True, kw_only=True)
class AnnotationShape:
    """Box and mask of an annotation, not clipped to the photograph.

    ``box`` is None where its numbers cannot be read. ``problem``: why it cannot be used, else empty. ``mask``:
    polygons, None where there is none. ``remarks``: what was not used, or disagrees.
    """

    box: Box | None = None
    mask: Any | None = None
    problem: str = ""
    remarks: tuple[str, ...] = ()


def parse_shape(annotation: CocoAnnotation, view: BoxView) -> AnnotationShape:
    """Box and mask of an annotation of an image with this view, turned by its ``rotation``.

    An annotation with a mask, and no box or one without size, has the mask's bounds. CVAT writes the box before its
    rotation; the box of the result bounds the turned one.
    """
    mask, remark = shape_from_segmentation(annotation.segmentation, view.width_px, view.height_px)
    remarks = [remark] if remark else []
    bbox = annotation.bbox
    values = parse_box_values(bbox)
    if mask is not None and (bbox is None or bbox == [] or (values is not None and not any(values[2:]))):
        if bbox:
            remarks.append(f"its bbox {bbox} has no size: the bounds of its mask are used")
        values = _bound(mask)
    elif not isinstance(bbox, list) or len(bbox) != 4:
        return AnnotationShape(problem=f"bbox is {bbox!r}; it must be [x, y, width, height] in pixels")
    if values is None:
        return AnnotationShape(problem=f"bbox is {bbox}; its four values must be finite numbers")
    box = Box(x_px=values[0], y_px=values[1], width_px=values[2], height_px=values[3])
    if box.width_px <= 0 or box.height_px <= 0:
        problem = f"box {describe_box(box)}: width and height must be more than 0 px"
        return AnnotationShape(box=box, problem=problem)
    if box.width_px < _MIN_SIDE_PX and box.height_px < _MIN_SIDE_PX:
        problem = f"box {describe_box(box)} is smaller than a pixel: in shares of the photograph? give pixels"
        return AnnotationShape(box=box, problem=problem)
    area = parse_number(annotation.area)
    if area is not None and area > 0 and mask is None and not is_same_area(area, box.width_px * box.height_px):
        remarks.append(f"area is {area:g}, but its box is {box.width_px:g} x {box.height_px:g} px; the box is used")
    if annotation.rotation is not None:
        angle = parse_number(annotation.rotation)
        if angle is None:
            return AnnotationShape(
                box=view.map_box(box), problem=f"rotation is {annotation.rotation!r}; it must be degrees"
            )
        if angle % 360:
            turned = _turn(box, mask, angle)
            if isinstance(turned, str):
                return AnnotationShape(box=view.map_box(box), problem=turned)
            box, mask = turned
    if annotation.is_crowd:
        remarks.append("iscrowd is 1: taken as one defect")
    return AnnotationShape(
        box=view.map_box(box), mask=None if mask is None else view.map_shape(mask), remarks=tuple(remarks)
    )


def _turn(box: Box, mask: Any | None, angle_deg: float) -> tuple[Box, Any] | str:
    """Box and mask turned clockwise about the box's centre, or the reason why the mask's position is unknown."""
    frame = shapely.box(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px)
    # Counter-clockwise for shapely's y upwards is clockwise for y downwards.
    outline = shapely.affinity.rotate(frame, angle_deg, origin="center")
    if mask is not None:
        before, after = _have_same_bounds(mask, frame), _have_same_bounds(mask, outline)
        if not before and not after:
            return (
                f"rotation is {angle_deg:g} degrees, and its mask fits neither the box before nor after; draw it as a "
                "polygon without rotation"
            )
        if before and not after:
            outline = shapely.affinity.rotate(mask, angle_deg, origin=frame.centroid)
        elif after and not before:
            outline = mask
    x, y, width, height = _bound(outline)
    return Box(x_px=x, y_px=y, width_px=width, height_px=height), extract_polygons(outline)


def _have_same_bounds(one: Any, other: Any) -> bool:
    a, b = one.bounds, other.bounds
    limit = max(_SAME_SIDE_PX, _SAME_SIDE_SHARE * max(b[2] - b[0], b[3] - b[1]))
    return all(abs(p - q) <= limit for p, q in zip(a, b, strict=True))


def _bound(shape: Any) -> tuple[float, float, float, float]:
    left, top, right, bottom = shape.bounds
    return left, top, right - left, bottom - top
