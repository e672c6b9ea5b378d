"""COCO files that state no size of their images: told, and boxes of another copy of a photograph are not taken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from facadelake.core.errors import InputDataError
from facadelake.core.tables import table_from_rows
from facadelake.detection.coco.import_detections import import_coco

WIDTH, HEIGHT = 4000, 3000
REMEDY = "state width and height of each entry of 'images', or export boxes of the original photographs"


def make_photos(count: int) -> pa.Table:
    return table_from_rows(
        "photos",
        [
            {
                "photo_id": f"{k}.jpg", "sha256": "0", "bytes": 1, "photo_outcome": "accepted", "prior_source": "none",
                "image_width_px": WIDTH, "image_height_px": HEIGHT, "prior_height_datum": "unknown",
            }
            for k in range(count)
        ],
    )  # fmt: skip


def import_boxes(
    folder: Path, boxes: dict[int, list[list[float]]], size: dict[str, int] | None = None
) -> list[dict[str, Any]]:
    """Rows of table `detections` of boxes by photograph, in a file that states this size of its images."""
    annotations = [(k, box) for k, of_photo in boxes.items() for box in of_photo]
    content = {
        "images": [{"id": k, "file_name": f"{k}.jpg", **(size or {})} for k in boxes],
        "categories": [{"id": 1, "name": "crack"}],
        "annotations": [
            {"id": i, "image_id": k, "category_id": 1, "bbox": box} for i, (k, box) in enumerate(annotations)
        ],
    }
    file = folder / "boxes.json"
    file.write_text(json.dumps(content))
    return import_coco(file, make_photos(len(boxes)), class_names={}).to_pylist()


def test_a_size_that_is_not_stated_is_told(tmp_path: Path) -> None:
    (row,) = import_boxes(tmp_path, {0: [[100, 200, 30, 40]]})
    assert (row["detection_outcome"], row["reason"]) == (
        "accepted",
        "the file states no size of its image; taken as 4000 x 3000 px",
    )
    (row,) = import_boxes(tmp_path, {0: [[100, 200, 30, 40]]}, {"width": WIDTH, "height": HEIGHT})
    assert (row["detection_outcome"], row["reason"]) == ("accepted", None)


@pytest.mark.parametrize(
    ("box", "kind"),
    [([4100, 200, 200, 40], "resized"), ([2000, 3500, 100, 200], "turned"), ([7000, 5000, 9, 9], "resized")],
)
def test_boxes_beyond_the_photograph_put_its_others_in_doubt(box: list[float], kind: str, tmp_path: Path) -> None:
    rows = import_boxes(tmp_path, {0: [[100, 200, 30, 40], box], 1: [[100, 200, 30, 40]]})
    assert [row["detection_outcome"] for row in rows] == ["bad_box", "bad_box", "accepted"]
    assert rows[0]["reason"] == (
        f"annotation 1 on 0.jpg ends at {box[0] + box[2]}, {box[1] + box[3]}, outside the photograph (4000 x 3000 px), "
        f"and the file states no size of the image: boxes of a {kind} photograph? {REMEDY}"
    )


def test_a_box_that_overhangs_the_border_a_little_is_clipped(tmp_path: Path) -> None:
    (row,) = import_boxes(tmp_path, {0: [[3900, 200, 120, 40]]})
    assert (row["detection_outcome"], row["box_width_px"]) == ("accepted", 100.0)


def test_boxes_of_smaller_copies_are_refused(tmp_path: Path) -> None:
    """Boxes of copies of 1600 x 1200 px: all in the upper left, on other parts of the wall."""
    copies = {k: [[150.0 * j, 120.0 * j, 90, 80] for j in range(1, 4)] for k in range(4)}
    with pytest.raises(InputDataError) as raised:
        import_boxes(tmp_path, copies)
    assert (
        "it states no size of its images, and all 12 boxes on them end within 15% of the width and height of their "
        f"photographs, at the upper left: boxes of resized photographs? {REMEDY}"
    ) in str(raised.value)
    rows = import_boxes(tmp_path, copies, {"width": WIDTH, "height": HEIGHT})  # possible, so used; never in silence
    assert {(row["detection_outcome"], row["reason"]) for row in rows} == {
        (
            "accepted",
            "all 12 boxes of the file end within 15% of the width and height of their photographs, at the upper left: "
            "boxes of resized photographs, whose size the file does not state?",
        )
    }
