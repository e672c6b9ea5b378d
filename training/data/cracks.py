"""Real sets of cracks with terms that allow training: `crack_boxes_640` (COCO) and `omu_quay_crack_yolo` (YOLO)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from facadelake.core.arrays import Float64Nx4
from facadelake.core.errors import FacadelakeError
from schemas.vocabulary import DefectClass
from training.data.sample import CLASSES, Sample
from training.data.sites import read_sites

CRACK = CLASSES.index(DefectClass.CRACK)
OMU_SIDE_PX = 256


def read_crack_boxes(defects: Path) -> tuple[Sample, ...]:
    """All pictures of `crack_boxes_640` with their sites and splits; `defects` is the folder `data/defects`."""
    folder = defects / "crack_boxes_640"
    coco = json.loads((folder / "coco.json").read_text(encoding="utf-8"))
    boxes: dict[int, list[list[float]]] = {}
    for annotation in coco["annotations"]:
        x, y, width, height = annotation["bbox"]
        boxes.setdefault(annotation["image_id"], []).append([x, y, x + width, y + height])
    return tuple(
        _create_sample(folder / "images" / image["file_name"], np.array(boxes.get(image["id"], []), dtype=np.float64))
        for image in sorted(coco["images"], key=lambda image: str(image["file_name"]))
    )


def read_omu_quays(defects: Path) -> tuple[Sample, ...]:
    """All tiles (256 x 256 px) of the two quays of `omu_quay_crack_yolo`."""
    folder = defects / "omu_quay_crack_yolo"
    samples = []
    for label in sorted((folder / "BOX").glob("*/*.txt")):
        pictures = [path for ending in (".JPG", ".jpg") if (path := label.with_suffix(ending)).exists()]
        if not pictures:
            raise FacadelakeError(f"{label}: no picture of this name beside it; the set is incomplete")
        rows = np.loadtxt(label, dtype=np.float64, ndmin=2).reshape(-1, 5)
        centre, size = rows[:, 1:3] * OMU_SIDE_PX, rows[:, 3:5] * OMU_SIDE_PX
        samples.append(_create_sample(pictures[0], np.hstack([centre - size / 2, centre + size / 2])))
    return tuple(samples)


def read_cracks(defects: Path) -> tuple[Sample, ...]:
    """All pictures of both sets, with their splits."""
    return (*read_crack_boxes(defects), *read_omu_quays(defects))


def _create_sample(path: Path, boxes_px: Float64Nx4) -> Sample:
    """A picture with its site and split, from its set and file name."""
    set_name = "omu_quay_crack_yolo" if path.parts[-3] == "BOX" else "crack_boxes_640"
    sites = read_sites(set_name)
    stem = f"{path.parent.name}/{path.stem}" if set_name.startswith("omu") else path.stem
    if stem not in sites:
        raise FacadelakeError(f"{path}: not in training/data/sites.yaml; add it to a site there")
    return Sample(
        path=path,
        boxes_px=boxes_px.reshape(-1, 4),
        classes=np.full(len(boxes_px), CRACK, dtype=np.int64),
        site=sites[stem].name,
        split=sites[stem].split,
    )
