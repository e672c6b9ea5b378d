"""COCO files as many programs write them, some with a mistake, and what must be read from them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from hypothesis import strategies as st

from benchmarks.drawn_control_files import (
    SIZE,
    Tally,
    photo_ids,
)
from facadelake.core.errors import InputDataError
from facadelake.core.tables import table_from_rows
from facadelake.detection.coco import import_coco


@dataclass(frozen=True)
class Stored:
    """A photograph as stored."""

    photo_id: str
    orientation: int


@st.composite
def coco_files(draw: st.DrawFn) -> tuple[list[Stored], dict[str, Any], dict[str, Any]]:
    """Photographs, the content of a file, and what it means: the box as stored of each annotation, or a refusal."""
    ids = draw(photo_ids())
    turned = draw(st.booleans())
    photos = [Stored(one, draw(st.integers(1, 8)) if turned else 1) for one in ids]
    spell = draw(st.sampled_from([lambda i: i, float, str, lambda i: f"{i}.0"]))
    images, annotations, meant = [], [], {}
    for number, photo in enumerate(photos, start=1):
        displayed = photo.orientation >= 5 and draw(st.booleans())
        size = SIZE[::-1] if displayed else SIZE
        images.append({"id": spell(number), "file_name": photo.photo_id, "width": size[0], "height": size[1]})
        for _ in range(draw(st.integers(0, 2))):
            key = len(annotations) + 1
            width, height = draw(st.integers(2, 12)), draw(st.integers(2, 12))
            x, y = draw(st.integers(8, size[0] - 21)), draw(st.integers(8, size[1] - 21))
            entry: dict[str, Any] = {"id": spell(key), "image_id": spell(number), "category_id": spell(1)}
            entry["bbox"] = [x, y, width, height]
            angle = draw(st.sampled_from([None, 0, 30, 90, -45.5, 180]))
            if angle is not None:
                entry["attributes"] = {"rotation": angle}
            if draw(st.booleans()):
                entry["area"] = width * height
            if draw(st.integers(0, 3)) == 0:
                entry["segmentation"] = [[x, y, x + width, y, x + width, y + height, x, y + height]]
            annotations.append(entry)
            corners = _turn_with_opencv((x, y, width, height), angle or 0)
            doubtful = photo.orientation in (2, 3, 4)
            meant[str(key)] = None if doubtful else _store(corners, photo.orientation if displayed else 1)
    content = {"images": images, "categories": [{"id": spell(1), "name": "crack"}], "annotations": annotations}
    mistake = draw(st.sampled_from([None] * 6 + ["image twice", "category twice", "annotation twice", "corners"]))
    if mistake == "image twice":
        images.append(images[0] | {"id": draw(st.sampled_from([1, 1.0, "1"])), "file_name": "other/x.JPG"})
    elif mistake == "category twice":
        content["categories"].append({"id": draw(st.sampled_from([1, 1.0, "1"])), "name": "spalling"})
    elif mistake == "annotation twice" and annotations:
        annotations.append(annotations[0] | {"bbox": [1, 1, 2, 2]})
    elif mistake == "corners" and annotations:
        for one in annotations:
            x, y, w, h = one["bbox"]
            one |= {"bbox": [x, y, x + w, y + h], "area": w * h}
            one.pop("segmentation", None)
            one.pop("attributes", None)
    else:
        mistake = None
    return photos, content, {"boxes": meant, "mistake": mistake}


def _turn_with_opencv(box: tuple[int, int, int, int], angle_deg: float) -> np.ndarray:
    """Corners (4, 2) of a box turned clockwise about its centre, by OpenCV."""
    x, y, w, h = box
    return cv2.boxPoints(((x + w / 2, y + h / 2), (w, h), angle_deg)).astype(np.float64)


def _store(corners: np.ndarray, orientation: int) -> list[float]:
    """Bounds as stored of corners as displayed: the inverse of EXIF's words, corner by corner of a picture."""
    width, height = SIZE
    u, v = corners.T
    x, y = {
        1: (u, v), 5: (v, u), 6: (v, height - u), 7: (width - v, height - u), 8: (width - v, u),
    }[orientation]  # fmt: skip
    return [float(x.min()), float(y.min()), float(np.ptp(x)), float(np.ptp(y))]


