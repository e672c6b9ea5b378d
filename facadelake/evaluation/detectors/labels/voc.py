"""Labels in Pascal VOC format: one XML file for each photograph."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from facadelake.core.photo_names import PhotoNames
from facadelake.detection import Box, Crosswalk
from facadelake.detection.inference import read_exif_orientation
from facadelake.evaluation.detectors.labels.labels import LabelCollector, LabelledSet, TruthBox, find_photographs
from schemas.vocabulary import DefectClass

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


def read_voc_labels(folder: Path, crosswalk: Crosswalk) -> LabelledSet:
    """Read the XML files below ``folder``; their photographs are searched beside them and below ``folder``, by name.

    VOC counts pixels from 1 and includes the last one: a box of xmin 1, xmax 10 is 10 pixels wide from the left border
    (development kit of VOC2012). Difficult objects are ignored. VOC has no list of classes: each class in one of the
    files counts as labelled in all photographs.
    """
    collector = LabelCollector(folder)
    by_key = {photograph.relative_to(folder).as_posix(): photograph for photograph in find_photographs(folder)}
    names = PhotoNames(by_key)
    read: list[tuple[Path, tuple[int, int], list[TruthBox]]] = []
    labelled: set[DefectClass] = set()
    for file in sorted(folder.rglob("*.xml")):
        tree = _read_annotation(file, collector)
        if tree is None:
            continue
        path = by_key.get(_find_photograph(tree, file.relative_to(folder), names) or "")
        if path is None:
            collector.left_out["photographs that do not exist, or whose name matches several"] += 1
            continue
        size = collector.read_size(path)
        if size is None:
            continue
        stated = tuple(_parse_number(tree.findtext(f"size/{side}")) for side in ("width", "height"))
        if None not in stated and 0 not in stated and stated != size:
            collector.left_out["photographs of another size than in the labels (rotated or resized)"] += 1
            continue
        if read_exif_orientation(path) != 1:
            collector.left_out["photographs that EXIF turns (VOC does not define the view of its boxes)"] += 1
            continue
        boxes = []
        for element in tree.iterfind("object"):
            name = (element.findtext("name") or "").strip()
            defect_class = crosswalk.find_defect_class(name)
            box = _parse_box(element)
            if box is None:
                collector.left_out["boxes that are not four numbers"] += 1
            elif defect_class is None:
                collector.left_out[f"boxes of class '{name}', which has no defect class"] += 1
            else:
                difficult = (element.findtext("difficult") or "").strip() == "1"
                boxes.append(TruthBox(box=box, defect_class=defect_class, ignored=difficult))
                labelled.add(defect_class)
        read.append((path, size, boxes))
    for path, size, boxes in read:
        collector.add(path, size, boxes, frozenset(labelled))
    return collector.create_set("voc")


def _read_annotation(file: Path, collector: LabelCollector) -> Element | None:
    try:
        tree: Element | None = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError, DefusedXmlException, ValueError):
        collector.left_out["XML files that cannot be read"] += 1
        return None
    return tree if tree is not None and tree.tag == "annotation" else None


def _find_photograph(tree: Element, file: Path, names: PhotoNames) -> str | None:
    """The key of the photograph by ``filename``, else by the XML file's name: beside it, in VOC's folder, or the only
    one of the name."""
    stated = (tree.findtext("filename") or "").strip().replace("\\", "/").rsplit("/", 1)[-1]
    folders = (file.parent, file.parent.parent / "JPEGImages", file.parent.parent / "images")
    for name in filter(None, (stated, file.stem)):
        near = (names.match(f"./{(folder / name).as_posix()}").photo_id for folder in folders)
        found = next(filter(None, near), None) or names.match(name).photo_id
        if found:
            return found
    return None


def _parse_number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _parse_box(element: Element) -> Box | None:
    values = [_parse_number(element.findtext(f"bndbox/{side}")) for side in ("xmin", "ymin", "xmax", "ymax")]
    numbers = [value for value in values if value is not None]
    if len(numbers) != 4:
        return None
    left, top, right, bottom = numbers
    return Box(x_px=left - 1, y_px=top - 1, width_px=right - left + 1, height_px=bottom - top + 1)
