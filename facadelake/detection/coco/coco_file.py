"""COCO detections file, read into records; a file that is malformed as a whole is an error that names the key.

Format: https://cocodataset.org/#format-data (object detection).
"""

from __future__ import annotations

import json
import logging
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from facadelake.core.errors import InputDataError
from facadelake.detection.boxes import ROUNDING_PX

_log = logging.getLogger(__name__)
_WHOLE_NUMBER = re.compile(r"-?(0|[1-9]\d{0,17})(\.0+)?")
_EXACT_FLOAT_MAX = 2.0**53  # larger floats are not exact, so two ids may have become one
_QUOTED_MAX = 120
_CORNERS_MIN = 3  # boxes that leave their images, from which corners are told where no areas are stated
_Values = tuple[float, float, float, float]
_EXPORT = "export it again as COCO (object detection) with images, annotations and categories"


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


def read_coco(path: Path) -> CocoFile:
    """Read a COCO file.

    Raises InputDataError for a file that is missing, is not JSON, lacks a list or key that COCO requires, uses an id or
    a key twice for different things, or whose boxes are not [x, y, width, height] in pixels.
    """
    content = _read_json(path)
    images = {
        key: CocoImage(
            file_name=_parse_text(entry, "file_name", path, "images", i),
            width_px=parse_number(entry.get("width")),
            height_px=parse_number(entry.get("height")),
        )
        for key, (i, entry) in _index_by_id(content, "images", path).items()
    }
    categories = {
        key: _parse_text(entry, "name", path, "categories", i)
        for key, (i, entry) in _index_by_id(content, "categories", path).items()
    }
    annotations = tuple(
        CocoAnnotation(
            annotation_id=str(key),
            image_id=_parse_reference(entry.get("image_id")),
            category_id=_parse_reference(entry.get("category_id")),
            bbox=entry.get("bbox"),
            score=entry.get("score"),
            segmentation=entry.get("segmentation"),
            area=entry.get("area"),
            rotation=_get_value_or_attribute(entry, "rotation"),
            crack_width_px=_get_value_or_attribute(entry, "crack_width_px"),
            is_crowd=entry.get("iscrowd") == 1,
            subject=_get_subject(entry),
        )
        for key, (_, entry) in _index_by_id(content, "annotations", path).items()
    )
    coco = CocoFile(path=path, images=images, categories=categories, annotations=annotations)
    refuse_other_boxes(coco)
    return coco


def _read_json(path: Path) -> dict[str, Any]:
    def build_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            twice = next(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
            raise InputDataError(
                f"detections file {path} has the key {twice!r} twice in one object, so that one of its values would "
                "be lost; merge the files with a tool that reads COCO"
            )
        return found

    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=build_object)
    except FileNotFoundError as error:
        raise InputDataError(
            f"detections file {path} does not exist; correct the path in the portfolio, or put the file there"
        ) from error
    except OSError as error:
        raise InputDataError(
            f"detections file {path} cannot be read ({error}); correct its path or permissions"
        ) from error
    except UnicodeDecodeError as error:
        raise InputDataError(f"detections file {path} is not UTF-8 text ({error}); {_EXPORT}") from error
    except json.JSONDecodeError as error:
        raise InputDataError(
            f"detections file {path} is not JSON: {error.msg} at line {error.lineno}, column {error.colno}; {_EXPORT}"
        ) from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, brackets a thousand deep
        raise InputDataError(f"detections file {path} cannot be read as JSON ({error}); {_EXPORT}") from error
    if not isinstance(content, dict):
        raise InputDataError(
            f"detections file {path} contains a {type(content).__name__}, not an object with images, annotations and "
            f"categories (a results list has no file names); {_EXPORT}"
        )
    return content


def _index_by_id(content: Mapping[str, Any], key: str, path: Path) -> dict[int | str, tuple[int, dict[str, Any]]]:
    """Index and entry by id; an annotation without id has its row's. An entry that is repeated unchanged counts once.

    Raises InputDataError where two different entries have one id.
    """
    found: dict[int | str, tuple[int, dict[str, Any]]] = {}
    repeated = 0
    for i, entry in enumerate(_get_entries(content, key, path)):
        number = f"row{i}" if key == "annotations" and entry.get("id") is None else _parse_id(entry, path, key, i)
        first, other = found.setdefault(number, (i, entry))
        if first == i:
            continue
        if other | {"id": 0} != entry | {"id": 0}:
            raise InputDataError(
                f"detections file {path}: {key}[{first}] and {key}[{i}] have the same id {entry['id']!r}: "
                f"{_abbreviate(other)} and {_abbreviate(entry)}; number them anew (files were merged?)"
            )
        repeated += 1
    if repeated:
        _log.warning("%s: %d entries of '%s' are repeated unchanged; each is read once", path.name, repeated, key)
    return found


