"""Segmentations of a COCO file, polygons or run lengths (RLE), as outlines in pixels of the photograph.

Pixels as in ``boxes``: run lengths count whole pixels, so pixel (0, 0) covers the square from (0, 0) to (1, 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from facadelake.core.arrays import Float64Nx4, Int64Array
from facadelake.detection.boxes import Box
from facadelake.detection.coco.coco_records import parse_number

_SIMPLIFY_TOLERANCE_PX = 0.5  # an outline of whole pixels is a staircase; it is simplified within this distance
_PIXELS_MAX = 2**31  # no photograph is larger
_INSIDE_SHARE_MIN = 0.5  # a mask with less of its area in its own box belongs to another object
_BOX_SHARE_MAX = 0.995  # tools without masks write boxes as polygons; such a mask is omitted


@dataclass(frozen=True, kw_only=True)
class CocoMask:
    """``outline``: a shapely polygon or multipolygon in pixels, None where the box is used instead.

    ``remark``: the reason why a segmentation was not used.
    """

    outline: Any | None = None
    remark: str = ""


def shape_from_segmentation(
    segmentation: Any, image_width_px: float | None, image_height_px: float | None
) -> tuple[Any | None, str]:
    """Polygons of a segmentation in pixels, None where there is none, and the reason where one cannot be used.

    Args:
        segmentation: As in COCO: a list of polygons [x1, y1, x2, y2, ...] in pixels, or run lengths
            {"counts", "size"}, plain or compressed; None where there is none.
        image_width_px: Width of the image, None where unknown.
        image_height_px: Height of the image, None where unknown.
    """
    if segmentation is None or segmentation in ([], {}):
        return None, ""
    try:
        return _shape_from_segmentation(segmentation, image_width_px, image_height_px), ""
    except _UnusableSegmentationError as error:
        return None, f"its segmentation was not used ({error}); its box is used instead"


def fit_mask(shape: Any | None, box: Box) -> CocoMask:
    """A mask clipped to its annotation's box; one that is the box, or lies outside it, is omitted."""
    if shape is None:
        return CocoMask()
    frame = shapely.box(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px)
    inside = extract_polygons(shapely.intersection(shape, frame))
    if inside is None or inside.area < _INSIDE_SHARE_MIN * shape.area:
        return CocoMask(remark="its segmentation was not used (it lies outside its box); its box is used instead")
    if inside.area >= _BOX_SHARE_MAX * frame.area:
        return CocoMask()
    return CocoMask(outline=inside)


def extract_polygons(shape: Any) -> Any | None:
    """The parts of a geometry that have an area, as a polygon or multipolygon; None if there are none."""
    parts = [part for part in shapely.get_parts(shape, return_index=False) if part.geom_type == "Polygon" and part.area]
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def polygons_from_wkt(text: str) -> Any | None:
    """Polygon or multipolygon of a mask stored as WKT; rings that cross after rounding are repaired. None if empty."""
    return extract_polygons(shapely.make_valid(shapely.from_wkt(text), method="structure", keep_collapsed=False))


class _UnusableSegmentationError(ValueError):
    """A segmentation cannot be parsed; the message is the reason."""


def _shape_from_segmentation(segmentation: Any, image_width_px: float | None, image_height_px: float | None) -> Any:
    if isinstance(segmentation, dict):
        return _shape_from_run_lengths(segmentation, image_width_px, image_height_px)
    return _shape_from_polygons(segmentation)


def _shape_from_polygons(rings: Any) -> Any:
    if not isinstance(rings, list):
        raise _UnusableSegmentationError(f"it is a {type(rings).__name__}, not polygons or run lengths")
    shapes = []
    for i, ring in enumerate(rings):
        values = [parse_number(value) for value in ring] if isinstance(ring, list) else []
        if len(values) < 6 or len(values) % 2 or None in values:
            raise _UnusableSegmentationError(f"polygon {i} is not 3 or more points x, y of finite numbers")
        shapes.append(shapely.make_valid(shapely.Polygon(np.array(values, dtype=np.float64).reshape(-1, 2))))
    union = extract_polygons(shapely.union_all(shapes)) if shapes else None
    if union is None:
        raise _UnusableSegmentationError("its polygons have no area")
    return union


