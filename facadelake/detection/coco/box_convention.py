"""Boxes of a COCO file that as a whole are something else than [x, y, width, height] in pixels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from facadelake.core.errors import InputDataError
from facadelake.detection.boxes import ROUNDING_PX
from facadelake.detection.coco.coco_records import (
    BoxValues,
    CocoAnnotation,
    CocoFile,
    CocoImage,
    is_same_area,
    parse_box_values,
    parse_number,
)

_CORNERS_MIN = 3  # boxes that leave their images, from which corners are told where no areas are stated
_SAME_PX, _SAME_SHARE = 2.0, 0.02  # a box and the bounds of its mask, each rounded; the share is of the longer side
_REMEDY = "COCO boxes are [x, y, width, height] in pixels: export them so"


def _write_corners(left: float, top: float, right: float, bottom: float) -> BoxValues:
    return left, top, right, bottom


def _write_centre(left: float, top: float, right: float, bottom: float) -> BoxValues:
    return (left + right) / 2, (top + bottom) / 2, right - left, bottom - top


def _write_rows_first(left: float, top: float, right: float, bottom: float) -> BoxValues:
    return top, left, bottom - top, right - left


_OTHER_CONVENTIONS: Mapping[str, Callable[[float, float, float, float], BoxValues]] = {
    "[x1, y1, x2, y2]": _write_corners,
    "[x of the centre, y of the centre, width, height]": _write_centre,
    "[y, x, height, width]": _write_rows_first,
}


def refuse_other_boxes(coco: CocoFile) -> None:
    """Raise InputDataError where the boxes as a whole are not [x, y, width, height] in pixels."""
    listed = [one for one in coco.annotations if isinstance(one.bbox, list) and len(one.bbox) == 4]
    boxes = [(one, box) for one in listed if (box := parse_box_values(one.bbox)) is not None]
    masks = [(one, bounds) for one in coco.annotations if (bounds := _bound_polygons(one.segmentation)) is not None]
    without_box = [bounds for one, bounds in masks if not any((parse_box_values(one.bbox) or (0.0,) * 4)[2:])]
    values = [value for numbers in (*(box for _, box in boxes), *without_box) for value in numbers]
    if len(boxes) == len(listed) and any(values) and all(0 <= value <= 1 for value in values):
        raise InputDataError(
            f"detections file {coco.path}: all {len(boxes) or len(without_box)} boxes lie within 0..1, so they are "
            "normalised; COCO boxes are [x, y, width, height] in pixels: export boxes in pixels"
        )
    reason = _find_corners(coco, boxes)
    if reason:
        raise InputDataError(f"detections file {coco.path}: the boxes seem to be [x1, y1, x2, y2]: {reason}; {_REMEDY}")
    _refuse_boxes_unlike_masks(coco, masks)


def _bound_polygons(segmentation: Any) -> BoxValues | None:
    """Left, top, right and bottom of the polygons of a segmentation; None where it has none of finite numbers."""
    if not isinstance(segmentation, list) or not all(isinstance(ring, list) for ring in segmentation):
        return None
    values = [[parse_number(value) for value in ring] for ring in segmentation]
    x = [value for ring in values for value in ring[0::2] if value is not None]
    y = [value for ring in values for value in ring[1::2] if value is not None]
    if not x or not y or len(x) + len(y) < sum(map(len, values)):
        return None
    return min(x), min(y), max(x), max(y)


def _refuse_boxes_unlike_masks(coco: CocoFile, masks: Sequence[tuple[CocoAnnotation, BoxValues]]) -> None:
    """Raise InputDataError where no box bounds its mask as [x, y, width, height], and all do in another convention.

    Masks with a rotation are not compared: their boxes are those before it.
    """
    pairs = [
        (box, bounds)
        for one, bounds in masks
        if one.rotation is None and (box := parse_box_values(one.bbox)) is not None and any(box[2:])
    ]
    if not pairs or any(_is_alike(box, (x, y, right - x, bottom - y)) for box, (x, y, right, bottom) in pairs):
        return
    for name, write in _OTHER_CONVENTIONS.items():
        if all(_is_alike(box, write(*bounds)) for box, bounds in pairs):
            raise InputDataError(
                f"detections file {coco.path}: the boxes seem to be {name}: so, and not as [x, y, width, height], all "
                f"{len(pairs)} that have a mask of polygons bound it; {_REMEDY}"
            )


def _is_alike(box: BoxValues, wanted: BoxValues) -> bool:
    limit_px = max(_SAME_PX, _SAME_SHARE * max(wanted[2:]))
    return all(abs(found - value) <= limit_px for found, value in zip(box, wanted, strict=True))


def _find_corners(coco: CocoFile, boxes: Sequence[tuple[CocoAnnotation, BoxValues]]) -> str:
    """Why the boxes must be corners: by the areas stated, else by boxes that leave their images unless they are
    corners; empty where they need not be."""
    stated = [
        (area, box)
        for one, box in boxes
        if not one.segmentation and (area := parse_number(one.area)) is not None and area > 0
    ]
    if stated and all(
        _may_be_corners(box)
        and is_same_area(area, (box[2] - box[0]) * (box[3] - box[1]))
        and not is_same_area(area, box[2] * box[3])
        for area, box in stated
    ):
        return f"the areas of all {len(stated)} boxes that state one are those of corners, not width x height"
    sized = [(image, box) for one, box in boxes if (image := coco.images.get(one.image_id)) is not None]
    beyond = sum(not _is_inside(image, box[0] + box[2], box[1] + box[3]) for image, box in sized)
    if (
        2 * beyond > len(sized) >= _CORNERS_MIN
        and len(sized) == len(boxes)
        and all(_may_be_corners(box) and _is_inside(image, box[2], box[3]) for image, box in sized)
    ):
        return f"read as x, y, width, height, {beyond} of {len(sized)} leave their images, and as corners none does"
    return ""


def _may_be_corners(box: BoxValues) -> bool:
    return box[2] > box[0] and box[3] > box[1]


def _is_inside(image: CocoImage, right_px: float, bottom_px: float) -> bool:
    return (
        image.width_px is None
        or image.height_px is None
        or (right_px <= image.width_px + ROUNDING_PX and bottom_px <= image.height_px + ROUNDING_PX)
    )
