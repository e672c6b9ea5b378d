"""COCO detections file, read into records; a file that is malformed as a whole is an error that names the key.

Format: https://cocodataset.org/#format-data (object detection).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from facadelake.core.errors import InputDataError

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

    ``crack_width_px`` is read from the entry or from its ``attributes``, where annotation tools store custom fields.
    """

    annotation_id: str
    image_id: int | str
    category_id: int | str
    bbox: Any
    score: Any
    segmentation: Any = None
    crack_width_px: Any = None
    is_crowd: bool = False


@dataclass(frozen=True, kw_only=True)
class CocoFile:
    """Images and category names by their ids; annotations in the file's order."""

    path: Path
    images: Mapping[int | str, CocoImage]
    categories: Mapping[int | str, str]
    annotations: tuple[CocoAnnotation, ...]


def read_coco(path: Path) -> CocoFile:
    """Read a COCO file.

    Raises InputDataError for a file that is missing, is not JSON, or lacks a list or key that COCO requires.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
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
    if not isinstance(content, dict):
        raise InputDataError(
            f"detections file {path} contains a {type(content).__name__}, not an object with images, annotations and "
            f"categories (a results list has no file names); {_EXPORT}"
        )
    images = {
        _parse_id(entry, path, "images", i): CocoImage(
            file_name=_parse_text(entry, "file_name", path, "images", i),
            width_px=parse_number(entry.get("width")),
            height_px=parse_number(entry.get("height")),
        )
        for i, entry in enumerate(_get_entries(content, "images", path))
    }
    categories = {
        _parse_id(entry, path, "categories", i): _parse_text(entry, "name", path, "categories", i)
        for i, entry in enumerate(_get_entries(content, "categories", path))
    }
    annotations = tuple(
        CocoAnnotation(
            annotation_id=str(entry["id"]) if entry.get("id") is not None else f"row{i}",
            image_id=_parse_reference(entry.get("image_id")),
            category_id=_parse_reference(entry.get("category_id")),
            bbox=entry.get("bbox"),
            score=entry.get("score"),
            segmentation=entry.get("segmentation"),
            crack_width_px=_get_value_or_attribute(entry, "crack_width_px"),
            is_crowd=entry.get("iscrowd") == 1,
        )
        for i, entry in enumerate(_get_entries(content, "annotations", path))
    )
    return CocoFile(path=path, images=images, categories=categories, annotations=annotations)


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


def _parse_reference(value: Any) -> int | str:
    """An id that an annotation refers to; an invalid id becomes a text that matches no entry."""
    return value if isinstance(value, int | str) and not isinstance(value, bool) else f"({value!r})"


def _parse_id(entry: Mapping[str, Any], path: Path, key: str, index: int) -> int | str:
    value = entry.get("id")
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise InputDataError(
            f"detections file {path}: {key}[{index}].id is {value!r}; every entry needs a number or text"
        )
    return value


def _parse_text(entry: Mapping[str, Any], field: str, path: Path, key: str, index: int) -> str:
    value = entry.get(field)
    if not isinstance(value, str) or not value.strip():
        raise InputDataError(f"detections file {path}: {key}[{index}].{field} is {value!r}; every entry needs a text")
    return value
