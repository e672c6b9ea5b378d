"""COCO boxes become rows, usable or not; a malformed file is refused with the reason."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import shapely

from facadelake.core.errors import InputDataError
from facadelake.core.hashing import hash_file
from facadelake.core.tables import table_from_rows
from facadelake.detection.coco.import_detections import import_coco

WIDTH, HEIGHT = 640, 480


def make_photos_table(*photo_ids: str, outcome: str = "accepted") -> pa.Table:
    return table_from_rows(
        "photos",
        [
            {
                "photo_id": photo_id,
                "sha256": photo_id,
                "bytes": 1,
                "photo_outcome": outcome,
                "image_width_px": WIDTH,
                "image_height_px": HEIGHT,
                "prior_source": "none",
                "prior_height_datum": "unknown",
            }
            for photo_id in photo_ids
        ],
    )


PHOTOS = make_photos_table("near/IMG_1.JPG", "near/IMG_2.JPG", "far/IMG_2.JPG")


def write_coco_file(
    folder: Path, *annotations: dict[str, Any], images: list[dict[str, Any]] | None = None, category: str = "crack"
) -> Path:
    path = folder / "boxes.json"
    content = {
        "images": images or [{"id": 1, "file_name": "near/IMG_1.JPG", "width": WIDTH, "height": HEIGHT}],
        "categories": [{"id": 1, "name": category}],
        "annotations": [{"id": i + 1, "image_id": 1, "category_id": 1, **a} for i, a in enumerate(annotations)],
    }
    path.write_text(json.dumps(content))
    return path


def import_rows(path: Path, photos: pa.Table = PHOTOS, **class_names: str) -> list[dict[str, Any]]:
    return list(import_coco(path, photos, class_names=class_names).to_pylist())


def test_a_valid_box_is_unchanged(tmp_path: Path) -> None:
    path = write_coco_file(tmp_path, {"bbox": [10.25, 20.5, 30, 40], "score": 0.75}, {"bbox": [1, 2, 3, 4]})
    first, second = import_rows(path)
    assert first == {
        "detection_id": "near/IMG_1.JPG#1",
        "photo_id": "near/IMG_1.JPG",
        "source_annotation": "1",
        "detection_outcome": "accepted",
        "reason": None,
        "defect_class": "crack",
        "source_class": "crack",
        "score": 0.75,
        "box_x_px": 10.25,
        "box_y_px": 20.5,
        "box_width_px": 30.0,
        "box_height_px": 40.0,
        "mask": None,
        **dict.fromkeys(name for name in first if name.startswith("crack_")),  # nothing is measured here
        "detector": "coco:boxes.json",
        "detector_sha256": hash_file(path),
    }
    assert second["score"] == 1.0  # drawn by a person


@pytest.mark.parametrize(
    ("bbox", "outcome", "kept", "reason"),
    [
        ([-5, -7, 20, 20], "accepted", (0, 0, 15, 13), "(640 x 480 px) by 7.0 px and was clipped"),
        ([630, 470, 20, 20], "accepted", (630, 470, 10, 10), "by 10.0 px"),
        ([-0.4, 0, 20, 480.6], "accepted", (0, 0, 19.6, 480), None),
        ([640, 10, 5, 5], "outside_image", (640, 10, 5, 5), "box at 640, 10 of 5 x 5 px lies outside the photograph"),
        ([10, 900, 5, 5], "outside_image", (10, 900, 5, 5), "lies outside the photograph"),
        ([639.5, 10, 5, 5], "outside_image", (639.5, 10, 5, 5), "has less than a pixel inside"),
        ([639.5, 10, 0.5, 5], "accepted", (639.5, 10, 0.5, 5), None),
        ([10, 10, 0, 5], "bad_box", (10, 10, 0, 5), "width and height must be more than 0 px"),
        ([10, 10, 5, -3], "bad_box", (10, 10, 5, -3), "at 10, 10 of 5 x -3 px"),
        ([10, float("nan"), 5, 3], "bad_box", None, "bbox is [10, nan, 5, 3]; its four values must be finite"),
        ([10, 10, float("inf"), 3], "bad_box", None, "finite numbers"),
        ([10, 10, "5", 3], "bad_box", None, "'5'"),
        ([10, 10, 5], "bad_box", None, "bbox is [10, 10, 5]; it must be [x, y, width, height]"),
        (3, "bad_box", None, "bbox is 3; it must be [x, y, width, height]"),
        (None, "bad_box", None, "bbox is None"),
    ],
)  # fmt: skip
def test_boxes_are_checked(
    tmp_path: Path, bbox: Any, outcome: str, kept: tuple[float, ...] | None, reason: str | None
) -> None:
    (row,) = import_rows(write_coco_file(tmp_path, {"bbox": bbox}))
    assert row["detection_outcome"] == outcome
    box = [row[f"box_{side}_px"] for side in ("x", "y", "width", "height")]
    assert box == ([None] * 4 if kept is None else pytest.approx(kept, rel=0, abs=1e-9))  # px
    assert (row["reason"] is None) if reason is None else (reason in row["reason"])


@pytest.mark.parametrize("score", [1.5, -0.1, "high", float("nan")])
def test_an_invalid_score_is_reported(tmp_path: Path, score: Any) -> None:
    (row,) = import_rows(write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4], "score": score}))
    assert row["detection_outcome"] == "bad_box"
    assert f"score is {score!r}; it must be a number from 0 to 1" in row["reason"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Crack", "crack"), ("ACrack", "crack"), ("spallation", "spalling"), ("ExposedRebars", "spalling"),
        ("exposed_bars", "spalling"), ("Efflorescence", "moisture"), ("Wetspot", "moisture"),
    ],
)  # fmt: skip
def test_other_taxonomies_are_translated(tmp_path: Path, name: str, expected: str) -> None:
    (row,) = import_rows(write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4]}, category=name))
    assert (row["detection_outcome"], row["defect_class"], row["source_class"]) == ("accepted", expected, name)


def test_an_unknown_class_is_a_row_and_a_building_may_name_it(tmp_path: Path) -> None:
    path = write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4]}, {"bbox": [1, 2, 3, 4], "category_id": 9}, category="Rust")
    rust, nothing = import_rows(path)
    assert (rust["detection_outcome"], rust["defect_class"]) == ("unknown_class", None)
    assert "class 'Rust' is none of crack, spalling, moisture" in rust["reason"]
    assert "category_id 9 is not among 'categories'" in nothing["reason"]
    assert nothing["source_class"] == "category 9"
    assert import_rows(path, rust="moisture")[0]["defect_class"] == "moisture"
    with pytest.raises(InputDataError, match="'Rust' is set to 'stain', which is not a defect class; use one of crack"):
        import_rows(path, Rust="stain")


@pytest.mark.parametrize(
    ("file_name", "photo_id"),
    [
        ("IMG_1.JPG", "near/IMG_1.JPG"),
        ("img_1.jpg", "near/IMG_1.JPG"),
        ("C:\\survey\\near\\IMG_1.JPG", "near/IMG_1.JPG"),
        ("/data/castle/far/IMG_2.JPG", "far/IMG_2.JPG"),
        ("./near/IMG_2.JPG", "near/IMG_2.JPG"),
    ],
)
def test_file_names_match_by_their_last_parts(tmp_path: Path, file_name: str, photo_id: str) -> None:
    (row,) = import_rows(write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4]}, images=[{"id": 1, "file_name": file_name}]))
    assert (row["photo_id"], row["detection_outcome"]) == (photo_id, "accepted")


@pytest.mark.parametrize(
    ("file_name", "reason"),
    [
        ("IMG_2.JPG", "'IMG_2.JPG' matches far/IMG_2.JPG, near/IMG_2.JPG; give its folder, too"),
        ("flight7/IMG_1.JPG", "'flight7/IMG_1.JPG' is not in the campaign; near/IMG_1.JPG is in another folder"),
        ("IMG_9.JPG", "'IMG_9.JPG' is not among the campaign's photographs"),
    ],
)
def test_a_name_without_photograph_is_a_row(tmp_path: Path, file_name: str, reason: str) -> None:
    images = [{"id": 1, "file_name": "near/IMG_1.JPG"}, {"id": 2, "file_name": file_name}]
    path = write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4]}, {"bbox": [1, 2, 3, 4], "image_id": 2}, images=images)
    good, lost = import_rows(path)
    assert good["detection_outcome"] == "accepted"
    assert (lost["detection_outcome"], lost["photo_id"], lost["reason"]) == ("unknown_photo", file_name, reason)


def test_annotations_of_an_unknown_image_and_of_another_size(tmp_path: Path) -> None:
    images = [
        {"id": 1, "file_name": "near/IMG_1.JPG"},
        {"id": 2, "file_name": "far/IMG_2.JPG", "width": HEIGHT, "height": WIDTH},
    ]
    box = {"bbox": [1, 2, 3, 4]}
    path = write_coco_file(
        tmp_path, box, {**box, "image_id": 7}, {**box, "image_id": 2}, {**box, "image_id": [2]}, images=images
    )
    good, lost, turned, odd = import_rows(path)
    assert good["detection_outcome"] == "accepted"
    assert (lost["photo_id"], lost["reason"]) == ("image 7", "image_id 7 is not among the file's 'images'")
    assert turned["detection_outcome"] == "bad_box"
    assert "the file states an image of 480 x 640 px, the photograph has 640 x 480 px" in turned["reason"]
    assert odd["detection_outcome"] == "unknown_photo"


@pytest.mark.parametrize(
    ("key", "one", "other"),
    [
        ("images", {"id": 1, "file_name": "near/IMG_1.JPG"}, {"id": 1, "file_name": "near/IMG_2.JPG"}),
        ("images", {"id": 1, "file_name": "near/IMG_1.JPG"}, {"id": 1.0, "file_name": "near/IMG_2.JPG"}),
        ("images", {"id": "1", "file_name": "near/IMG_1.JPG"}, {"id": 1, "file_name": "near/IMG_2.JPG"}),
        ("images", {"id": "1.0", "file_name": "near/IMG_1.JPG"}, {"id": "1", "file_name": "near/IMG_2.JPG"}),
        ("categories", {"id": 1, "name": "crack"}, {"id": 1, "name": "spalling"}),
        ("annotations", {"id": 5, "image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4]},
         {"id": 5, "image_id": 1, "category_id": 1, "bbox": [5, 6, 7, 8]}),
    ],
)  # fmt: skip
def test_an_id_used_for_two_things_is_refused_with_both(
    tmp_path: Path, key: str, one: dict[str, Any], other: dict[str, Any]
) -> None:
    """In a merged file the last entry would win, and a crack would land on another photograph."""
    path = write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4]})
    content = json.loads(path.read_text())
    content[key] = [one, other]
    path.write_text(json.dumps(content))
    with pytest.raises(InputDataError) as raised:
        import_rows(path)
    message = str(raised.value)
    assert f"{key}[0] and {key}[1] have the same id" in message
    assert json.dumps(one) in message and json.dumps(other) in message
    content[key] = [one, one]  # repeated unchanged, as files merged of one campaign have it
    path.write_text(json.dumps(content))
    assert len(import_rows(path)) == 1


@pytest.mark.parametrize("value", [5.2, True, None, [1], float("nan"), 1e300, "\ud800"])
def test_ids_are_whole_numbers_or_text(tmp_path: Path, value: Any) -> None:
    path = write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4]}, images=[{"id": value, "file_name": "near/IMG_1.JPG"}])
    with pytest.raises(InputDataError, match=r"images\[0\].id is .* every entry needs a whole number or text"):
        import_rows(path)


def test_whole_numbers_are_one_id_however_they_are_written(tmp_path: Path) -> None:
    """cases/coco/coco_float_ids.json: pandas writes ids as 1.0."""
    images = [{"id": 1.0, "file_name": "near/IMG_1.JPG"}, {"id": "2", "file_name": "near/IMG_2.JPG"}]
    box = {"bbox": [1, 2, 3, 4]}
    path = write_coco_file(
        tmp_path,
        {**box, "id": 7.0, "category_id": 1.0},
        {**box, "image_id": 2},
        {"bbox": [9, 2, 3, 4], "image_id": "1.0", "id": None},
        {**box, "image_id": True},
        {**box, "image_id": 1.5},
        {**box, "image_id": "01"},
        images=images,
    )
    rows = import_rows(path)
    assert [row["detection_id"] for row in rows] == [
        "near/IMG_1.JPG#7", "near/IMG_2.JPG#2", "near/IMG_1.JPG#row2",
        "image (True)#4", "image (1.5)#5", "image 01#6",
    ]  # fmt: skip
    assert [row["detection_outcome"] for row in rows] == ["accepted"] * 3 + ["unknown_photo"] * 3


def test_a_key_used_twice_is_refused(tmp_path: Path) -> None:
    path = write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4]})
    path.write_text(path.read_text()[:-1] + ', "annotations": []}')
    with pytest.raises(InputDataError, match="has the key 'annotations' twice in one object"):
        import_rows(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "cannot be read as JSON .*recursion"),
        ('{"images": ' + "1" * 5000 + "}", "cannot be read as JSON .*digits"),
        ("{", "is not JSON: Expecting property name enclosed in double quotes at line 1, column 2; export it again"),
        ("[]", "contains a list, not an object with images, annotations and categories"),
        ('{"images": [], "categories": []}', r"has no key 'annotations' \(it has \['categories', 'images'\]\)"),
        ('{"images": {}, "categories": [], "annotations": []}', "'images' must be a list of objects"),
        ('{"images": [{"id": 1}], "categories": [], "annotations": []}', r"images\[0\].file_name is None"),
        ('{"images": [{"file_name": "a"}], "categories": [], "annotations": []}', r"images\[0\].id is None"),
    ],
)
def test_a_file_that_is_not_coco_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "boxes.json"
    path.write_text(text)
    with pytest.raises(InputDataError, match=message) as raised:
        import_rows(path)
    assert str(path) in str(raised.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"nowhere.json does not exist; correct the path"):
        import_rows(tmp_path / "nowhere.json")


def test_a_file_without_accepted_boxes_is_refused(tmp_path: Path) -> None:
    box = {"bbox": [1, 2, 3, 4]}
    with pytest.raises(InputDataError, match="none of its 1 boxes is on an accepted photograph of the campaign's 3"):
        import_rows(write_coco_file(tmp_path, box, images=[{"id": 1, "file_name": "other.png"}]))
    with pytest.raises(InputDataError, match="the photograph was not accepted: unreadable"):
        import_rows(write_coco_file(tmp_path, box), make_photos_table("near/IMG_1.JPG", outcome="unreadable"))
    turned = [{"id": 1, "file_name": "near/IMG_1.JPG", "width": 10, "height": 10}]
    with pytest.raises(InputDataError, match="the file states an image of 10 x 10 px"):
        import_rows(write_coco_file(tmp_path, box, images=turned))
    with pytest.raises(InputDataError, match=r"all 2 boxes lie within 0..1, so they are normalised"):
        import_rows(write_coco_file(tmp_path, {"bbox": [0.1, 0.2, 0.3, 0.4]}, {"bbox": [0.5, 0.2, 0.3, 0.4]}))


ROTATED = {"bbox": [100, 100, 80, 4], "attributes": {"occluded": False, "rotation": 90.0}}


def test_a_box_that_cvat_turned_is_turned(tmp_path: Path) -> None:
    """cases/coco/coco_rotation.json: CVAT writes the box before its rotation, clockwise about its centre."""
    slanting = {"bbox": [100, 100, 80, 4], "attributes": {"rotation": 30.0}}
    upright, diagonal, whole, odd = import_rows(
        write_coco_file(
            tmp_path, ROTATED, slanting, ROTATED | {"attributes": {"rotation": 360.0}},
            ROTATED | {"attributes": {"rotation": "left"}},
        )
    )  # fmt: skip
    assert [upright[f"box_{side}_px"] for side in ("x", "y", "width", "height")] == pytest.approx(
        (138, 62, 4, 80), rel=0, abs=1e-9
    )  # px
    assert upright["mask"] is None
    # 30 degrees clockwise: the right end is lower, so y (downwards) grows with x; sides by hand.
    cos, sin = math.cos(math.radians(30)), math.sin(math.radians(30))
    width, height = 80 * cos + 4 * sin, 80 * sin + 4 * cos
    assert [diagonal[f"box_{side}_px"] for side in ("x", "y", "width", "height")] == pytest.approx(
        (140 - width / 2, 102 - height / 2, width, height), rel=0, abs=1e-9
    )  # px
    mask = shapely.from_wkt(diagonal["mask"])
    assert mask.area == pytest.approx(320, rel=0, abs=1)  # px2
    assert mask.contains(shapely.Point(140 + 39 * cos, 102 + 39 * sin))
    assert not mask.contains(shapely.Point(140 + 39 * cos, 102 - 39 * sin))
    assert whole["box_width_px"] == 80
    assert (odd["detection_outcome"], odd["reason"]) == ("bad_box", "rotation is 'left'; it must be degrees")


def test_a_mask_with_a_rotation_is_turned_with_its_box_unless_it_is_turned_already(tmp_path: Path) -> None:
    flat, tall = [[100, 100, 180, 100, 180, 104]], [[142, 62, 142, 142, 138, 142]]
    turned, already, neither = import_rows(
        write_coco_file(
            tmp_path, ROTATED | {"segmentation": flat}, ROTATED | {"segmentation": tall},
            ROTATED | {"segmentation": [[100, 100, 120, 100, 120, 104]]},
        )
    )  # fmt: skip
    # (180, 100), right top, is right bottom after 90 degrees clockwise: (142, 142).
    expected = shapely.Polygon([(142, 62), (142, 142), (138, 142)])
    for row in (turned, already):
        assert shapely.from_wkt(row["mask"]).symmetric_difference(expected).area < 0.1  # px2
    assert neither["detection_outcome"] == "bad_box"
    assert "its mask fits neither the box before nor after" in neither["reason"]


def test_a_box_without_size_beside_a_mask_has_the_masks_bounds(tmp_path: Path) -> None:
    """cases/coco/coco_bbox_zero_poly.json."""
    (row,) = import_rows(
        write_coco_file(tmp_path, {"bbox": [0, 0, 0, 0], "segmentation": [[100, 200, 400, 210, 400, 250, 100, 250]]})
    )
    assert [row[f"box_{side}_px"] for side in ("x", "y", "width", "height")] == [100, 200, 300, 50]
    assert row["reason"] == "its bbox [0, 0, 0, 0] has no size: the bounds of its mask are used"


def test_corners_are_told_by_their_areas(tmp_path: Path) -> None:
    corners = [{"bbox": [100, 100, 150, 130], "area": 1500}, {"bbox": [10, 20, 110, 30], "area": 1000}]
    with pytest.raises(InputDataError, match=r"seem to be \[x1, y1, x2, y2\]: the areas of all 2 boxes"):
        import_rows(write_coco_file(tmp_path, *corners))
    one, two = import_rows(write_coco_file(tmp_path, corners[0] | {"area": 19500}, corners[1] | {"area": 1000}))
    assert one["reason"] is None
    assert two["reason"] == "area is 1000, but its box is 110 x 30 px; the box is used"


def test_corners_are_told_by_boxes_that_leave_their_images_otherwise(tmp_path: Path) -> None:
    corners = [{"bbox": [500, 300, 600, 400]}, {"bbox": [400, 200, 500, 300]}, {"bbox": [1, 2, 30, 40]}]
    with pytest.raises(InputDataError, match="2 of 3 leave their images, and as corners none does"):
        import_rows(write_coco_file(tmp_path, *corners))
    assert len(import_rows(write_coco_file(tmp_path, *corners, {"bbox": [400, 300, 50, 50]}))) == 4


def test_a_crowd_is_told(tmp_path: Path) -> None:
    (row,) = import_rows(write_coco_file(tmp_path, {"bbox": [1, 2, 3, 4], "iscrowd": 1}))
    assert (row["detection_outcome"], row["reason"]) == ("accepted", "iscrowd is 1: taken as one defect")


def test_no_annotations_is_an_empty_table(tmp_path: Path) -> None:
    assert import_rows(write_coco_file(tmp_path)) == []
