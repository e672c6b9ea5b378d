"""Boxes of photographs that EXIF turns, against Pillow's own turning of the pixels."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image, ImageOps
from PIL.ExifTags import Base

from facadelake.core.errors import InputDataError
from facadelake.core.tables import table_from_rows
from facadelake.detection.coco.import_detections import import_coco
from facadelake.registry import ExifView

WIDTH, HEIGHT = 60, 40
TURNED = [2, 3, 4, 5, 6, 7, 8]


def make_photos(orientation: int | None, width: int = WIDTH, height: int = HEIGHT) -> pa.Table:
    row = {
        "photo_id": "a.JPG", "sha256": "0", "bytes": 1, "photo_outcome": "accepted", "image_width_px": width,
        "image_height_px": height, "exif_orientation": orientation, "prior_source": "none",
        "prior_height_datum": "unknown",
    }  # fmt: skip
    return table_from_rows("photos", [row])


def write(folder: Path, size: tuple[int, int] | None, *annotations: dict[str, Any]) -> Path:
    image = {"id": 1, "file_name": "a.JPG"} | ({} if size is None else {"width": size[0], "height": size[1]})
    content = {
        "images": [image],
        "categories": [{"id": 1, "name": "crack"}],
        "annotations": [{"id": i, "image_id": 1, "category_id": 1, **one} for i, one in enumerate(annotations)],
    }
    path = folder / "boxes.json"
    path.write_text(json.dumps(content))
    return path


def draw(folder: Path, orientation: int) -> tuple[np.ndarray, Image.Image]:
    """Stored pixels with one bright box, and the photograph as viewers show it."""
    stored = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    stored[5:9, 10:30] = 255
    image = Image.fromarray(stored)
    exif = Image.Exif()
    exif[Base.Orientation] = orientation
    image.save(folder / "a.png", exif=exif)
    with Image.open(folder / "a.png") as opened:
        return stored, ImageOps.exif_transpose(opened)


def bound(pixels: np.ndarray) -> list[int]:
    rows, columns = np.nonzero(pixels)
    return [int(v) for v in (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)]


def get_box(row: dict[str, Any]) -> list[float]:
    return [row[f"box_{side}_px"] for side in ("x", "y", "width", "height")]


@pytest.mark.parametrize("orientation", TURNED)
def test_boxes_and_masks_as_displayed_are_brought_to_the_pixels_as_stored(tmp_path: Path, orientation: int) -> None:
    stored, displayed = draw(tmp_path, orientation)
    x, y, width, height = bound(np.asarray(displayed))
    corner = [[x, y, x + width, y, x, y + height]]
    file = write(tmp_path, displayed.size, {"bbox": [x, y, width, height], "segmentation": corner})
    (row,) = import_coco(file, make_photos(orientation), class_names={}, exif_view=ExifView.DISPLAYED).to_pylist()
    assert get_box(row) == bound(stored)
    assert row["mask"] is not None and row["detection_outcome"] == "accepted"
    if orientation >= 5:  # the exchanged size alone tells
        (told,) = import_coco(file, make_photos(orientation), class_names={}).to_pylist()
        assert (get_box(told), told["mask"]) == (get_box(row), row["mask"])


@pytest.mark.parametrize("orientation", TURNED)
def test_boxes_as_stored_stay(tmp_path: Path, orientation: int) -> None:
    file = write(tmp_path, (WIDTH, HEIGHT), {"bbox": [10, 5, 20, 4]})
    photos = make_photos(orientation)
    (row,) = import_coco(file, photos, class_names={}, exif_view=ExifView.STORED).to_pylist()
    assert get_box(row) == [10, 5, 20, 4]
    if orientation >= 5:
        (row,) = import_coco(file, photos, class_names={}).to_pylist()
        assert (get_box(row), row["reason"]) == ([10, 5, 20, 4], None)


@pytest.mark.parametrize(
    ("orientation", "size", "stored"),
    [
        (3, (WIDTH, HEIGHT), (WIDTH, HEIGHT)),  # upside down: both views have one size
        (2, (WIDTH, HEIGHT), (WIDTH, HEIGHT)),
        (4, (WIDTH, HEIGHT), (WIDTH, HEIGHT)),
        (6, (50, 50), (50, 50)),
        (6, None, (WIDTH, HEIGHT)),
    ],
)
def test_a_size_that_does_not_tell_asks_for_the_key(
    tmp_path: Path, orientation: int, size: tuple[int, int] | None, stored: tuple[int, int]
) -> None:
    file = write(tmp_path, size, {"bbox": [10, 5, 20, 4]})
    with pytest.raises(InputDataError) as raised:  # the only photograph, so the file has nothing left
        import_coco(file, make_photos(orientation, *stored), class_names={})
    assert (
        f"EXIF turns the photograph (orientation {orientation}), and the size in the file does not tell whether boxes "
        "are of the pixels as stored or as displayed; set exif_view of the building's detector to stored or displayed"
    ) in str(raised.value)


def test_a_box_outside_the_stated_size_that_fits_as_displayed_puts_all_in_doubt(tmp_path: Path) -> None:
    """cases/coco/coco_exif.json: the size as stored, boxes as displayed."""
    file = write(tmp_path, (WIDTH, HEIGHT), {"bbox": [10, 5, 20, 4]}, {"bbox": [30, 45, 5, 10]})
    with pytest.raises(InputDataError) as raised:
        import_coco(file, make_photos(6), class_names={})
    assert (
        "EXIF turns the photograph (orientation 6), and annotation 1 on a.JPG leaves the 60 x 40 px that the file "
        "states, so sizes do not tell whether boxes are of the pixels as stored or as displayed; set exif_view of the "
        "building's detector to stored or displayed"
    ) in str(raised.value)
    rows = import_coco(file, make_photos(6), class_names={}, exif_view=ExifView.DISPLAYED).to_pylist()
    assert [row["detection_outcome"] for row in rows] == ["accepted", "accepted"]
    assert get_box(rows[1]) == [45, 5, 10, 5]  # 90 degrees clockwise as displayed: x = v, y = 40 - 30 - 5


def test_a_photograph_that_exif_does_not_turn_is_as_before(tmp_path: Path) -> None:
    for orientation in (None, 1):
        (row,) = import_coco(
            write(tmp_path, (WIDTH, HEIGHT), {"bbox": [1, 2, 3, 4]}), make_photos(orientation), class_names={}
        ).to_pylist()
        assert (get_box(row), row["reason"]) == ([1, 2, 3, 4], None)