def _abbreviate(entry: Mapping[str, Any]) -> str:
    text = json.dumps({name: value for name, value in entry.items() if name not in ("segmentation", "attributes")})
    return text if len(text) <= _QUOTED_MAX else f"{text[:_QUOTED_MAX]} ..."


def parse_number(value: Any) -> float | None:
    """``value`` as a finite number, else None; text and true/false are not numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < 1e15 else None  # also False for NaN


def _get_value_or_attribute(entry: Mapping[str, Any], name: str) -> Any:
    attributes = entry.get("attributes")
    return entry.get(name, attributes.get(name) if isinstance(attributes, dict) else None)


def _get_entries(content: Mapping[str, Any], key: str, path: Path) -> list[dict[str, Any]]:
    if key not in content:
        raise InputDataError(f"detections file {path} has no key '{key}' (it has {sorted(content)}); {_EXPORT}")
    entries = content[key]
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputDataError(f"detections file {path}: '{key}' must be a list of objects; {_EXPORT}")
    return entries


def _normalise_id(value: Any) -> int | str | None:
    """A whole number, however written (5, 5.0, "5"), as an integer; other text as it is; None for anything else."""
    if isinstance(value, str):
        return int(value.partition(".")[0]) if _WHOLE_NUMBER.fullmatch(value) else value if is_storable(value) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if isinstance(value, float) and not (value.is_integer() and abs(value) < _EXACT_FLOAT_MAX):
        return None
    return int(value)


def is_storable(text: str) -> bool:
    """Whether a text can be encoded: JSON can write half of a surrogate pair, which no table stores."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def _parse_reference(value: Any) -> int | str:
    """An id that an annotation refers to; an invalid id becomes a text that matches no entry."""
    found = _normalise_id(value)
    return f"({value!r})" if found is None else found


def _parse_id(entry: Mapping[str, Any], path: Path, key: str, index: int) -> int | str:
    found = _normalise_id(entry.get("id"))
    if found is None:
        raise InputDataError(
            f"detections file {path}: {key}[{index}].id is {entry.get('id')!r}; every entry needs a whole number or "
            "text"
        )
    return found


def _get_subject(entry: Mapping[str, Any]) -> str | None:
    attributes = entry.get("attributes")
    subject = attributes.get("subject") if isinstance(attributes, dict) else None
    return subject if isinstance(subject, str) and subject else None


def _parse_text(entry: Mapping[str, Any], field: str, path: Path, key: str, index: int) -> str:
    value = entry.get(field)
    if not isinstance(value, str) or not value.strip() or not is_storable(value):
        raise InputDataError(f"detections file {path}: {key}[{index}].{field} is {value!r}; every entry needs a text")
    return value


def refuse_other_boxes(coco: CocoFile) -> None:
    """Raise InputDataError where the boxes as a whole are not [x, y, width, height] in pixels."""
    listed = [one for one in coco.annotations if isinstance(one.bbox, list) and len(one.bbox) == 4]
    boxes = [(one, box) for one in listed if (box := parse_box_values(one.bbox)) is not None]
    values = [value for _, box in boxes for value in box]
    if len(boxes) == len(listed) and any(values) and all(0 <= value <= 1 for value in values):
        raise InputDataError(
            f"detections file {coco.path}: all {len(boxes)} boxes lie within 0..1, so they are normalised; "
            "COCO boxes are [x, y, width, height] in pixels: export boxes in pixels"
        )
    reason = _find_corners(coco, boxes)
    if reason:
        raise InputDataError(
            f"detections file {coco.path}: the boxes seem to be [x1, y1, x2, y2]: {reason}; COCO boxes are [x, y, "
            "width, height] in pixels: export them so"
        )


def _find_corners(coco: CocoFile, boxes: Sequence[tuple[CocoAnnotation, _Values]]) -> str:
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


def _may_be_corners(box: _Values) -> bool:
    return box[2] > box[0] and box[3] > box[1]


def _is_inside(image: CocoImage, right_px: float, bottom_px: float) -> bool:
    return (
        image.width_px is None
        or image.height_px is None
        or (right_px <= image.width_px + ROUNDING_PX and bottom_px <= image.height_px + ROUNDING_PX)
    )


def is_same_area(one: float, other: float) -> bool:
    """Whether two areas agree within rounding of the sides to whole pixels, or 2 %."""
    return abs(one - other) <= max(2 * math.sqrt(max(one, other, 1.0)), 0.02 * max(one, other))


def parse_box_values(bbox: Any) -> _Values | None:
    """The four numbers of a bbox; None where it is not four finite numbers."""
    if not isinstance(bbox, list) or len(bbox) != 4:
        return None
    x, y, width, height = map(parse_number, bbox)
    return None if x is None or y is None or width is None or height is None else (x, y, width, height)
