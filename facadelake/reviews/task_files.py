"""Files of a review task: the detections as COCO for CVAT or Label Studio, the defects as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import shapely

from facadelake.core.errors import InputDataError, StoreError
from facadelake.detection import Box
from facadelake.reviews.review import box_from_row
from facadelake.reviews.review_items import ReviewItem, coco_polygons_from_wkt
from schemas.vocabulary import DefectClass, Verdict

COCO_FILE, CSV_FILE, PHOTOGRAPHS_FILE = "detections.coco.json", "defects.csv", "photographs.txt"
INFO_KEY = "facadelake"  # key under a COCO file's "info" of the task's own metadata
COLUMNS = (
    "campaign_id", "run_id", "defect_id", "detection_id", "defect_class", "severity", "facade", "storey",
    "element_name", "photo_count", "score", "photo_id", "box_x_px", "box_y_px", "box_width_px", "box_height_px",
    "current_verdict", "verdict", "corrected_class", "note",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ReviewTask:
    """A review task: the run whose results are reviewed, the photographs, and the items on them."""

    building_id: str
    campaign_id: str
    run_id: str
    photographs: tuple[str, ...]
    items: tuple[ReviewItem, ...]


def build_coco_task(task: ReviewTask, sizes: Mapping[str, tuple[int, int]], *, photographs_uri: str) -> dict[str, Any]:
    """The task as the content of a COCO file; file names are the photo_ids.

    The item of an annotation is described in its ``attributes``. CVAT and Label Studio may drop these; the import does
    not need them. ``sizes``: (width, height) in px by photo_id.
    """
    images = {photo_id: number for number, photo_id in enumerate(task.photographs, start=1)}
    categories = {defect_class: number for number, defect_class in enumerate(DefectClass, start=1)}
    return {
        "info": {
            "description": f"{task.building_id} {task.campaign_id}: correct the boxes, delete those without a defect, "
            "add missed defects",
            INFO_KEY: {
                "building_id": task.building_id,
                "campaign_id": task.campaign_id,
                "run_id": task.run_id,
                "photographs": photographs_uri,
            },
        },
        "images": [
            {"id": number, "file_name": photo_id, "width": sizes[photo_id][0], "height": sizes[photo_id][1]}
            for photo_id, number in images.items()
        ],
        "categories": [{"id": number, "name": str(name)} for name, number in categories.items()],
        "annotations": [
            {
                "id": number,
                "image_id": images[item.photo_id],
                "category_id": categories[item.defect_class],
                "bbox": _bbox_from_box(item.box),
                "area": round(item.box.width_px * item.box.height_px, 2),
                "iscrowd": 0,
                "segmentation": coco_polygons_from_wkt(item.mask),
                "score": round(item.score, 4),
                "attributes": {
                    "subject": item.subject,
                    "detection_id": item.detection_id,
                    "defect_id": item.defect_id,
                    "detector_sha256": item.detector_sha256,
                    "reviewed_box": None if item.reviewed_box is None else _bbox_from_box(item.reviewed_box),
                    "reviewed_class": item.reviewed_class,
                    "verdict": item.verdict,
                },
            }
            for number, item in enumerate(task.items, start=1)
        ],
    }


def read_task(path: Path) -> ReviewTask:
    """Read the COCO file of an exported task. Raises InputDataError for another file."""
    content = read_json(path)
    try:
        info = content["info"][INFO_KEY]
        names = {image["id"]: image["file_name"] for image in content["images"]}
        classes = {category["id"]: DefectClass(category["name"]) for category in content["categories"]}
        return ReviewTask(
            building_id=info["building_id"],
            campaign_id=info["campaign_id"],
            run_id=info["run_id"],
            photographs=tuple(names.values()),
            items=tuple(
                _item_from_annotation(entry, names[entry["image_id"]], classes[entry["category_id"]])
                for entry in content["annotations"]
            ),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputDataError(
            f"{path} is not a task of 'facadelake review export-task' (missing or wrong: {error}); give the file "
            f"{COCO_FILE} as it was exported, not the corrected one"
        ) from error


def read_json(path: Path) -> Any:
    """Read a JSON file. Raises InputDataError where it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputDataError(f"{path} cannot be read as JSON: {error}; correct the path or export it again") from error


