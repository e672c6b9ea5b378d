"""Labelled photographs of any format: detection of the format and choice of the split."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.detection import Crosswalk
from facadelake.evaluation.detectors.labels.coco import read_coco_labels
from facadelake.evaluation.detectors.labels.format import LabelFormat
from facadelake.evaluation.detectors.labels.labels import PHOTOGRAPH_SUFFIXES, LabelledSet
from facadelake.evaluation.detectors.labels.voc import read_voc_labels
from facadelake.evaluation.detectors.labels.yolo import read_yolo_labels


def open_labels(
    data: Path,
    crosswalk: Crosswalk,
    *,
    label_format: LabelFormat = LabelFormat.AUTO,
    class_names: Sequence[str] = (),
    split: str | None = None,
    has_sites: bool = False,
) -> LabelledSet:
    """Read labelled photographs.

    Args:
        data: A COCO file, or a folder of COCO, YOLO or VOC labels.
        crosswalk: Defect classes by class name.
        label_format: The format; ``auto``: detected.
        class_names: Names of YOLO's class numbers, in their order; empty: those of the folder's files.
        split: Only this split (train, val, test), by the folders or the name of the COCO file.
        has_sites: A file of sites selects the split later.

    Raises:
        InputDataError: There are no labels of the format, or several formats or COCO files to choose from, or nothing
            that names the split.
    """
    if not data.exists():
        raise InputDataError(f"labelled data {data} does not exist; give a COCO file or a folder of labels")
    labelled = _read_labels(data, crosswalk, label_format, class_names, split)
    if split is not None and not has_sites and not _is_of_split(labelled, data, split):
        raise InputDataError(
            f"{data} does not define the photographs of split '{split}': neither its folders nor a COCO file have that "
            "name; give --sites with a column 'split', or omit --split"
        )
    return labelled


def _is_of_split(labelled: LabelledSet, data: Path, split: str) -> bool:
    """Whether the COCO file, or a folder of each photograph, has the name of the split."""
    by_folder = all(split in image.key.split("/")[:-1] for image in labelled.images)
    return by_folder or split in _split_stem(data if data.is_file() else labelled.source or data)


def _split_stem(path: Path) -> list[str]:
    return path.stem.replace("-", "_").replace(".", "_").split("_")


def _read_labels(
    data: Path, crosswalk: Crosswalk, label_format: LabelFormat, class_names: Sequence[str], split: str | None
) -> LabelledSet:
    if data.is_file():
        if data.suffix.lower() != ".json" or label_format not in (LabelFormat.AUTO, LabelFormat.COCO):
            raise InputDataError(
                f"{data} is a file, but only COCO labels (.json) are a file; give the folder of YOLO or VOC labels"
            )
        return read_coco_labels(data, crosswalk)
    coco_files = _find_coco_files(data) if label_format in (LabelFormat.AUTO, LabelFormat.COCO) else []
    if label_format is LabelFormat.AUTO:
        label_format = _detect_format(data, coco_files)
    if label_format is LabelFormat.COCO:
        return read_coco_labels(_choose_coco_file(data, coco_files, split), crosswalk)
    if label_format is LabelFormat.VOC:
        return read_voc_labels(data, crosswalk)
    return read_yolo_labels(data, crosswalk, class_names, split)


def _detect_format(folder: Path, coco_files: list[Path]) -> LabelFormat:
    found = [LabelFormat.COCO] if coco_files else []
    if any(_is_voc(path) for path in islice(folder.rglob("*.xml"), 20)):
        found.append(LabelFormat.VOC)
    if any(path.name != "classes.txt" and _is_yolo(path) for path in islice(folder.rglob("*.txt"), 200)):
        found.append(LabelFormat.YOLO)
    if len(found) != 1:
        names = " and ".join(found) or "neither COCO nor YOLO nor VOC"
        raise InputDataError(
            f"{folder} has labels of {names}; choose with --format coco, yolo or voc, or give the COCO file itself"
        )
    return found[0]


def _find_coco_files(folder: Path) -> list[Path]:
    files = [*folder.glob("*.json"), *folder.glob("annotations/*.json")]
    return sorted(path for path in files if _is_coco(path))


def _choose_coco_file(folder: Path, files: list[Path], split: str | None) -> Path:
    if len(files) > 1 and split is not None:
        files = [path for path in files if split in _split_stem(path)] or files
    if len(files) != 1:
        names = ", ".join(path.name for path in files) or "none"
        raise InputDataError(
            f"{folder} has {len(files)} COCO files ({names}); give one with --data, or choose with --split"
        )
    return files[0]


def _is_coco(path: Path) -> bool:
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError):
        return False
    return isinstance(content, dict) and {"images", "annotations"} <= content.keys()  # the reader reports missing keys


def _is_voc(path: Path) -> bool:
    try:
        return "<annotation" in path.read_text(encoding="utf-8-sig")[:2000]
    except (OSError, UnicodeDecodeError):
        return False


def _is_yolo(path: Path) -> bool:
    """Whether the first line is at least five numbers, or the file is empty and beside a photograph of its name."""
    try:
        text = path.read_text(encoding="utf-8-sig").strip()
    except (OSError, UnicodeDecodeError):
        return False
    if not text:
        return any(path.with_suffix(ending).is_file() for ending in PHOTOGRAPH_SUFFIXES)
    values = text.splitlines()[0].split()
    try:
        [float(value) for value in values]
    except ValueError:
        return False
    return len(values) >= 5