def _shape_from_run_lengths(
    segmentation: dict[str, Any], image_width_px: float | None, image_height_px: float | None
) -> Any:
    size, counts = segmentation.get("size"), segmentation.get("counts")
    sides = [_parse_count(side) for side in size] if isinstance(size, list) else []
    if len(sides) != 2 or not all(sides):
        raise _UnusableSegmentationError(f"size is {size!r}, it must be [height, width]")
    height, width = (side or 0 for side in sides)
    if height * width > _PIXELS_MAX:
        raise _UnusableSegmentationError(f"its run lengths are of {width} x {height} px (limit {_PIXELS_MAX:,} px)")
    if None not in (image_width_px, image_height_px) and (width, height) != (image_width_px, image_height_px):
        raise _UnusableSegmentationError(f"its run lengths are of {width} x {height} px, not of the photograph's size")
    listed = _decode_run_lengths(counts) if isinstance(counts, str) else counts
    runs = [run for one in listed if (run := _parse_count(one)) is not None] if isinstance(listed, list) else []
    if not isinstance(listed, list) or len(runs) < len(listed):
        raise _UnusableSegmentationError("counts must be run lengths of 0 or more")
    if sum(runs) != width * height:
        raise _UnusableSegmentationError(f"its run lengths add up to {sum(runs)}, not to {width} x {height}")
    rectangles = _rectangles_from_run_lengths(np.array(runs, dtype=np.int64), height)
    if not len(rectangles):
        raise _UnusableSegmentationError("its run lengths contain no pixel")
    union = shapely.union_all(shapely.box(*rectangles.T))
    simplified = extract_polygons(shapely.simplify(union, _SIMPLIFY_TOLERANCE_PX))
    return union if simplified is None else simplified


def _parse_count(value: Any) -> int | None:
    """A whole number of 0 or more, which some tools write as 3.0; else None."""
    number = parse_number(value)
    return int(number) if number is not None and number >= 0 and number == int(number) else None


def _decode_run_lengths(text: str) -> list[int]:
    """Decode COCO's compressed run lengths: 5 bits per character, offset by 48; differences to the run two before.

    Source: cocoapi, maskApi.c, rleFrString.
    """
    runs: list[int] = []
    value, shift = 0, 0
    for character in text:
        bits = ord(character) - 48
        if not 0 <= bits < 64:
            raise _UnusableSegmentationError(
                f"counts contains {character!r}, which is not valid in compressed run lengths"
            )
        value |= (bits & 0x1F) << shift
        shift += 5
        if shift > 60:
            raise _UnusableSegmentationError("counts has a run length of more digits than any photograph")
        if bits & 0x20:
            continue
        if bits & 0x10:
            value -= 1 << shift
        runs.append(value + runs[-2] if len(runs) > 2 else value)
        value, shift = 0, 0
    if shift:
        raise _UnusableSegmentationError("counts ends within a run length")
    return runs


def _rectangles_from_run_lengths(runs: Int64Array, height: int) -> Float64Nx4:
    """Rectangles (s, 4: left, top, right, bottom) of the masked runs, which are in column-major order."""
    ends = np.cumsum(runs)
    first, last = ends[0::2][: len(runs) // 2], ends[1::2]
    first, last = first[last > first], last[last > first]
    columns = (last - 1) // height - first // height + 1
    run = np.repeat(np.arange(len(first)), columns)
    column = first[run] // height + np.arange(len(run)) - np.repeat(np.cumsum(columns) - columns, columns)
    top = np.maximum(first[run], column * height) - column * height
    bottom = np.minimum(last[run], (column + 1) * height) - column * height
    return np.column_stack([column, top, column + 1, bottom]).astype(np.float64)
