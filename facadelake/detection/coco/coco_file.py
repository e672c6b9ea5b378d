"""COCO detections file, read into records; a file that is malformed as a whole is an error that names the key.

Format: https://cocodataset.org/#format-data (object detection).
"""

from __future__ import annotations

import json
import logging
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from facadelake.core.errors import InputDataError
from facadelake.detection.coco.box_convention import refuse_other_boxes
from facadelake.detection.coco.coco_records import CocoAnnotation, CocoFile, CocoImage, parse_number

_log = logging.getLogger(__name__)
_WHOLE_NUMBER = re.compile(r"-?(0|[1-9]\d{0,17})(\.0+)?")
_EXACT_FLOAT_MAX = 2.0**53  # larger floats are not exact, so two ids may have become one
_QUOTED_MAX = 120
_EXPORT = "export it again as COCO (object detection) with images, annotations and categories"


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
