"""Labels in YOLO form: a text file a photograph, a line a box: class, centre x, centre y, width, height in 0..1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from facadelake.core.errors import InputDataError
from facadelake.detection import Box, Crosswalk
from facadelake.detection.inference import has_exif_rotation
from facadelake.evaluation.detectors.labels.labels import LabelCollector, LabelledSet, TruthBox, find_photographs

# Labelling tools show the turned view and write shares of it; the pixels as stored are another view.
_EXIF_ROTATED = "photographs that EXIF turns (YOLO does not say of which view its shares are; store them upright)"
_NAME_FILES = ("data.yaml", "data.yml", "dataset.yaml", "classes.txt", "obj.names", "labels/classes.txt")


def read_yolo_labels(folder: Path, crosswalk: Crosswalk, class_names: Sequence[str], split: str | None) -> LabelledSet:
    """Photographs and boxes below ``folder``: text files beside their photographs, or in ``labels`` for ``images``.

    ``class_names`` in the order of the files' numbers; empty: those of data.yaml, classes.txt or obj.names. Only
    photographs with ``split`` among their folders are taken, where it is given and there are such. A line of polygon
    points is its box. A photograph without a text file has no defects, as YOLO's trainers take it, and is counted; one
    with boxes that EXIF turns is left out.
    Raises InputDataError where nobody says what the numbers stand for.
    """
    gathered = LabelCollector(folder)
    names = tuple(class_names) or _find_class_names(folder)
    classes = [crosswalk.find_defect_class(name) for name in names]
    labelled = frozenset(one for one in classes if one is not None)
    paths = find_photographs(folder)
    of_split = [path for path in paths if split in path.relative_to(folder).parts[:-1]]
    without = 0
    for path in of_split or paths:
        size = gathered.read_size(path)
        if size is None:
            continue
        text_file = _find_text_file(path, folder)
        lines: list[str] = []
        if text_file is None:
            without += 1
        else:
            try:
                lines = text_file.read_text(encoding="utf-8-sig").splitlines()
            except (OSError, UnicodeDecodeError):
                gathered.left_out["photographs whose text file cannot be read"] += 1
                continue
        if lines and has_exif_rotation(path):
            gathered.left_out[_EXIF_ROTATED] += 1
            continue
        boxes = []
        for line in lines:
            if not line.strip():
                continue
            number, box = _parse_line(line, size)
            if number is None or box is None:
                gathered.left_out["lines that are not a class and a box of 0..1"] += 1
            elif not 0 <= number < len(classes):
                gathered.left_out[f"boxes of class {number}, of {len(classes)} named"] += 1
            elif (defect_class := classes[number]) is None:
                gathered.left_out[f"boxes of class '{names[number]}', which stands for no defect class"] += 1
            else:
                boxes.append(TruthBox(box=box, defect_class=defect_class))
        gathered.add(path, size, boxes, labelled)
    if without == len(gathered.images):
        gathered.images.clear()  # photographs alone are no labels
    elif without:
        gathered.left_out["text files missing: their photographs were taken as free of defects"] = without
    return gathered.create_set("yolo")


def _find_text_file(photograph: Path, folder: Path) -> Path | None:
    """The text file beside a photograph, or at its place in ``labels``."""
    beside = photograph.with_suffix(".txt")
    if beside.is_file():
        return beside
    parts = list(photograph.relative_to(folder).parts)
    for i in reversed(range(len(parts) - 1)):
        if parts[i].lower() == "images":
            twin = folder.joinpath(*parts[:i], "labels", *parts[i + 1 :]).with_suffix(".txt")
            return twin if twin.is_file() else None
    twin = (folder / "labels").joinpath(*parts).with_suffix(".txt")
    return twin if twin.is_file() else None


def _parse_line(line: str, size: tuple[int, int]) -> tuple[int | None, Box | None]:
    """Class number and box in pixels; None where the line does not say it."""
    words = line.split()
    try:
        number, values = int(words[0]), [float(word) for word in words[1:]]
    except ValueError:
        return None, None
    if not all(math.isfinite(value) and -0.5 <= value <= 1.5 for value in values):
        return None, None
    width, height = size
    if len(values) in (4, 5):  # a fifth is a score
        x, y, w, h = values[:4]
        return number, Box(
            x_px=(x - w / 2) * width, y_px=(y - h / 2) * height, width_px=w * width, height_px=h * height
        )
    if len(values) >= 6 and len(values) % 2 == 0:
        xs, ys = values[0::2], values[1::2]
        left, top = min(xs) * width, min(ys) * height
        return number, Box(x_px=left, y_px=top, width_px=max(xs) * width - left, height_px=max(ys) * height - top)
    return None, None


def _find_class_names(folder: Path) -> tuple[str, ...]:
    for name in _NAME_FILES:
        path = folder / name
        if path.is_file():
            names = _read_yaml_names(path) if path.suffix in {".yaml", ".yml"} else _read_name_lines(path)
            if names:
                return names
    raise InputDataError(
        f"{folder} holds YOLO labels, but nothing says what their class numbers stand for; put a data.yaml with "
        "'names' or a classes.txt there (a name a line), or give --classes crack,spalling in the order of the numbers"
    )


def _read_name_lines(path: Path) -> tuple[str, ...]:
    return tuple(line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip())


def _read_yaml_names(path: Path) -> tuple[str, ...]:
    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputDataError(f"{path} cannot be read as YAML: {error}") from error
    names = content.get("names") if isinstance(content, dict) else None
    if isinstance(names, dict):
        if not all(isinstance(key, int) for key in names) or sorted(names) != list(range(len(names))):
            raise InputDataError(f"{path}: 'names' numbers {sorted(map(str, names))}; they must be 0, 1, 2, ...")
        return tuple(str(names[i]) for i in range(len(names)))
    return tuple(str(name) for name in names) if isinstance(names, list) else ()
