"""Cards in YAML, JSON and metadata; without a card, a draft that is a valid card."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from facadelake.core.errors import ModelError
from facadelake.detection.card import ModelCard, OutputLayout, format_card, locate_card, parse_card, read_card
from facadelake.detection.inference.card_lookup import find_card
from facadelake.detection.inference.detector import hash_detector, load_detector
from schemas.vocabulary import DefectClass
from tests.unit.detection.onnx_models import CLASSES, HEIGHT, WIDTH, make_card, make_output, make_outputs, save_model

CRACK = (10, 30.0, 20.0, 12.0, 8.0, 0.75, 0)
IMAGE = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
FULL: dict[str, Any] = {
    **make_card("yolov8"),
    "training_data": ["walls, CC BY 4.0", "generated"],
    "metrics": {"crack": {"ap50": 0.8, "images": 120}, "made": "2026-11-22"},
    "classes": {"car": "moisture"},
    "score_calibration": {"slope": 0.9, "intercept": -0.001},
}


def test_yaml_json_and_metadata_are_equivalent(tmp_path: Path) -> None:
    model = save_model(
        tmp_path / "crack.onnx", make_output("yolov8", [CRACK]), metadata={"facadelake.card": json.dumps(FULL)}
    )
    in_metadata = find_card(model)
    assert in_metadata.classes == {"car": DefectClass.MOISTURE}
    assert in_metadata.training_data == ("walls, CC BY 4.0", "generated")
    assert in_metadata.metrics == FULL["metrics"]
    beside = tmp_path / "crack.card.json"
    beside.write_text(json.dumps({**FULL, "name": "json"}))
    assert find_card(model) == in_metadata.model_copy(update={"name": "json"})
    locate_card(model).write_text(yaml.safe_dump({**FULL, "name": "yaml"}))
    assert find_card(model).name == "yaml"
    assert find_card(model, beside).name == "json"
    assert load_detector(model, beside).name == "json"


def test_json_keeps_small_numbers(tmp_path: Path) -> None:
    text = json.dumps({**FULL, "metrics": {"loss": 1e-5}})
    assert parse_card(text, "card").metrics == {"loss": 1e-5}
    with pytest.raises(ModelError, match=r"model x, metadata facadelake.card cannot be read as YAML or JSON"):
        parse_card("{", "model x, metadata facadelake.card")


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("classes", {"car": "rust"}, "classes.car is 'rust': Input should be 'crack', 'spalling' or 'moisture'"),
        ("score_calibration", {"slope": -1}, "score_calibration.slope is -1: Input should be greater than 0"),
        ("training_data", "walls", "training_data is 'walls': Input should be a valid tuple"),
        ("input", {**FULL["input"], "gsd_mm": [1, 2, 3]}, r"input.gsd_mm is .*: Tuple should have at most 2"),
        ("input", {**FULL["input"], "gsd_mm": [0]}, r"input.gsd_mm.0 is 0: Input should be greater than 0"),
    ],
)  # fmt: skip
def test_new_keys_are_checked(key: str, value: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        parse_card(json.dumps({**FULL, key: value}), "card")


def test_an_old_card_reads_as_before() -> None:
    old = parse_card(yaml.safe_dump(make_card("yolox")), "card")
    assert (old.classes, old.metrics, old.training_data, old.input.gsd_mm) == ({}, {}, (), ())
    assert (old.score_calibration.slope, old.score_calibration.intercept) == (1.0, 0.0)


def test_a_card_survives_a_round_trip() -> None:
    whole = ModelCard.model_validate({**FULL, "input": {**FULL["input"], "gsd_mm": [1.5, 6]}})
    assert parse_card(format_card(whole), "card") == whole


def test_metrics_in_a_card_do_not_change_the_hash(tmp_path: Path) -> None:
    model = save_model(tmp_path / "crack.onnx", make_output("yolov8", [CRACK]))
    prints = []
    for changes in ({}, {"metrics": {"ap50": 0.9}}, {"licence": "MIT"}, {"score_calibration": {"slope": 2}}):
        locate_card(model).write_text(yaml.safe_dump(make_card("yolov8", **changes)))
        prints.append(hash_detector(model, {}))
    assert prints[0] == prints[1] == prints[2] != prints[3]


def get_draft(model: Path) -> tuple[str, ModelCard]:
    """The message for a model without a card, and the draft at its end."""
    with pytest.raises(ModelError) as raised:
        load_detector(model)
    message, text = str(raised.value).split(":\n\n")
    locate_card(model).write_text(text)
    return message, read_card(locate_card(model))


def test_a_draft_from_the_metadata_of_ultralytics_is_ready_to_use(tmp_path: Path) -> None:
    metadata = {
        "names": "{0: 'crack', 1: 'car'}", "imgsz": f"[{HEIGHT}, {WIDTH}]", "task": "segment", "stride": "32",
        "license": "AGPL-3.0 License (https://ultralytics.com/license)", "description": "Ultralytics model",
    }  # fmt: skip
    outputs = make_outputs("yolov8_seg", [CRACK], {10: (1.0, 0.0, -28.3)})
    model = save_model(tmp_path / "walls.onnx", outputs, shape=("n", 3, "h", "w"), metadata=metadata)
    message, draft = get_draft(model)
    assert "walls.card.yaml does not exist; every detector needs one beside it" in message
    assert "A draft from its metadata and a probe image, layout yolov8_seg. Check it and save it as" in message
    assert (draft.name, draft.licence[:8], draft.class_names) == ("walls", "AGPL-3.0", CLASSES)
    assert (draft.input.width_px, draft.input.height_px, draft.input.colour) == (WIDTH, HEIGHT, "rgb")
    assert draft.input.scale == pytest.approx(1 / 255, rel=1e-12)
    (found,) = load_detector(model).detect(IMAGE)
    assert found.mask is not None


@pytest.mark.parametrize("layout", [str(layout) for layout in OutputLayout if layout is not OutputLayout.RTDETR_TRIPLE])
def test_a_draft_without_metadata_finds_layout_and_number_of_classes(tmp_path: Path, layout: str) -> None:
    single = layout in ("yolox", "yolov5", "yolov8", "nms6")
    outputs = make_output(layout, [CRACK]) if single else make_outputs(layout, [CRACK])
    message, draft = get_draft(save_model(tmp_path / "walls.onnx", outputs))
    # Without class names, RF-DETR's column for no object counts as a class.
    assert draft.output.layout == layout, message
    assert "class names are unknown" in message
    assert load_detector(tmp_path / "walls.onnx").detect(IMAGE)


def test_a_draft_for_an_input_that_is_no_multiple_of_yolox_strides(tmp_path: Path) -> None:
    """RF-DETR is exported at 560 px."""
    boxes, logits = np.full((1, 300, 4), 0.3), np.linspace(-4, 2, 1200).reshape(1, 300, 4)
    message, draft = get_draft(
        save_model(tmp_path / "rf.onnx", {"dets": boxes, "labels": logits}, shape=(1, 3, 560, 560))
    )
    assert (draft.output.layout, draft.input.width_px) == (OutputLayout.RFDETR, 560), message


def test_a_draft_for_outputs_of_no_layout(tmp_path: Path) -> None:
    message, draft = get_draft(save_model(tmp_path / "walls.onnx", np.zeros((1, 1000))))
    assert r"This draft is a guess: no layout fits the outputs for a probe image (output (1, 1000))" in message
    assert (draft.licence, draft.input.width_px) == ("unknown", WIDTH)