def format_defects_csv(
    task: ReviewTask, defects: Sequence[Mapping[str, Any]], items_by_defect: Mapping[str, Sequence[ReviewItem]]
) -> str:
    """One line for each defect with an item; the reviewer fills in ``verdict`` (confirmed, rejected or corrected).

    ``defects``: rows of that table. ``items_by_defect``: the task's items of each; the one in the best photograph is
    written.
    """
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for row in defects:
        items = items_by_defect.get(row["defect_id"], ())
        best = next((item for item in items if item.photo_id == row["best_photo_id"]), items[0] if items else None)
        if best is None:
            continue
        verdicts = sorted({str(item.verdict) for item in items if item.verdict is not None})
        cells = {name: row.get(name) for name in COLUMNS}
        cells |= {"run_id": task.run_id, "campaign_id": task.campaign_id, "photo_id": best.photo_id}
        cells |= {"score": f"{row['score']:.3f}", "detection_id": "", "current_verdict": ", ".join(verdicts)}
        cells |= dict(zip(COLUMNS[12:16], _bbox_from_box(best.box), strict=True))
        writer.writerow(cells)
    return out.getvalue()


def write_task(
    folder: Path, content: Mapping[str, Any], table: str, photographs: Sequence[Path]
) -> tuple[Path, Path, Path]:
    """Write the task's three files.

    Args:
        folder: Folder to write to; made where it does not exist.
        content: Content of the COCO file.
        table: Text of the CSV file.
        photographs: Paths of the photographs, for the list.

    Returns:
        Paths of the COCO file, the CSV file and the list.

    Raises:
        InputDataError: The folder holds a task already.
        StoreError: The files cannot be written.
    """
    paths = (folder / COCO_FILE, folder / CSV_FILE, folder / PHOTOGRAPHS_FILE)
    existing = [path.name for path in paths if path.exists()]
    if existing:
        raise InputDataError(
            f"{folder} holds a task already ({', '.join(existing)}), which may have been edited; give another folder, "
            "or remove it"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths[0].write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        paths[1].write_text(table, encoding="utf-8-sig")  # spreadsheets recognise UTF-8 by the byte order mark
        paths[2].write_text("".join(f"{path}\n" for path in photographs), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"the task cannot be written to {folder}: {error}; give a writable folder") from error
    return paths


# Attributes of task files that were written before schema version 2; a reviewer may still have such a file.
_EARLIER_NAMES = {"judged_box": "reviewed_box", "judged_class": "reviewed_class", "last_word": "verdict"}


def _bbox_from_box(box: Box) -> list[float]:
    return [round(value, 2) for value in (box.x_px, box.y_px, box.width_px, box.height_px)]


def _item_from_annotation(entry: Mapping[str, Any], photo_id: str, defect_class: DefectClass) -> ReviewItem:
    attributes = {_EARLIER_NAMES.get(name, name): value for name, value in entry["attributes"].items()}
    sides = ("x_px", "y_px", "width_px", "height_px")
    reviewed = attributes["reviewed_box"]
    box = box_from_row({f"box_{side}": value for side, value in zip(sides, entry["bbox"], strict=True)})
    if box is None:
        raise ValueError("bbox")
    rings = entry["segmentation"]
    return ReviewItem(
        subject=attributes["subject"],
        photo_id=photo_id,
        defect_class=defect_class,
        box=box,
        mask=_wkt_from_rings(rings) if rings else None,
        score=entry["score"],
        detection_id=attributes["detection_id"],
        defect_id=attributes["defect_id"],
        detector_sha256=attributes["detector_sha256"],
        reviewed_box=None if reviewed is None else Box(**dict(zip(sides, reviewed, strict=True))),
        reviewed_class=None if attributes["reviewed_class"] is None else DefectClass(attributes["reviewed_class"]),
        verdict=None if attributes["verdict"] is None else Verdict(attributes["verdict"]),
    )


def _wkt_from_rings(rings: Sequence[Sequence[float]]) -> str:
    parts = [shapely.Polygon(list(zip(ring[::2], ring[1::2], strict=True))) for ring in rings]
    return str(shapely.to_wkt(parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts), rounding_precision=2))
