"""Real pictures of spalling and moisture that only judge, as COCO folders for `facadelake evaluate-detector`.

`python -m training.data.judged OUT` writes `OUT/mould_indoor` (boxes drawn by us, drawn_boxes.yaml) and, where a YOLO
export with polygons of "spalling" and "exposed_rebar" is given, `OUT/spalling_web/{val,test}`. Pictures are linked.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from facadelake.core.errors import FacadelakeError
from schemas.vocabulary import DefectClass
from training.data.sample import CLASSES

DRAWN_PATH = Path(__file__).with_name("drawn_boxes.yaml")
WITHIN = 0.6  # share of a bar's box in the box of a hole: the hole was outlined, too


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A picture and its boxes, x_min, y_min, x_max, y_max px, by class."""

    path: Path
    boxes_px: tuple[tuple[DefectClass, NDArray[np.float64]], ...]


def read_drawn(defects: Path, set_name: str = "mould_indoor") -> tuple[Judged, ...]:
    """The pictures of a set for which drawn_boxes.yaml has boxes (or says that there is nothing)."""
    pictures = yaml.safe_load(DRAWN_PATH.read_text(encoding="utf-8"))[set_name]
    judged = []
    for name, by_class in pictures.items():
        path = defects / set_name / name
        height, width = _shape(path)
        size = np.array([width, height, width, height])
        boxes = [(DefectClass(kind), np.array(box) * size) for kind, drawn in by_class.items() for box in drawn]
        judged.append(Judged(path=path, boxes_px=tuple(boxes)))
    return tuple(judged)


def read_spalling_polygons(part: Path) -> tuple[Judged, ...]:
    """One part (folder with `images` and `labels`) of a YOLO export with polygons: 0 exposed_rebar, 1 spalling.

    Many pictures outline the bars alone and not the hole about them; what a box of spalling should be is then unknown.
    Only pictures are taken in which every bar lies in an outlined hole.
    """
    judged = []
    for label in sorted((part / "labels").glob("*.txt")):
        path = part / "images" / f"{label.stem}.jpg"
        height, width = _shape(path)
        boxes: tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]] = ([], [])
        for line in label.read_text(encoding="utf-8").split("\n"):
            values = line.split()
            if len(values) >= 7:
                points = np.clip(np.array(values[1:], dtype=np.float64).reshape(-1, 2), 0, 1) * [width, height]
                boxes[int(values[0])].append(np.concatenate([points.min(axis=0), points.max(axis=0)]))
        bars, holes = boxes
        if holes and all(any(_share_within(bar, hole) >= WITHIN for hole in holes) for bar in bars):
            judged.append(Judged(path=path, boxes_px=tuple((DefectClass.SPALLING, hole) for hole in holes)))
    return tuple(judged)


def write_coco(judged: Iterable[Judged], out: Path) -> Path:
    """Link the pictures into `out`/images and write `out`/coco.json; all classes count as looked for."""
    (out / "images").mkdir(parents=True, exist_ok=True)
    images: list[dict[str, object]] = []
    annotations: list[dict[str, object]] = []
    for number, one in enumerate(judged):
        name = f"{one.path.parent.name}_{one.path.name}"
        link = out / "images" / name
        link.unlink(missing_ok=True)
        link.symlink_to(one.path.resolve())
        height, width = _shape(one.path)
        images.append({"id": number, "file_name": f"images/{name}", "width": width, "height": height})
        for kind, (x0, y0, x1, y1) in one.boxes_px:
            box = [round(float(value), 1) for value in (x0, y0, x1 - x0, y1 - y0)]
            annotations.append(
                {"id": len(annotations) + 1, "image_id": number, "category_id": CLASSES.index(kind), "bbox": box,
                 "area": box[2] * box[3], "iscrowd": 0}
            )  # fmt: skip
    categories = [{"id": CLASSES.index(kind), "name": kind.value} for kind in CLASSES]
    path = out / "coco.json"
    path.write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}), "utf-8")
    return path


def _shape(path: Path) -> tuple[int, int]:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise FacadelakeError(f"{path}: no picture can be read there; put the set back as its PROVENANCE.txt says")
    return int(image.shape[0]), int(image.shape[1])


def _share_within(inner: NDArray[np.float64], outer: NDArray[np.float64]) -> float:
    """Share of `inner`'s area that lies in `outer`."""
    size = np.clip(np.minimum(inner[2:], outer[2:]) - np.maximum(inner[:2], outer[:2]), 0, None)
    return float(np.prod(size) / max(1e-9, float(np.prod(inner[2:] - inner[:2]))))


def main() -> None:
    """Read the command line and write."""
    parser = argparse.ArgumentParser(prog="python -m training.data.judged", description="COCO folders that only judge.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="holds defects/")
    parser.add_argument("--spalling-export", type=Path, help="folder with valid/ and test/ of the Roboflow export")
    given = parser.parse_args()
    print(write_coco(read_drawn(given.data / "defects"), given.out / "mould_indoor"))
    if given.spalling_export:
        for part, split in (("valid", "val"), ("test", "test")):
            judged = read_spalling_polygons(given.spalling_export / part)
            print(write_coco(judged, given.out / "spalling_web" / split), len(judged))


if __name__ == "__main__":
    main()
