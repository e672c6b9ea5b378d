"""Records of a COCO file, and its numbers: a box, an area."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BoxValues = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class CocoImage:
    """An entry of ``images``; a size that the file does not state is None."""

    file_name: str
    width_px: float | None
    height_px: float | None


@dataclass(frozen=True, kw_only=True)
class CocoAnnotation:
    """An entry of ``annotations`` as in the file: fields from ``bbox`` on are not validated.

    ``crack_width_px`` and ``rotation`` (degrees clockwise about the box's centre, CVAT) are read from the entry or from
    its ``attributes``, where annotation tools store custom fields; ``subject`` from the attributes of a review task.
    """

    annotation_id: str
    image_id: int | str
    category_id: int | str
    bbox: Any
    score: Any
    segmentation: Any = None
    area: Any = None
    rotation: Any = None
    crack_width_px: Any = None
    is_crowd: bool = False
    subject: str | None = None


@dataclass(frozen=True, kw_only=True)
class CocoFile:
    """Images and category names by their ids; annotations in the file's order.

    Ids are whole numbers or text; 5, 5.0 and "5" are one id.
    """

    path: Path
    images: Mapping[int | str, CocoImage]
    categories: Mapping[int | str, str]
    annotations: tuple[CocoAnnotation, ...]


def parse_number(value: Any) -> float | None:
    """``value`` as a finite number, else None; text and true/false are not numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < 1e15 else None  # also False for NaN


def parse_box_values(bbox: Any) -> BoxValues | None:
    """The four numbers of a bbox; None where it is not four finite numbers."""
    if not isinstance(bbox, list) or len(bbox) != 4:
        return None
    x, y, width, height = map(parse_number, bbox)
    return None if x is None or y is None or width is None or height is None else (x, y, width, height)


def is_same_area(one: float, other: float) -> bool:
    """Whether two areas agree within rounding of the sides to whole pixels, or 2 %."""
    return abs(one - other) <= max(2 * math.sqrt(max(one, other, 1.0)), 0.02 * max(one, other))
