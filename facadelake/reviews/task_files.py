"""A task for reviewers: a campaign's detections as COCO for CVAT or Label Studio, and its defects as CSV."""

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
from facadelake.reviews.review_items import ReviewItem, polygons_from_wkt
from schemas.vocabulary import DefectClass, Verdict

COCO_FILE, CSV_FILE, PHOTOGRAPHS_FILE = "detections.coco.json", "defects.csv", "photographs.txt"
INFO_KEY = "facadelake"  # key of a COCO file's info that holds what we need of it
COLUMNS = (
    "campaign_id", "run_id", "defect_id", "detection_id", "defect_class", "severity", "facade", "storey",
    "element_name", "photo_count", "score", "photo_id", "box_x_px", "box_y_px", "box_width_px", "box_height_px",
    "last_word", "verdict", "corrected_class", "note",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ReviewTask:
    """What was shown, as the task's COCO file tells: of which run, on which photographs, which places."""

    building_id: str
    campaign_id: str
    run_id: str
    photographs: tuple[str, ...]
    items: tuple[ReviewItem, ...]


def build_coco_task(task: ReviewTask, sizes: Mapping[str, tuple[int, int]], *, photographs_uri: str) -> dict[str, Any]:
    """The task as COCO: ``sizes`` are (width, height) in px by photo_id; file names are the photo_ids.

    What an annotation is about stands in its ``attributes``, which CVAT and Label Studio may drop: the way back does
    not need them.
    """
    images = {photo_id: number for number, photo_id in enumerate(task.photographs, start=1)}
    categories = {defect_class: number for number, defect_class in enumerate(DefectClass, start=1)}
    return {
        "info": {
            "description": f"{task.building_id} {task.campaign_id}: correct the boxes, delete what is no defect, add "
            "what was missed",
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
                "image_id": images[place.photo_id],
                "category_id": categories[place.defect_class],
                "bbox": _bbox_from_box(place.box),
                "area": round(place.box.width_px * place.box.height_px, 2),
                "iscrowd": 0,
                "segmentation": polygons_from_wkt(place.mask),
                "score": round(place.score, 4),
                "attributes": {
                    "subject": place.subject,
                    "detection_id": place.detection_id,
                    "defect_id": place.defect_id,
                    "detector_sha256": place.detector_sha256,
                    "reviewed_box": None if place.reviewed_box is None else _bbox_from_box(place.reviewed_box),
                    "reviewed_class": place.reviewed_class,
                    "verdict": place.verdict,
                },
            }
            for number, place in enumerate(task.items, start=1)
        ],
    }


def read_task(path: Path) -> ReviewTask:
    """The task that ``build_coco_task`` wrote. Raises InputDataError for another file."""
    content = read_json(path)
    try:
        ours = content["info"][INFO_KEY]
        names = {image["id"]: image["file_name"] for image in content["images"]}
        classes = {category["id"]: DefectClass(category["name"]) for category in content["categories"]}
        return ReviewTask(
            building_id=ours["building_id"],
            campaign_id=ours["campaign_id"],
            run_id=ours["run_id"],
            photographs=tuple(names.values()),
            items=tuple(
                _item_from_annotation(entry, names[entry["image_id"]], classes[entry["category_id"]])
                for entry in content["annotations"]
            ),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputDataError(
            f"{path} is not a task of 'facadelake review export-task' (it lacks or misstates {error}); name the file "
            f"{COCO_FILE} as it was exported, not the one that was corrected"
        ) from error


def read_json(path: Path) -> Any:
    """A JSON file's content. Raises InputDataError where there is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputDataError(f"{path} cannot be read as JSON: {error}; correct the path or export it again") from error


def format_defects_csv(
    task: ReviewTask, defects: Sequence[Mapping[str, Any]], sightings: Mapping[str, Sequence[ReviewItem]]
) -> str:
    """One line for each defect, to fill in: ``verdict`` confirmed, rejected or corrected, left empty where not looked.

    ``defects`` are rows of that table; ``sightings`` the shown places of each, of which the best photograph's is named.
    """
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for row in defects:
        places = sightings.get(row["defect_id"], ())
        best = next(
            (place for place in places if place.photo_id == row["best_photo_id"]), places[0] if places else None
        )
        if best is None:
            continue
        words = sorted({str(place.verdict) for place in places if place.verdict is not None})
        cells = {name: row.get(name) for name in COLUMNS}
        cells |= {"run_id": task.run_id, "campaign_id": task.campaign_id, "photo_id": best.photo_id}
        cells |= {"score": f"{row['score']:.3f}", "detection_id": "", "last_word": ", ".join(words)}
        cells |= dict(zip(COLUMNS[12:16], _bbox_from_box(best.box), strict=True))
        writer.writerow(cells)
    return out.getvalue()


def write_task(
    folder: Path, content: Mapping[str, Any], table: str, photographs: Sequence[Path]
) -> tuple[Path, Path, Path]:
    """The task's three files in ``folder``. Raises InputDataError where there is another task, StoreError where the
    disk fails."""
    paths = (folder / COCO_FILE, folder / CSV_FILE, folder / PHOTOGRAPHS_FILE)
    there = [path.name for path in paths if path.exists()]
    if there:
        raise InputDataError(
            f"{folder} holds a task already ({', '.join(there)}), which may have been worked on; give another folder, "
            "or remove it"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths[0].write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        paths[1].write_text(table, encoding="utf-8-sig")  # spreadsheets take it for UTF-8 by its mark
        paths[2].write_text("".join(f"{path}\n" for path in photographs), encoding="utf-8")
    except OSError as error:
        raise StoreError(f"the task cannot be written to {folder}: {error}; give a folder you may write to") from error
    return paths


# Attributes of task files that were written before schema version 2 and may still be with a reviewer.
_EARLIER_NAMES = {"judged_box": "reviewed_box", "judged_class": "reviewed_class", "last_word": "verdict"}


def _bbox_from_box(box: Box) -> list[float]:
    return [round(value, 2) for value in (box.x_px, box.y_px, box.width_px, box.height_px)]


def _item_from_annotation(entry: Mapping[str, Any], photo_id: str, defect_class: DefectClass) -> ReviewItem:
    about = {_EARLIER_NAMES.get(name, name): value for name, value in entry["attributes"].items()}
    sides = ("x_px", "y_px", "width_px", "height_px")
    judged = about["reviewed_box"]
    box = box_from_row({f"box_{side}": value for side, value in zip(sides, entry["bbox"], strict=True)})
    if box is None:
        raise ValueError("bbox")
    rings = entry["segmentation"]
    return ReviewItem(
        subject=about["subject"],
        photo_id=photo_id,
        defect_class=defect_class,
        box=box,
        mask=_wkt_from_rings(rings) if rings else None,
        score=entry["score"],
        detection_id=about["detection_id"],
        defect_id=about["defect_id"],
        detector_sha256=about["detector_sha256"],
        reviewed_box=None if judged is None else Box(**dict(zip(sides, judged, strict=True))),
        reviewed_class=None if about["reviewed_class"] is None else DefectClass(about["reviewed_class"]),
        verdict=None if about["verdict"] is None else Verdict(about["verdict"]),
    )


def _wkt_from_rings(rings: Sequence[Sequence[float]]) -> str:
    parts = [shapely.Polygon(list(zip(ring[::2], ring[1::2], strict=True))) for ring in rings]
    return str(shapely.to_wkt(parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts), rounding_precision=2))
