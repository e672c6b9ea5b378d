"""Bad detections and models, each with its message."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facadelake.core.errors import InputDataError, ModelError
from facadelake.core.tables import table_from_rows
from facadelake.detection.campaign import OnnxDetector
from facadelake.detection.card import ModelCard, OutputLayout
from facadelake.detection.coco.import_detections import import_coco
from facadelake.detection.inference.detector import load_detector
from facadelake.detection.layouts.readers import READERS
from tests.unit.detection.onnx_models import make_card, make_output, save_model

PHOTOS = table_from_rows(
    "photos",
    [
        {
            "photo_id": "near/IMG_1.JPG", "sha256": "0", "bytes": 1, "photo_outcome": "accepted",
            "image_width_px": 4000, "image_height_px": 3000, "prior_source": "none", "prior_height_datum": "unknown",
        }
    ],
)  # fmt: skip
GOOD = {"bbox": [100, 200, 30, 40], "category_id": 1}


def import_rows(folder: Path, *annotations: dict[str, Any], file_name: str = "IMG_1.JPG") -> list[dict[str, Any]]:
    content = {
        "images": [{"id": 1, "file_name": file_name, "width": 4000, "height": 3000}],
        "categories": [{"id": 1, "name": "Crack"}, {"id": 2, "name": "Graffiti"}],
        "annotations": [{"id": i, "image_id": 1, **a} for i, a in enumerate(annotations, start=1)],
    }
    path = folder / "boxes.json"
    path.write_text(json.dumps(content))
    return list(import_coco(path, PHOTOS, class_names={}).to_pylist())


@pytest.mark.parametrize(
    ("bad", "outcome", "reason"),
    [
        (
            {"bbox": [4100, 200, 30, 40], "category_id": 1},
            "outside_image",
            "box at 4100, 200 of 30 x 40 px lies outside the photograph (4000 x 3000 px)",
        ),
        (
            {"bbox": [100, 200, 30, 40], "category_id": 2},
            "unknown_class",
            "class 'Graffiti' is none of crack, spalling, moisture; if it means one of them, "
            "add it to 'classes' of the model card or of the building's detector "
            "(it is one of dacl10k's damages)",
        ),
        (
            {"bbox": [100, 200, -30, 40], "category_id": 1},
            "bad_box",
            "box at 100, 200 of -30 x 40 px: width and height must be more than 0 px",
        ),
        (
            {"bbox": [100, 200, 30, 40], "category_id": 1, "image_id": 5},
            "unknown_photo",
            "image_id 5 is not among the file's 'images'",
        ),
        (
            {
                "bbox": [100, 100, 80, 4],
                "category_id": 1,
                "attributes": {"rotation": 90.0},
                "segmentation": [[100, 100, 120, 100, 120, 104]],
            },
            "bad_box",
            "rotation is 90 degrees, and its mask fits neither the box before nor after; draw it as a polygon without "
            "rotation",
        ),
    ],
)
def test_a_bad_box_is_a_row_and_the_others_are_accepted(
    tmp_path: Path, bad: dict[str, Any], outcome: str, reason: str
) -> None:
    before, found, after = import_rows(tmp_path, GOOD, bad, GOOD | {"bbox": [400, 200, 30, 40]})
    assert (found["detection_outcome"], found["reason"]) == (outcome, reason)
    assert [row["detection_outcome"] for row in (before, after)] == ["accepted", "accepted"]


def test_a_truncated_coco_file(tmp_path: Path) -> None:
    import_rows(tmp_path, GOOD)
    path = tmp_path / "boxes.json"
    path.write_text(path.read_text()[:-20])
    with pytest.raises(InputDataError, match=r"boxes.json is not JSON: .* at line 1, column \d+; export it again"):
        import_coco(path, PHOTOS, class_names={})


def test_a_missing_coco_file(tmp_path: Path) -> None:
    path = tmp_path / "boxes.json"
    with pytest.raises(InputDataError) as raised:
        import_coco(path, PHOTOS, class_names={})
    assert str(raised.value) == (
        f"detections file {path} does not exist; correct the path in the portfolio, or put the file there"
    )


def test_a_coco_file_of_another_campaign(tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        import_rows(tmp_path, GOOD, GOOD, file_name="DJI_0815.JPG")
    assert str(raised.value) == (
        f"detections file {tmp_path / 'boxes.json'}: none of its 2 boxes is on an accepted photograph of the "
        "campaign's 1 (first: 'DJI_0815.JPG' is not among the campaign's photographs); "
        "give the detections of this campaign, with file_name ending as the photographs' paths do"
    )


def test_normalised_boxes_instead_of_pixels(tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        import_rows(tmp_path, {"bbox": [0.1, 0.2, 0.3, 0.4], "category_id": 1})
    assert str(raised.value) == (
        f"detections file {tmp_path / 'boxes.json'}: all 1 boxes lie within 0..1, so they are normalised; "
        "COCO boxes are [x, y, width, height] in pixels: export boxes in pixels"
    )


def test_corners_instead_of_width_and_height(tmp_path: Path) -> None:
    corners = ({"bbox": [100, 100, 150, 130], "area": 1500}, {"bbox": [10, 20, 110, 30], "area": 1000})
    with pytest.raises(InputDataError) as raised:
        import_rows(tmp_path, *(one | {"category_id": 1} for one in corners))
    assert str(raised.value) == (
        f"detections file {tmp_path / 'boxes.json'}: the boxes seem to be [x1, y1, x2, y2]: the areas of all 2 boxes "
        "that state one are those of corners, not width x height; COCO boxes are [x, y, width, height] in pixels: "
        "export them so"
    )


@pytest.mark.parametrize(
    ("name", "boxes"),
    [
        ("[x1, y1, x2, y2]", [[100, 120, 200, 180], [10, 20, 60, 50]]),
        ("[x of the centre, y of the centre, width, height]", [[150, 150, 100, 60], [35, 35, 50, 30]]),
        ("[y, x, height, width]", [[120, 100, 60, 100], [20, 10, 30, 50]]),
    ],
)
def test_boxes_that_bound_their_masks_in_another_convention_are_refused(
    tmp_path: Path, name: str, boxes: list[list[float]]
) -> None:
    """Boxes by their centres were taken as corners: all defects half their size off, the masks set aside."""
    masks = [[[100, 120, 200, 120, 200, 180, 100, 180]], [[10, 20, 60, 20, 60, 50, 10, 50]]]
    given = [{"bbox": box, "segmentation": mask, "category_id": 1} for box, mask in zip(boxes, masks, strict=True)]
    with pytest.raises(InputDataError) as raised:
        import_rows(tmp_path, *given)
    assert str(raised.value) == (
        f"detections file {tmp_path / 'boxes.json'}: the boxes seem to be {name}: so, and not as [x, y, width, "
        "height], all 2 that have a mask of polygons bound it; COCO boxes are [x, y, width, height] in pixels: "
        "export them so"
    )
    given[0]["bbox"] = [100, 120, 100, 60]  # one of them bounds its mask: no convention of the file
    assert [row["detection_outcome"] for row in import_rows(tmp_path, *given)] == ["accepted", "accepted"]


def test_a_box_that_is_in_the_file_twice_under_two_ids_counts_once(tmp_path: Path) -> None:
    """A file merged with a copy of itself doubled all defects of the demo: 78 for 39, without a word."""
    falling, rising = [[100, 100, 110, 100, 200, 180, 190, 180]], [[190, 100, 200, 100, 110, 180, 100, 180]]
    given = [
        {"bbox": [10, 20, 50, 30], "category_id": 1, "score": 0.5},
        {"bbox": [11, 20, 50, 30], "category_id": 1, "score": 0.9},  # by another person
        {"bbox": [40, 20, 50, 30], "category_id": 1},  # beside
        {"bbox": [100, 100, 100, 80], "category_id": 1, "segmentation": falling},
        {"bbox": [100, 100, 100, 80], "category_id": 1, "segmentation": rising},  # crossing cracks
        {"bbox": [100, 100, 100, 80], "category_id": 1, "segmentation": falling},
    ]
    rows = import_rows(tmp_path, *given)
    assert [row["detection_outcome"] == "accepted" for row in rows] == [False, True, True, True, True, False]
    used = [rows[1]["source_annotation"], rows[3]["source_annotation"]]
    assert [rows[0]["reason"], rows[5]["reason"]] == [f"the same as annotation {one}, which is used" for one in used]


def test_masks_in_shares_of_the_photograph_without_boxes(tmp_path: Path) -> None:
    """A mask in shares gave a box of a fraction of a pixel at the upper left corner."""
    share = {"bbox": [], "segmentation": [[0.1, 0.1, 0.2, 0.1, 0.2, 0.3, 0.1, 0.3]], "category_id": 1}
    with pytest.raises(InputDataError, match=r"all 1 boxes lie within 0\.\.1, so they are normalised"):
        import_rows(tmp_path, share)
    row, other = import_rows(tmp_path, share, {"bbox": [100, 120, 50, 40], "category_id": 1})
    assert (row["detection_outcome"], other["detection_outcome"]) == ("bad_box", "accepted")
    assert row["reason"] == (
        "box at 0.1, 0.1 of 0.1 x 0.2 px is smaller than a pixel: in shares of the photograph? give pixels"
    )


@pytest.mark.parametrize(
    ("written", "instead", "message"),
    [
        (
            '"images": [{"id": 1, "file_name": "near/IMG_1.JPG"}',
            '"images": [{"id": 1, "file_name": "near/IMG_1.JPG"}, {"id": 1, "file_name": "near/IMG_2.JPG"}',
            ': images[0] and images[1] have the same id 1: {"id": 1, "file_name": "near/IMG_1.JPG"} and '
            '{"id": 1, "file_name": "near/IMG_2.JPG"}; number them anew (files were merged?)',
        ),
        (
            '"annotations": [',
            '"annotations": [], "annotations": [',
            " has the key 'annotations' twice in one object, so that one of its values would be lost; "
            "merge the files with a tool that reads COCO",
        ),
        (
            '{"id": 1, "file_name"',
            '{"id": 5.2, "file_name"',
            ": images[0].id is 5.2; every entry needs a whole number or text",
        ),
    ],
    ids=["an id for two images", "a key twice", "an id that is no whole number"],
)
def test_ids_and_keys_that_name_two_things_or_none(tmp_path: Path, written: str, instead: str, message: str) -> None:
    content = {
        "images": [{"id": 1, "file_name": "near/IMG_1.JPG"}],
        "categories": [{"id": 1, "name": "crack"}],
        "annotations": [GOOD | {"id": 1, "image_id": 1}],
    }
    path = tmp_path / "boxes.json"
    text = json.dumps(content)
    assert written in text
    path.write_text(text.replace(written, instead))
    with pytest.raises(InputDataError) as raised:
        import_coco(path, PHOTOS, class_names={})
    assert str(raised.value) == f"detections file {path}{message}"


def test_a_model_without_a_card_and_a_card_without_a_model(tmp_path: Path) -> None:
    model = save_model(tmp_path / "crack.onnx", np.zeros((1, 126, 7)))
    with pytest.raises(ModelError) as raised:
        load_detector(model, None)
    assert str(raised.value).startswith(
        f"model card {tmp_path / 'crack.card.yaml'} does not exist; every detector needs one beside it, or in its "
        "metadata under facadelake.card (docs/model-card.md shows one). A draft from a probe image (class names are "
        "unknown), layout yolox. Check it and save it as crack.card.yaml:\n\nname: crack\n"
    )
    with pytest.raises(ModelError) as raised:
        OnnxDetector(tmp_path / "crak.onnx", ModelCard.model_validate(make_card("yolox")))
    assert str(raised.value) == (
        f"model {tmp_path / 'crak.onnx'} does not exist; correct the detector's path in the portfolio"
    )


def test_a_model_with_wrong_outputs(tmp_path: Path) -> None:
    model = save_model(tmp_path / "crack.onnx", make_output("yolov8", [(10, 30.0, 20.0, 12.0, 8.0, 0.75, 0)]))
    declared = ModelCard.model_validate(make_card("yolox"))
    with pytest.raises(ModelError) as raised:
        OnnxDetector(model, declared)
    assert str(raised.value) == (
        f"model {model}: its output has shape (1, 6, 126), layout yolox with 2 classes at 96 x 64 px has (1, 126, 7); "
        "shape and values fit layout yolov8; correct output.layout or class_names in the card, or export the model "
        "again"
    )


def test_a_model_with_one_class_more_than_its_card(tmp_path: Path) -> None:
    model = save_model(tmp_path / "crack.onnx", np.zeros((1, 126, 8)))
    with pytest.raises(
        ModelError, match=r"shape \(1, 126, 8\), layout yolox with 2 .* has \(1, 126, 7\); with 3 class_names"
    ):
        OnnxDetector(model, ModelCard.model_validate(make_card("yolox")))


CLASS_FIRST = np.array([[[10, 10, 30, 20, 0, 0.9], [40, 30, 60, 50, 1, 0.8], [0, 0, 0, 0, 0, 0]]], dtype=np.float64)


@pytest.mark.parametrize("classes", [["crack", "spalling"], ["crack"]])
def test_rows_of_box_class_score_are_not_read_as_box_score_class(tmp_path: Path, classes: list[str]) -> None:
    """cases/onnx/cls_first.onnx: every score was 0 or 1, and every class 0."""
    rows = CLASS_FIRST if len(classes) > 1 else CLASS_FIRST[:, :1]
    model = save_model(tmp_path / "crack.onnx", rows)
    with pytest.raises(ModelError) as raised:
        OnnxDetector(model, ModelCard.model_validate(make_card("nms6", class_names=classes)))
    count = len(rows[0]) - (len(rows[0]) > 1)
    assert str(raised.value) == (
        f"model {model}: class column has {count} values that are not whole numbers, such as 0.9: its rows seem to be "
        "box, class, score; export it with rows of box, score, class; correct output.layout or class_names in the "
        "card, or export the model again"
    )


def test_rows_of_box_class_score_that_a_probe_image_does_not_show_are_refused_with_the_first_box() -> None:
    reader = READERS[OutputLayout.NMS6]
    card = ModelCard.model_validate(make_card("nms6"))
    with pytest.raises(ModelError, match="class column has 2 values that are not whole numbers"):
        reader.read_candidates([CLASS_FIRST[0].astype(np.float32)], card, 0.25)


@pytest.mark.parametrize(("task", "kind"), [("obb", "oriented boxes"), ("pose", "poses")])
def test_exports_of_another_task_are_named(tmp_path: Path, task: str, kind: str) -> None:
    """cases/onnx/obb_wide.onnx: the angle was taken for a class more."""
    three = np.concatenate([make_output("yolov8", []), np.full((1, 1, 126), 0.5)], axis=1)
    model = save_model(tmp_path / "crack.onnx", three, metadata={"task": task})
    for card in (None, ModelCard.model_validate(make_card("yolov8", class_names=["a", "b", "c"]))):
        with pytest.raises(ModelError) as raised:
            load_detector(model) if card is None else OnnxDetector(model, card)
        assert str(raised.value) == (
            f"model {model} is an export of {kind} (its metadata state the task '{task}'), which no layout reads; "
            "export a model of the task 'detect' or 'segment'"
        )


def test_one_number_more_than_classes_may_be_an_angle(tmp_path: Path) -> None:
    three = np.concatenate([make_output("yolov8", []), np.full((1, 1, 126), 0.5)], axis=1)
    model = save_model(tmp_path / "crack.onnx", three)
    with pytest.raises(ModelError) as raised:
        OnnxDetector(model, ModelCard.model_validate(make_card("yolov8")))
    assert str(raised.value) == (
        f"model {model}: its output has shape (1, 7, 126), layout yolov8 with 2 classes at 96 x 64 px has (1, 6, N); "
        "with 3 class_names its shape fits; or it is an export of oriented boxes (one number more: the angle), which "
        "no layout reads; correct output.layout or class_names in the card, or export the model again"
    )
