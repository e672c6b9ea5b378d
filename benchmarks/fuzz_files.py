"""Fuzz of control point files and COCO files: no traceback, and nothing read otherwise than it was written.

The oracle is what was written: every file is made from known marks or boxes, written in one of the many ways of other
programs (paths, quotes, case, blanks, digits; ids as numbers or text, rotations, EXIF's turned views, corners), and
sometimes with a mistake whose refusal is expected. What is read must be what was meant, or be refused with words. A
second round destroys the bytes, and asks for an error of the input or a table.

    python -m benchmarks.fuzz_files --inputs 10000
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from facadelake.core.errors import InputDataError
from facadelake.core.tables import table_from_rows
from facadelake.detection.coco import import_coco
from facadelake.georeferencing.gcp.control_points import match_marks, read_surveyed_points

FOLDERS = ("multiview", "closerange", "far/north")
STEMS = ("DJI_0001", "DJI 0002", "img.3", "Köln", "a")
SUFFIXES = (".JPG", ".jpg", ".tif")
SIZE = (60, 40)


@dataclass
class Tally:
    """Inputs by what became of them."""

    outcomes: Counter[str]
    wrong: list[str]


# ------------------------------------------------------------------------------------------------------------- names


@st.composite
def photo_ids(draw: st.DrawFn) -> list[str]:
    """Photographs of a campaign, the same names in some folders."""
    folders = draw(st.lists(st.sampled_from([*FOLDERS, ""]), min_size=1, max_size=3, unique=True))
    names = draw(st.lists(st.sampled_from(STEMS), min_size=1, max_size=3, unique=True))
    suffix = draw(st.sampled_from(SUFFIXES))
    return sorted({f"{folder}/{name}{suffix}".lstrip("/") for folder in folders for name in names})


PREFIXES = ("", "images/", "./", "/home/a b/", "D:\\Flug 7\\")


@st.composite
def written_name(draw: st.DrawFn, photo_id: str, prefix: str | None) -> str:
    """A photograph's name as a program writes it that puts ``prefix`` before paths, or gives no folders (None)."""
    name = photo_id.rpartition("/")[2] if prefix is None else prefix + photo_id
    if draw(st.integers(0, 3)) == 0:
        name = name.upper() if draw(st.booleans()) else name.lower()
    if draw(st.integers(0, 4)) == 0:
        name = name.rpartition(".")[0]
    if draw(st.integers(0, 4)) == 0:
        name = name.replace("/", "\\")
    return name


def may_mean(name: str, photo_id: str) -> bool:
    """The oracle for names: the definition by text, apart from the matcher's code."""
    paths = []
    for text in (name, photo_id):
        path = text.replace("\\", "/").casefold()
        while "//" in path or "/./" in path or path.startswith("./"):
            path = path.replace("//", "/").replace("/./", "/").removeprefix("./")
        paths.append("/" + path.lstrip("/"))
    with_suffix, without = paths[1], paths[1].rpartition(".")[0]
    return any(paths[0].endswith(p) or p.endswith(paths[0]) for p in (with_suffix, without))


# ---------------------------------------------------------------------------------------------------- control points


@st.composite
def control_files(draw: st.DrawFn) -> tuple[list[str], str, dict[str, Any]]:
    """Photographs, the text of a file, and what it means: coordinates and marks by point."""
    ids = draw(photo_ids())
    lines, meant = [], {}
    tabs, prefix = draw(st.booleans()), draw(st.sampled_from([None, *PREFIXES]))
    for k in range(draw(st.integers(1, 4))):
        name = draw(st.sampled_from(["G{}", "GCP {}", "Ecke-{}", "p{}"])).format(k)
        quoted = not tabs and draw(st.booleans())
        true = [456_000 + 37.123456 * k, 5_421_000 + 12.345678 * k, 180 + 1.234567 * k]
        digits = draw(st.integers(1, 4))
        marks = []
        for photo_id in draw(st.lists(st.sampled_from(ids), min_size=1, max_size=3, unique=True)):
            places = min(6, digits + draw(st.integers(0, 1)))
            xyz = [f"{value:.{places}f}" for value in true]
            pixel = (draw(st.integers(0, 4000)), draw(st.integers(0, 3000)))
            written = draw(written_name(photo_id, prefix))
            has_suffix = written.lower().endswith((".jpg", ".tif"))
            column = f'"{written}"' if quoted or (not tabs and not has_suffix) else written
            label = f'"{name}"' if quoted else name
            lines.append(("\t" if tabs else " ").join([*xyz, *map(str, pixel), column, label]))
            marks.append((photo_id, written, pixel))
        meant[name] = (true, digits, marks)
    header = draw(st.sampled_from(["EPSG:25832", "WGS84 UTM 32N", "+proj=utm +zone=32 +ellps=GRS80 +units=m +no_defs"]))
    return ids, header + "\n" + "\n".join(lines) + "\n", meant


