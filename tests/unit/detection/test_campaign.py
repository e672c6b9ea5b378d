"""A detector run on a folder of photographs: the same table as an import; a bad file does not stop the run."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from facadelake.core.tables import get_stage_schema, table_from_rows
from facadelake.detection.campaign import OnnxDetector, SearchRegion, detect_photographs
from facadelake.detection.card import ModelCard
from tests.unit.detection.onnx_models import make_card, make_output, save_model

CRACK = (10, 30.0, 20.0, 12.0, 8.0, 0.75, 0)
CAR = (70, 60.0, 40.0, 20.0, 30.0, 0.5, 1)
OVERHANGING = (0, 5.0, 6.0, 16.0, 8.0, 0.4, 0)
IN_PADDING = (120, 60.0, 60.0, 10.0, 6.0, 0.3, 0)


def test_rows_of_a_campaign(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = tmp_path / "photographs"
    (root / "near").mkdir(parents=True)
    cv2.imwrite(str(root / "near" / "wide.jpg"), np.zeros((80, 192, 3), dtype=np.uint8))
    (root / "near" / "torn.jpg").write_bytes(b"\xff\xd8\xff torn")
    # The EXIF orientation is a rotation by 90 degrees: boxes are in the pixels as stored.
    exif = PillowImage.Exif()
    exif[0x0112] = 6
    PillowImage.new("RGB", (192, 80)).save(root / "near" / "turned.jpg", exif=exif)
    accepted = ("near/wide.jpg", "near/torn.jpg", "near/turned.jpg")
    outcomes = {**dict.fromkeys(accepted, "accepted"), "no.jpg": "unreadable"}
    photos = table_from_rows(
        "photos",
        [
            {
                "photo_id": photo_id, "sha256": photo_id, "bytes": 1, "photo_outcome": outcome,
                "prior_source": "none", "prior_height_datum": "unknown",
            }
            for photo_id, outcome in outcomes.items()
        ],
    )  # fmt: skip
    model = save_model(tmp_path / "fixed.onnx", make_output("yolov8", [CRACK, CAR, OVERHANGING, IN_PADDING]))
    detector = OnnxDetector(model, ModelCard.model_validate(make_card("yolov8")))
    with caplog.at_level(logging.WARNING):
        table = detect_photographs(photos, root, detector)
    assert "near/torn.jpg cannot be read" in caplog.text
    assert table.schema.equals(get_stage_schema("detections"))
    rows = table.to_pylist()
    assert [row["photo_id"] for row in rows] == ["near/wide.jpg"] * 4 + ["near/turned.jpg"] * 4
    assert len({row["detection_id"] for row in rows}) == 8
    for crack, car, overhanging, padding in (rows[:4], rows[4:]):
        assert (crack["detection_outcome"], crack["defect_class"], crack["reason"]) == ("accepted", "crack", None)
        assert crack["box_x_px"] == pytest.approx(48, rel=0, abs=0.01)  # px
        assert (car["detection_outcome"], car["defect_class"], car["source_class"]) == ("unknown_class", None, "car")
        assert "class 'car' is none of crack, spalling, moisture" in car["reason"]
        # 32 px from -6 to 26, clipped at the border.
        assert overhanging["detection_outcome"] == "accepted"
        assert [overhanging["box_x_px"], overhanging["box_width_px"]] == pytest.approx([0, 26], rel=0, abs=0.01)  # px
        assert "extends beyond the photograph (192 x 80 px) by 6.0 px" in overhanging["reason"]
        # The photograph ends at 40 px of the input's 64.
        assert padding["detection_outcome"] == "outside_image"
        assert (crack["detector"], crack["detector_sha256"]) == ("onnx:fixed", detector.sha256)
    named = detect_photographs(photos, root, detector, class_names={"car": "moisture"}).to_pylist()
    assert [row["defect_class"] for row in named[:2]] == ["crack", "moisture"]
    remarked = detect_photographs(
        photos, root, detector, find_region=lambda photo_id: SearchRegion(remark=f"{photo_id} has no pose")
    )
    assert remarked.column("reason").to_pylist()[0] == "near/wide.jpg has no pose"


def test_nothing_is_detected_outside_the_building(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "sky.jpg"), np.zeros((80, 192, 3), dtype=np.uint8))
    row = {"photo_id": "sky.jpg", "sha256": "0", "bytes": 1, "photo_outcome": "accepted"}
    photos = table_from_rows("photos", [{**row, "prior_source": "none", "prior_height_datum": "unknown"}])
    detector = OnnxDetector(
        save_model(tmp_path / "fixed.onnx", make_output("yolov8", [CRACK])), ModelCard(**make_card("yolov8"))
    )
    nowhere = SearchRegion(gsd_mm=1.0, target=np.zeros((8, 19), dtype=bool))
    assert len(detect_photographs(photos, tmp_path, detector)) == 1
    assert len(detect_photographs(photos, tmp_path, detector, find_region=lambda _: nowhere)) == 0


def test_no_accepted_photograph_gives_no_rows(tmp_path: Path) -> None:
    photos = table_from_rows(
        "photos",
        [
            {
                "photo_id": "no.jpg", "sha256": "no", "bytes": 1, "photo_outcome": "unreadable",
                "prior_source": "none", "prior_height_datum": "unknown",
            }
        ],
    )  # fmt: skip
    model = save_model(tmp_path / "fixed.onnx", make_output("yolov8", [CRACK]))
    assert (
        detect_photographs(
            photos, tmp_path, OnnxDetector(model, ModelCard.model_validate(make_card("yolov8")))
        ).num_rows
        == 0
    )
