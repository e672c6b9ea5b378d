"""Label files of a training set: COCO or YOLO. As in COCO, (0, 0) is the corner of the top left pixel."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from facadelake.reviews.review_items import coco_polygons_from_wkt
from facadelake.reviews.training.options import Split, TrainingLabelFormat
from facadelake.reviews.training.reviewed_photographs import TrainingBox
from schemas.vocabulary import DefectClass

CLASSES = tuple(DefectClass)


@dataclass(frozen=True, kw_only=True)
class TrainingPicture:
    """A picture of the set: its path ``name`` below ``images``, its photograph, and its defects (none: a negative).

    ``left_px``, ``top_px``: its top left corner in the photograph. ``defects`` are in pixels of the picture.
    """

    name: str
    split: Split
    building_id: str
    campaign_id: str
    photo_id: str
    left_px: int
    top_px: int
    width_px: int
    height_px: int
    defects: tuple[TrainingBox, ...]


def write_labels(label_format: TrainingLabelFormat, folder: Path, pictures: Sequence[TrainingPicture]) -> None:
    """Write the labels of all splits below ``folder``; a split without pictures has an empty file or folder."""
    for split in Split:
        pictures_of_split = [picture for picture in pictures if picture.split is split]
        (folder / "images" / split).mkdir(parents=True, exist_ok=True)
        if label_format is TrainingLabelFormat.COCO:
            path = folder / "annotations" / f"instances_{split}.json"
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(_build_coco(pictures_of_split)) + "\n", encoding="utf-8")
        else:
            (folder / "labels" / split).mkdir(parents=True, exist_ok=True)
            for picture in pictures_of_split:
                path = (folder / "labels" / picture.name).with_suffix(".txt")
                path.write_text("".join(_format_yolo_line(one, picture) for one in picture.defects), encoding="utf-8")
    if label_format is TrainingLabelFormat.YOLO:
        # Without a key 'path' trainers take the folders from this file's folder; '.' would be a folder of their own.
        folders: dict[str, Any] = {str(split): f"images/{split}" for split in Split}
        content = {**folders, "names": {i: str(name) for i, name in enumerate(CLASSES)}}
        (folder / "data.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _build_coco(pictures: Sequence[TrainingPicture]) -> dict[str, Any]:
    labelled = [(number, one) for number, picture in enumerate(pictures, start=1) for one in picture.defects]
    return {
        "images": [
            {
                "id": number,
                "file_name": picture.name,
                "width": picture.width_px,
                "height": picture.height_px,
                "site": picture.building_id,
                "campaign": picture.campaign_id,
                "photo_id": picture.photo_id,
                "left_px": picture.left_px,
                "top_px": picture.top_px,
            }
            for number, picture in enumerate(pictures, start=1)
        ],
        "categories": [{"id": i, "name": str(name)} for i, name in enumerate(CLASSES, start=1)],
        "annotations": [
            {
                "id": number,
                "image_id": image,
                "category_id": CLASSES.index(one.defect_class) + 1,
                "bbox": [round(v, 2) for v in (one.box.x_px, one.box.y_px, one.box.width_px, one.box.height_px)],
                "area": round(one.box.width_px * one.box.height_px if one.mask is None else one.mask.area, 2),
                "segmentation": [] if one.mask is None else coco_polygons_from_wkt(one.mask.wkt),
                "iscrowd": 0,
            }
            for number, (image, one) in enumerate(labelled, start=1)
        ],
    }


def _format_yolo_line(defect: TrainingBox, picture: TrainingPicture) -> str:
    box = defect.box
    centre = ((box.x_px + box.width_px / 2) / picture.width_px, (box.y_px + box.height_px / 2) / picture.height_px)
    size = (box.width_px / picture.width_px, box.height_px / picture.height_px)
    return f"{CLASSES.index(defect.defect_class)} {' '.join(f'{value:.7f}' for value in (*centre, *size))}\n"
