"""Control point files as many programs write them, some with a mistake, and what must be read from them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from facadelake.core.errors import InputDataError
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
