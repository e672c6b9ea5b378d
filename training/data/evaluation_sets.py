"""Real pictures of spalling and moisture for validation and test, as COCO folders for `facadelake evaluate-detector`.

`python -m training.data.evaluation_sets OUT` writes `OUT/mould_indoor` (with our own boxes, drawn_boxes.yaml) and, with
a YOLO export with polygons of "spalling" and "exposed_rebar", `OUT/spalling_web/{val,test}`. Pictures are linked. These
sets are not used for training.
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

from facadelake.core.arrays import Float64Array
from facadelake.core.errors import FacadelakeError
from schemas.vocabulary import DefectClass
from training.data.sample import CLASSES

DRAWN_BOXES_PATH = Path(__file__).with_name("drawn_boxes.yaml")
CONTAINED_SHARE_MIN = 0.6  # smallest share of a bar's box inside the box of a hole: then the hole was outlined too


@dataclass(frozen=True, kw_only=True)
class EvaluationPicture:
    """A picture and its boxes (4,): class, and x_min, y_min, x_max, y_max in pixels."""

    path: Path
    boxes_px: tuple[tuple[DefectClass, Float64Array], ...]


def read_drawn_boxes(defects: Path, set_name: str = "mould_indoor") -> tuple[EvaluationPicture, ...]:
    """The pictures of a set in drawn_boxes.yaml; entries without boxes are pictures without defects."""
    entries = yaml.safe_load(DRAWN_BOXES_PATH.read_text(encoding="utf-8"))[set_name]
    pictures = []
    for name, by_class in entries.items():
        path = defects / set_name / name
        height, width = _read_size(path)
        size = np.array([width, height, width, height])
        boxes = [(DefectClass(kind), np.array(box) * size) for kind, drawn in by_class.items() for box in drawn]
        pictures.append(EvaluationPicture(path=path, boxes_px=tuple(boxes)))
    return tuple(pictures)


def read_spalling_polygons(part: Path) -> tuple[EvaluationPicture, ...]:
    """One part (folder with `images` and `labels`) of a YOLO export with polygons: 0 exposed_rebar, 1 spalling.

    In many pictures the bars are outlined but not the hole around them, so that the box of the spalling is unknown.
    Only pictures in which every bar lies in an outlined hole are returned.
    """
    pictures = []
    for label in sorted((part / "labels").glob("*.txt")):
        path = part / "images" / f"{label.stem}.jpg"
        height, width = _read_size(path)
        boxes: tuple[list[Float64Array], list[Float64Array]] = ([], [])
        for line in label.read_text(encoding="utf-8").split("\n"):
            values = line.split()
            if len(values) >= 7:
                points = np.clip(np.array(values[1:], dtype=np.float64).reshape(-1, 2), 0, 1) * [width, height]
                boxes[int(values[0])].append(np.concatenate([points.min(axis=0), points.max(axis=0)]))
        bars, holes = boxes
        if holes and all(
            any(_compute_share_within(bar, hole) >= CONTAINED_SHARE_MIN for hole in holes) for bar in bars
        ):
            pictures.append(
                EvaluationPicture(path=path, boxes_px=tuple((DefectClass.SPALLING, hole) for hole in holes))
            )
    return tuple(pictures)


def write_coco(pictures: Iterable[EvaluationPicture], out: Path) -> Path:
    """Link the pictures to `out`/images and write `out`/coco.json; all classes count as labelled. Returns its path."""
    (out / "images").mkdir(parents=True, exist_ok=True)
    images: list[dict[str, object]] = []
    annotations: list[dict[str, object]] = []
    for number, one in enumerate(pictures):
        name = f"{one.path.parent.name}_{one.path.name}"
        link = out / "images" / name
        link.unlink(missing_ok=True)
        link.symlink_to(one.path.resolve())
        height, width = _read_size(one.path)
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


def _read_size(path: Path) -> tuple[int, int]:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise FacadelakeError(
            f"{path}: no picture can be read there; restore the set as described in its PROVENANCE.txt"
        )
    return int(image.shape[0]), int(image.shape[1])


def _compute_share_within(inner: Float64Array, outer: Float64Array) -> float:
    """Share of the area of box `inner` (4,) that lies in box `outer` (4,)."""
    size = np.clip(np.minimum(inner[2:], outer[2:]) - np.maximum(inner[:2], outer[:2]), 0, None)
    return float(np.prod(size) / max(1e-9, float(np.prod(inner[2:] - inner[:2]))))


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.data.evaluation_sets", description="COCO folders for validation and test."
    )
    parser.add_argument("out", type=Path, help="folder to write to")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder with defects/")
    parser.add_argument("--spalling-export", type=Path, help="folder with valid/ and test/ of the Roboflow export")
    options = parser.parse_args()
    print(write_coco(read_drawn_boxes(options.data / "defects"), options.out / "mould_indoor"))
    if options.spalling_export:
        for part, split in (("valid", "val"), ("test", "test")):
            pictures = read_spalling_polygons(options.spalling_export / part)
            print(write_coco(pictures, options.out / "spalling_web" / split), len(pictures))


if __name__ == "__main__":
    main()