def check_control_file(folder: Path, ids: list[str], text: str, meant: dict[str, Any], tally: Tally) -> None:
    """Read a file and compare with what it means."""
    path = folder / "gcp_list.txt"
    path.write_text(text, encoding="utf-8")
    try:
        read = match_marks(read_surveyed_points(path), ids)
    except InputDataError as error:
        tally.wrong.append(f"a good file was refused: {error}\n{text}")
        return
    points = {point.name: point for point in read.points}
    if points.keys() != meant.keys():
        tally.wrong.append(f"points {sorted(points)} of {sorted(meant)}\n{text}")
        return
    told = " ".join(read.remarks)
    for name, (true, digits, marks) in meant.items():
        point = points[name]
        off = max(abs(a - b) for a, b in zip((point.x, point.y, point.z), true, strict=True))
        if off > 0.51 * 10**-digits:
            tally.wrong.append(f"{name} is {off} off\n{text}")
        found = {mark.photo_name: (mark.x_px, mark.y_px) for mark in point.marks}
        for photo_id, written, pixel in marks:
            candidates = [one for one in ids if may_mean(written, one)]
            if found.get(photo_id) == pixel:
                tally.outcomes["marks read"] += 1
            elif photo_id in found:
                tally.wrong.append(f"{name} in {photo_id} at {found[photo_id]}, not {pixel}\n{text}")
            elif written in told or told.count(";") >= 2:
                tally.outcomes["marks left out and told"] += 1
                if len(candidates) == 1 and sum(may_mean(w, photo_id) for _, w, _ in _all_marks(meant)) == 1:
                    tally.wrong.append(f"'{written}' means {photo_id} alone, and was left out: {told}\n{text}")
            else:
                tally.wrong.append(f"the mark '{written}' was left out in silence\n{text}")
        extra = found.keys() - {photo_id for photo_id, _, _ in marks}
        if extra:
            tally.wrong.append(f"{name} is marked in {extra}, which nobody marked\n{text}")


def _all_marks(meant: dict[str, Any]) -> list[tuple[str, str, tuple[int, int]]]:
    return [mark for _, _, marks in meant.values() for mark in marks]


# ------------------------------------------------------------------------------------------------------------- COCO


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
        if not accepted:
            tally.wrong.append(f"a good box was refused: {row['reason']}\n{json.dumps(content)}")
        elif max(abs(a - b) for a, b in zip(found, box, strict=True)) > 1e-4:
            tally.wrong.append(f"box {found}, not {box}\n{json.dumps(content)}")


# ------------------------------------------------------------------------------------------------------------- rounds


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


@st.composite
def destroyed_control(draw: st.DrawFn) -> bytes:
    """A file of control points with bytes changed, cut or repeated."""
    _, text, _ = draw(control_files())
    data = bytearray(text.encode())
    for _ in range(draw(st.integers(1, 6))):
        place = draw(st.integers(0, len(data) - 1))
        if draw(st.booleans()):
            data[place] = draw(st.integers(0, 255))
        else:
            data[place:place] = draw(st.sampled_from([b'"', b"\t", b" ", b"\n", b"nan", b"1e999", b"#", b"EPSG:0"]))
    return bytes(data)


def run(inputs: int) -> Tally:
    """All rounds, a quarter of the inputs each. A traceback ends the run; what is wrong is collected."""
    tally = Tally(outcomes=Counter(), wrong=[])
    share = max(1, inputs // 4)
    rules = settings(
        max_examples=share, deadline=None, database=None, phases=[Phase.generate], derandomize=True,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)

        @rules
        @given(control_files())
        def read_control(case: tuple[list[str], str, dict[str, Any]]) -> None:
            check_control_file(folder, *case, tally)

        @rules
        @given(coco_files())
        def read_coco(case: tuple[list[Stored], dict[str, Any], dict[str, Any]]) -> None:
            check_coco_file(folder, *case, tally)

        @rules
        @given(destroyed_control())
        def read_destroyed_control(data: bytes) -> None:
            path = folder / "gcp_list.txt"
            path.write_bytes(data)
            try:
                points = match_marks(read_surveyed_points(path), ["multiview/DJI_0001.JPG"]).points
            except InputDataError:
                tally.outcomes["destroyed control points refused"] += 1
                return
            tally.outcomes["destroyed control points read"] += 1
            if not all(math.isfinite(value) for point in points for value in (point.x, point.y, point.z)):
                tally.wrong.append(f"coordinates that are not finite: {data!r}")

        @rules
        @given(destroyed_coco())
        def read_destroyed_coco(data: bytes) -> None:
            path = folder / "boxes.json"
            path.write_bytes(data)
            photos = [Stored(f"{f}/{s}{x}".lstrip("/"), 1) for f in ("multiview", "") for s in STEMS for x in SUFFIXES]
            try:
                rows = import_coco(path, make_photos(photos), class_names={}).to_pylist()
            except InputDataError:
                tally.outcomes["destroyed COCO refused"] += 1
                return
            for row in rows:
                tally.outcomes[f"destroyed boxes {row['detection_outcome']}"] += 1
                if row["detection_outcome"] == "accepted" and not (
                    0 <= row["box_x_px"] <= row["box_x_px"] + row["box_width_px"] <= SIZE[0] + 1e-6
                    and 0 <= row["box_y_px"] <= row["box_y_px"] + row["box_height_px"] <= SIZE[1] + 1e-6
                ):
                    tally.wrong.append(f"a box outside its photograph was accepted: {row}")

        for part in (read_control, read_coco, read_destroyed_control, read_destroyed_coco):
            part()
    return tally


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--inputs", type=int, default=10_000)
    arguments = parser.parse_args()
    begin = time.perf_counter()
    tally = run(arguments.inputs)
    for name, count in sorted(tally.outcomes.items()):
        print(f"{count:8,}  {name}")
    print(f"{arguments.inputs:,} inputs in {time.perf_counter() - begin:.0f} s; {len(tally.wrong)} wrong")
    for one in tally.wrong[:5]:
        print(f"\n{one}")
    raise SystemExit(bool(tally.wrong))


if __name__ == "__main__":
    main()
