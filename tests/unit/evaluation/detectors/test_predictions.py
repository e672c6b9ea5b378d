"""A model run once gives what it would give at either threshold; files of detections and strange boxes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from facadelake.detection.crosswalk import build_crosswalk
from facadelake.detection.inference.detector import load_detector
from facadelake.detection.tiling.tiled_detection import detect_image
from facadelake.evaluation.detectors.predictions import collect_predictions
from facadelake.evaluation.detectors.sources import SCORE_FLOOR, CocoPredictionSource, OnnxPredictionSource
from tests.unit.detection.onnx_models import HEIGHT, WIDTH, make_card, make_output, save_model
from tests.unit.evaluation.detectors.labelled import image, picture

# In every tile: two boxes that a border cuts, a faint one between them, and one in the middle.
ROWS = [
    (0, 5.0, 30.0, 10.0, 20.0, 0.9, 0),
    (5, 91.0, 31.0, 10.0, 20.0, 0.6, 0),
    (9, 88.0, 33.0, 16.0, 26.0, 0.2, 0),
    (20, 50.0, 30.0, 12.0, 12.0, 0.7, 1),
    (21, 51.0, 30.0, 12.0, 12.0, 0.3, 1),
]


@pytest.mark.parametrize("size", [(WIDTH, HEIGHT), (400, 300)])
@pytest.mark.parametrize("threshold", [None, 0.65])
def test_one_run_gives_what_two_would(tmp_path: Path, size: tuple[int, int], threshold: float | None) -> None:
    model = save_model(tmp_path / "fixed.onnx", make_output("yolov8", ROWS))
    model.with_suffix(".card.yaml").write_text(yaml.safe_dump(make_card("yolov8")))
    width, height = size
    pixels = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
    looks = OnnxPredictionSource(model, threshold=threshold).detect(image("one"), pixels)
    shown = detect_image(load_detector(model, score_threshold=threshold or 0.25), pixels)
    low = detect_image(load_detector(model, score_threshold=SCORE_FLOOR), pixels)
    assert looks.above_threshold == shown and looks.above_floor == low
    assert 0 < len(shown) < len(low)


def test_boxes_of_a_file_are_filtered_and_found_by_the_end_of_their_path(tmp_path: Path) -> None:
    one = replace(image("walls/north/a.png"), path=picture(tmp_path / "a.png"))
    boxes = [
        {"id": 1, "image_id": 1, "category_id": 1, "bbox": [1, 2, 30, 4], "score": 0.9},
        {"id": 2, "image_id": 1, "category_id": 1, "bbox": [1, 2, 30, 4], "score": 0.2},
        {"id": 3, "image_id": 1, "category_id": 2, "bbox": [95, 2, 30, 4]},
        {"id": 4, "image_id": 1, "category_id": 1, "bbox": [1, 2, -3, 4]},
        {"id": 5, "image_id": 1, "category_id": 3, "bbox": [1, 2, 3, 4]},
    ]
    names = [{"id": i, "name": name} for i, name in enumerate(["crack", "spalling", "person"], start=1)]
    images = [{"id": 1, "file_name": "north/a.png", "width": one.width_px, "height": one.height_px}]
    content = {"images": images, "annotations": boxes, "categories": names}
    file = tmp_path / "found.json"
    file.write_text(json.dumps(content))
    looker = CocoPredictionSource(file, threshold=0.5)
    other = replace(one, key="walls/south/a.png")
    found = collect_predictions(looker, [one, other], build_crosswalk({}))
    assert [(p.score, p.box.width_px) for p in found.above_threshold[one.key]] == [(1.0, 5), (0.9, 30)]  # cut to 100 px
    assert len(found.above_floor[one.key]) == 3 and not found.above_threshold[other.key]
    assert found.left_out == {
        "predicted boxes of class 'person', which has no defect class": 1,
        "predicted boxes without four numbers and an area, or with an unusable rotation": 1,
    }


def test_a_broken_photograph_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    file.write_text(json.dumps({"images": [], "annotations": [], "categories": []}))
    (tmp_path / "broken.png").write_bytes(b"nothing")
    noise = np.random.default_rng(5).integers(0, 255, (80, 100, 3), dtype=np.uint8)
    jpeg = cv2.imencode(".jpg", noise)[1].tobytes()
    (tmp_path / "whole.jpg").write_bytes(jpeg)
    (tmp_path / "torn.jpg").write_bytes(jpeg[: len(jpeg) // 2])  # OpenCV opens it, half of it grey
    names = ("broken.png", "torn.jpg", "whole.jpg")
    images = [replace(image(name), path=tmp_path / name) for name in names]
    found = collect_predictions(CocoPredictionSource(file), images, build_crosswalk({}))
    assert [one.key for one in found.images] == ["whole.jpg"]
    assert found.left_out == {"photographs that cannot be decoded": 2}