def make_photos(photos: list[Stored]) -> pa.Table:
    """Table ``photos``."""
    return table_from_rows(
        "photos",
        [
            {
                "photo_id": one.photo_id, "sha256": one.photo_id, "bytes": 1, "photo_outcome": "accepted",
                "image_width_px": SIZE[0], "image_height_px": SIZE[1], "exif_orientation": one.orientation,
                "prior_source": "none", "prior_height_datum": "unknown",
            }
            for one in photos
        ],
    )  # fmt: skip


def check_coco_file(
    folder: Path, photos: list[Stored], content: dict[str, Any], meant: dict[str, Any], tally: Tally
) -> None:
    """Import a file and compare with what it means."""
    path = folder / "boxes.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    boxes, mistake = meant["boxes"], meant["mistake"]
    try:
        rows = import_coco(path, make_photos(photos), class_names={}).to_pylist()
    except InputDataError as error:
        expected = mistake is not None or not any(box is not None for box in boxes.values())
        tally.outcomes[f"COCO refused: {mistake or 'no box that can be used'}"] += 1
        if not expected:
            tally.wrong.append(f"a good file was refused: {error}\n{json.dumps(content)}")
        return
    if mistake is not None:
        tally.wrong.append(f"the mistake '{mistake}' was taken\n{json.dumps(content)}")
        return
    if len(rows) != len(boxes):
        tally.wrong.append(f"{len(rows)} rows of {len(boxes)} annotations\n{json.dumps(content)}")
    for row in rows:
        box = boxes[row["source_annotation"]]
        accepted = row["detection_outcome"] == "accepted"
        tally.outcomes[f"boxes {row['detection_outcome']}"] += 1
        if box is None:
            if accepted or not row["reason"]:
                tally.wrong.append(f"a box of an unknown view was taken: {row}\n{json.dumps(content)}")
            continue
        found = [row[f"box_{side}_px"] for side in ("x", "y", "width", "height")]
        if not accepted and row["reason"].startswith("the same as annotation"):
            same = row["reason"].removeprefix("the same as annotation ").removesuffix(", which is used")
            if not np.allclose(found, boxes.get(same) or np.nan, rtol=0, atol=1.0):
                tally.wrong.append(f"a box was taken for another: {row['reason']}\n{json.dumps(content)}")
        elif not accepted:
            tally.wrong.append(f"a good box was refused: {row['reason']}\n{json.dumps(content)}")
        elif max(abs(a - b) for a, b in zip(found, box, strict=True)) > 1e-4:
            tally.wrong.append(f"box {found}, not {box}\n{json.dumps(content)}")


JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(-(10**20), 10**20), st.floats(), st.text(max_size=4),
    st.lists(st.integers(-5, 5), max_size=5), st.dictionaries(st.sampled_from(["id", "counts", "size"]), st.integers()),
)  # fmt: skip


@st.composite
def destroyed_coco(draw: st.DrawFn) -> bytes:
    """A COCO file with junk in some fields, or with bytes changed."""
    _, content, _ = draw(coco_files())
    for _ in range(draw(st.integers(0, 4))):
        key = draw(st.sampled_from(sorted(content)))
        entries = content[key]
        if isinstance(entries, list) and entries:
            entry = draw(st.sampled_from(entries))
            if isinstance(entry, dict):
                fields = ["id", "image_id", "category_id", "bbox", "segmentation", "area", "score", "file_name", "name"]
                entry[draw(st.sampled_from([*fields, "width", "height", "iscrowd", "attributes"]))] = draw(JUNK)
        else:
            content[key] = draw(JUNK)
    data = bytearray(json.dumps(content).encode())
    for _ in range(draw(st.integers(0, 2))):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return bytes(data)
