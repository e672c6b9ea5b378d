"""Labels in Pascal VOC form: an XML file a photograph."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from facadelake.detection import Box, Crosswalk
from facadelake.evaluation.detectors.labels.labels import LabelCollector, LabelledSet, TruthBox, find_photographs
from schemas.vocabulary import DefectClass

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


def read_voc_labels(folder: Path, crosswalk: Crosswalk) -> LabelledSet:
    """Photographs and boxes of the XML files below ``folder``; photographs beside them or anywhere below, by name.

    VOC counts pixels from 1 and includes the last one, so that a box of xmin 1, xmax 10 is 10 pixels wide from the
    left border (devkit of VOC2012). Objects marked difficult are ignored. VOC has no list of classes: every class that
    some file names is labelled everywhere.
    """
    gathered = LabelCollector(folder)
    by_name: dict[str, list[Path]] = {}
    for photograph in find_photographs(folder):
        by_name.setdefault(photograph.name, []).append(photograph)
        by_name.setdefault(photograph.stem, []).append(photograph)
    read: list[tuple[Path, tuple[int, int], list[TruthBox]]] = []
    labelled: set[DefectClass] = set()
    for file in sorted(folder.rglob("*.xml")):
        tree = _read_annotation(file, gathered)
        if tree is None:
            continue
        path = _find_photograph(tree, file, by_name)
        if path is None:
            gathered.left_out["photographs that are not there"] += 1
            continue
        size = gathered.read_size(path)
        if size is None:
            continue
        stated = tuple(_parse_number(tree.findtext(f"size/{side}")) for side in ("width", "height"))
        if None not in stated and 0 not in stated and stated != size:
            gathered.left_out["photographs of another size than the file says (turned or resized after labelling)"] += 1
            continue
        boxes = []
        for thing in tree.iterfind("object"):
            name = (thing.findtext("name") or "").strip()
            defect_class = crosswalk.find_defect_class(name)
            box = _parse_box(thing)
            if box is None:
                gathered.left_out["boxes that are not four numbers"] += 1
            elif defect_class is None:
                gathered.left_out[f"boxes of class '{name}', which stands for no defect class"] += 1
            else:
                difficult = (thing.findtext("difficult") or "").strip() == "1"
                boxes.append(TruthBox(box=box, defect_class=defect_class, ignored=difficult))
                labelled.add(defect_class)
        read.append((path, size, boxes))
    for path, size, boxes in read:
        gathered.add(path, size, boxes, frozenset(labelled))
    return gathered.create_set("voc")


def _read_annotation(file: Path, gathered: LabelCollector) -> Element | None:
    try:
        tree: Element | None = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError, DefusedXmlException, ValueError):
        gathered.left_out["XML files that cannot be read"] += 1
        return None
    return tree if tree is not None and tree.tag == "annotation" else None


def _find_photograph(tree: Element, file: Path, by_name: dict[str, list[Path]]) -> Path | None:
    """By the file's ``filename``, else by the XML file's own name: beside it, in VOC's place, or anywhere if alone."""
    stated = (tree.findtext("filename") or "").strip().replace("\\", "/").rsplit("/", 1)[-1]
    for name in filter(None, (stated, file.stem)):
        alike = list(dict.fromkeys(by_name.get(name, [])))
        for folder in (file.parent, file.parent.parent / "JPEGImages", file.parent.parent / "images"):
            near = [path for path in alike if path.parent == folder]
            if len(near) == 1:
                return near[0]
        if len(alike) == 1:
            return alike[0]
    return None


def _parse_number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _parse_box(thing: Element) -> Box | None:
    values = [_parse_number(thing.findtext(f"bndbox/{side}")) for side in ("xmin", "ymin", "xmax", "ymax")]
    numbers = [value for value in values if value is not None]
    if len(numbers) != 4:
        return None
    left, top, right, bottom = numbers
    return Box(x_px=left - 1, y_px=top - 1, width_px=right - left + 1, height_px=bottom - top + 1)
