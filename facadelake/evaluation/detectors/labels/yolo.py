"""Labels in YOLO format: one text file for each photograph, one line for each box: class, centre x, centre y, width,
height from 0 to 1."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from facadelake.core.errors import InputDataError
from facadelake.core.photo_names import PhotoNames
from facadelake.detection import Box, Crosswalk
from facadelake.detection.inference import read_exif_orientation
from facadelake.evaluation.detectors.labels.labels import LabelCollector, LabelledSet, TruthBox, find_photographs

# Labelling tools write shares of the rotated view; nothing states whether this one did.
_EXIF_ROTATED = (
    "photographs with an EXIF rotation (YOLO does not define the view of its coordinates; store them upright)"
)
_SEVERAL = "photographs with several text files, or whose text file matches several photographs"
_NAME_FILES = ("data.yaml", "data.yml", "dataset.yaml", "classes.txt", "obj.names", "labels/classes.txt")


def read_yolo_labels(folder: Path, crosswalk: Crosswalk, class_names: Sequence[str], split: str | None) -> LabelledSet:
    """Read the photographs below ``folder`` with their text files, beside them or in ``labels`` for ``images``.

    A line of polygon points is its bounding box. Text files name photographs as all other files do: case does not
    matter, and one that several photographs match leaves them out. A photograph without a text file is free of defects,
    as for YOLO's trainers, and counted. One with labels and an EXIF rotation is left out.

    Args:
        folder: The data folder.
        crosswalk: Defect classes by class name.
        class_names: Names of the class numbers, in their order; empty: those of data.yaml, classes.txt or obj.names.
        split: Only photographs with this name among their folders, where there are such.

    Raises:
        InputDataError: The class numbers have no names, or no photograph can be used.
    """
    collector = LabelCollector(folder)
    names = tuple(class_names) or _find_class_names(folder)
    classes = [crosswalk.find_defect_class(name) for name in names]
    labelled = frozenset(one for one in classes if one is not None)
    paths = find_photographs(folder)
    in_split = [path for path in paths if split in path.relative_to(folder).parts[:-1]]
    text_files = _match_text_files(folder, paths, collector)
    without = 0
    for path in in_split or paths:
        size = collector.read_size(path)
        if size is None:
            continue
        files = text_files.get(path, ())
        lines: list[str] = []
        if len(files) > 1:
            collector.left_out[_SEVERAL] += 1
            continue
        if not files:
            without += 1
        else:
            try:
                lines = files[0].read_text(encoding="utf-8-sig").splitlines()
            except (OSError, UnicodeDecodeError):
                collector.left_out["photographs whose text file cannot be read"] += 1
                continue
        if lines and read_exif_orientation(path) != 1:
            collector.left_out[_EXIF_ROTATED] += 1
            continue
        boxes = []
        for line in lines:
            if not line.strip():
                continue
            number, box = _parse_line(line, size)
            if number is None or box is None:
                collector.left_out["lines that are not a class and a box from 0 to 1"] += 1
            elif not 0 <= number < len(classes):
                collector.left_out[f"boxes of class number {number} without a name ({len(classes)} names)"] += 1
            elif (defect_class := classes[number]) is None:
                collector.left_out[f"boxes of class '{names[number]}', which has no defect class"] += 1
            else:
                boxes.append(TruthBox(box=box, defect_class=defect_class))
        collector.add(path, size, boxes, labelled)
    if without == len(collector.images):
        collector.images.clear()  # without text files there are no labels
    elif without:
        collector.left_out["photographs without a text file, which count as free of defects"] = without
    return collector.create_set("yolo")


def _match_text_files(
    folder: Path, paths: Sequence[Path], collector: LabelCollector
) -> Mapping[Path, tuple[Path, ...]]:
    """The text files of each photograph that has one; two entries where it is not clear which one.

    Args:
        folder: The data folder.
        paths: The photographs.
        collector: Counts labels of no photograph.
    """
    by_key = {path.relative_to(folder).as_posix(): path for path in paths}
    names = PhotoNames(by_key)
    files: dict[str, list[Path]] = defaultdict(list)
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() == ".txt" and file.is_file() and file.name.lower() != "classes.txt":
            files[_name_photograph(file.relative_to(folder))].append(file)
    found: dict[Path, tuple[Path, ...]] = {}
    for name, match in names.match_all(files).items():
        # A name that is ambiguous among the others matches a photograph by itself.
        alone = names.match(name)
        keys = [key for key in (match.photo_id,) if key] or [*match.candidates, *filter(None, [alone.photo_id])]
        for key in keys:
            found[by_key[key]] = (*found.get(by_key[key], ()), *files[name], *([] if match.photo_id else files[name]))
        if not keys:
            collector.left_out["text files of labels whose photograph does not exist"] += sum(
                map(_has_boxes, files[name])
            )
    return found


def _name_photograph(file: Path) -> str:
    """The name of a text file's photograph, without suffix: beside it, or in ``images`` for ``labels``."""
    parts = list(file.with_suffix("").parts)
    at = next((i for i in reversed(range(len(parts) - 1)) if parts[i].lower() == "labels"), None)
    if at is not None:
        parts[at] = "images"
    return "/".join(parts)


def _has_boxes(file: Path) -> bool:
    """Whether the first line of a text file is a box: there are other text files in such folders."""
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError):
        return False
    return bool(lines) and _parse_line(lines[0], (1, 1))[1] is not None


def _parse_line(line: str, size: tuple[int, int]) -> tuple[int | None, Box | None]:
    """Class number and box, px; None for a value that the line does not have."""
    fields = line.split()
    try:
        number, values = int(fields[0]), [float(field) for field in fields[1:]]
    except ValueError:
        return None, None
    if not all(math.isfinite(value) and -0.5 <= value <= 1.5 for value in values):
        return None, None
    width, height = size
    if len(values) in (4, 5):  # the fifth is a score
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
        f"{folder} has YOLO labels, but no names of their class numbers; add a data.yaml with 'names' or a classes.txt "
        "(one name a line), or give --classes crack,spalling in the order of the numbers"
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
            raise InputDataError(f"{path}: 'names' has numbers {sorted(map(str, names))}; they must be 0, 1, 2, ...")
        return tuple(str(names[i]) for i in range(len(names)))
    return tuple(str(name) for name in names) if isinstance(names, list) else ()
