"""Every layout returns the encoded boxes; a model that is not as declared is refused with the reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from onnx import TensorProto

from facadelake.core.errors import ModelError
from facadelake.detection.card import ModelCard, locate_card, read_card
from facadelake.detection.inference.detector import OnnxDetector, hash_detector, load_detector
from tests.unit.detection.onnx_models import CLASSES, list_cells, make_card, make_output, save_model

LAYOUTS = ("yolox", "yolov5", "yolov8", "nms6")
# candidate, centre x, centre y, width, height (px of the input), score, class. AGAIN is suppressed.
CRACK = (10, 30.0, 20.0, 12.0, 8.0, 0.75, 0)
CAR = (70, 60.0, 40.0, 20.0, 30.0, 0.5, 1)
AGAIN = (11, 31.0, 20.0, 12.0, 8.0, 0.6, 0)
CRACK_ON_CAR = (71, 60.0, 40.0, 20.0, 30.0, 0.4, 0)


def make_detector(tmp_path: Path, layout: str, output: Any, **changes: Any) -> OnnxDetector:
    model = save_model(tmp_path / "fixed.onnx", output)
    return OnnxDetector(model, ModelCard.model_validate(make_card(layout, **changes)))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_boxes_are_in_pixels_of_a_wide_photograph(tmp_path: Path, layout: str) -> None:
    found = make_detector(tmp_path, layout, make_output(layout, [CAR, CRACK])).detect(
        np.zeros((150, 960, 3), dtype=np.uint8)
    )
    # 960 px into 96: ten pixels of the photograph per pixel of the input.
    crack, car = found
    assert (crack.class_name, car.class_name) == CLASSES
    assert (crack.score, car.score) == pytest.approx((0.75, 0.5), rel=0, abs=1e-6)
    sides = [[b.box.x_px, b.box.y_px, b.box.width_px, b.box.height_px] for b in found]
    assert sides[0] == pytest.approx([240, 160, 120, 80], rel=0, abs=0.01)  # px
    assert sides[1] == pytest.approx([500, 250, 200, 300], rel=0, abs=0.01)  # px


@pytest.mark.parametrize("layout", ["yolox", "yolov5", "yolov8"])
def test_a_tall_photograph_centred(tmp_path: Path, layout: str) -> None:
    content = make_card(layout)
    content["input"]["resize"] = "letterbox_centre"
    model = save_model(tmp_path / "fixed.onnx", make_output(layout, [CRACK, CAR]))
    found = OnnxDetector(model, ModelCard.model_validate(content)).detect(np.zeros((640, 320, 3), dtype=np.uint8))
    # 640 px high into 64: gain 0.1; 32 px wide, so (96 - 32) / 2 = 32 px of padding at the left.
    crack, car = (b.box for b in found)
    assert [crack.x_px, crack.y_px] == pytest.approx([(24 - 32) * 10, 160], rel=0, abs=0.01)  # px: in the padding
    assert [car.x_px, car.y_px, car.width_px] == pytest.approx([(50 - 32) * 10, 250, 200], rel=0, abs=0.01)  # px


@pytest.mark.parametrize("layout", ["yolox", "yolov5", "yolov8"])
def test_suppression_is_within_a_class(tmp_path: Path, layout: str) -> None:
    image = np.zeros((64, 96, 3), dtype=np.uint8)
    found = make_detector(tmp_path, layout, make_output(layout, [CRACK, CAR, AGAIN, CRACK_ON_CAR])).detect(image)
    assert [(b.class_name, round(b.score, 6)) for b in found] == [("crack", 0.75), ("car", 0.5), ("crack", 0.4)]
    few = make_detector(tmp_path, layout, make_output(layout, [CRACK, CAR, AGAIN]), max_detections=1).detect(image)
    assert [b.class_name for b in few] == ["crack"]
    strict = make_detector(tmp_path, layout, make_output(layout, [CRACK, CAR]), score_threshold=0.8).detect(image)
    assert strict == ()


def test_half_precision_and_symbolic_dimensions(tmp_path: Path) -> None:
    declared = ModelCard.model_validate(make_card("yolov8"))
    image = np.zeros((64, 96, 3), dtype=np.uint8)
    half = save_model(tmp_path / "half.onnx", make_output("yolov8", [CRACK]), kind=TensorProto.FLOAT16)
    free = save_model(tmp_path / "free.onnx", make_output("yolov8", [CRACK]), shape=("batch", 3, "height", "width"))
    for model in (half, free):
        (found,) = OnnxDetector(model, declared).detect(image)
        assert found.score == pytest.approx(0.75, rel=0, abs=1e-3)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("declared", LAYOUTS)
def test_another_layout_than_declared_is_refused(tmp_path: Path, layout: str, declared: str) -> None:
    output = make_output(layout, [CRACK, CAR])
    if layout == declared:
        make_detector(tmp_path, declared, output)
        return
    with pytest.raises(ModelError, match=rf"fixed.onnx: .*layout {declared}"):
        make_detector(tmp_path, declared, output)


def test_the_message_has_expected_and_actual_shape(tmp_path: Path) -> None:
    with pytest.raises(ModelError) as raised:
        make_detector(tmp_path, "yolov5", make_output("yolov8", [CRACK]))
    message = str(raised.value)
    count = len(list_cells()[0])
    assert f"its output has shape (1, 6, {count}), layout yolov5 with 2 classes at 96 x 64 px has (1, N, 7)" in message
    assert "shape and values fit layout yolov8; correct output.layout or class_names in the card" in message
    with pytest.raises(ModelError, match=r"layout yolox with 3 classes at 96 x 64 px has \(1, 126, 8\)"):
        make_detector(tmp_path, "yolox", make_output("yolox", [CRACK]), class_names=["a", "b", "c"])


def test_logits_and_normalised_boxes_are_refused(tmp_path: Path) -> None:
    logits = make_output("yolov8", [CRACK])
    logits[:, 4:] = 12 * logits[:, 4:] - 6
    with pytest.raises(ModelError, match=r"scores of a probe image run from -6 to 3, not from 0 to 1: they are logits"):
        make_detector(tmp_path, "yolov8", logits)
    normalised = make_output("yolov8", [CRACK])
    normalised[:, :4] /= 96
    with pytest.raises(ModelError, match=r"reach 0.0\d+ times the input's size .*normalised to 0..1"):
        make_detector(tmp_path, "yolov8", normalised)


def test_an_input_that_is_not_the_declared_one_is_refused(tmp_path: Path) -> None:
    declared = ModelCard.model_validate(make_card("yolov8"))
    turned = save_model(tmp_path / "turned.onnx", make_output("yolov8", [CRACK]), shape=(1, 3, 96, 64))
    with pytest.raises(ModelError, match=r"shape \[1, 3, 96, 64\], its card declares \[1, 3, 64, 96\]"):
        OnnxDetector(turned, declared)
    whole = save_model(tmp_path / "whole.onnx", make_output("yolov8", [CRACK]), kind=TensorProto.INT32)
    with pytest.raises(ModelError, match=r"tensor\(int32\).*one input of float or float16"):
        OnnxDetector(whole, declared)
    content = make_card("yolov8", output={"layout": "yolov8", "name": "boxes"})
    model = save_model(tmp_path / "fixed.onnx", make_output("yolov8", [CRACK]))
    with pytest.raises(ModelError, match=r"has no output 'boxes' \(it has \['output'\]\)"):
        OnnxDetector(model, ModelCard.model_validate(content))


def test_a_class_without_a_name_is_refused(tmp_path: Path) -> None:
    output = make_output("nms6", [(*CRACK[:6], 5)])
    with pytest.raises(ModelError, match=r"returned class 5, its card names 2 classes \(0 to 1\)"):
        make_detector(tmp_path, "nms6", output).detect(np.zeros((64, 96, 3), dtype=np.uint8))


def test_a_file_that_is_not_a_model_is_refused(tmp_path: Path) -> None:
    declared = ModelCard.model_validate(make_card("yolov8"))
    with pytest.raises(ModelError, match=r"model .*none.onnx does not exist; correct the detector's path"):
        OnnxDetector(tmp_path / "none.onnx", declared)
    (tmp_path / "text.onnx").write_text("not a model")
    with pytest.raises(ModelError, match=r"text.onnx cannot be loaded by onnxruntime"):
        OnnxDetector(tmp_path / "text.onnx", declared)


def write_card(model: Path, content: Any) -> Path:
    locate_card(model).write_text(yaml.safe_dump(content))
    return locate_card(model)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"output": {"layout": "yolov9"}}, "output.layout is 'yolov9': Input should be 'yolox', 'yolov5'"),
        ({"score_threshold": 40}, "score_threshold is 40: Input should be less than or equal to 1"),
        ({"class_names": []}, "class_names is .*: Tuple should have at least 1 item"),
        ({"licence": ""}, "licence is '': String should have at least 1 character"),
        ({"nms": 0.4}, "nms is 0.4: Extra inputs are not permitted"),
        ({"input": {"width_px": 96}}, "input.height_px: Field required; input.colour: Field required"),
    ],
)  # fmt: skip
def test_a_card_is_validated(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = write_card(tmp_path / "fixed.onnx", make_card("yolov8", **changes))
    with pytest.raises(ModelError, match=message) as raised:
        read_card(path)
    assert str(path) in str(raised.value)


def test_inconsistent_and_missing_cards_are_refused(tmp_path: Path) -> None:
    content = make_card("yolox")
    content["input"]["width_px"] = 100
    with pytest.raises(ModelError, match="is 100 x 64 px; layout yolox needs multiples of its largest stride, 32"):
        read_card(write_card(tmp_path / "fixed.onnx", content))
    with pytest.raises(ModelError, match=r"fixed2.card.yaml does not exist; every detector needs one beside it"):
        read_card(locate_card(tmp_path / "fixed2.onnx"))
    with pytest.raises(ModelError, match="contains no keys"):
        read_card(write_card(tmp_path / "fixed.onnx", "crack"))


def test_the_hash_depends_on_model_card_and_class_names(tmp_path: Path) -> None:
    model = save_model(tmp_path / "fixed.onnx", make_output("yolov8", [CRACK]))
    write_card(model, make_card("yolov8"))
    assert load_detector(model).name == "fixed"
    first = hash_detector(model, {})
    assert hash_detector(model, {}) == first
    prints = {first, hash_detector(model, {"car": "crack"})}
    write_card(model, make_card("yolov8", score_threshold=0.3))
    prints.add(hash_detector(model, {}))
    save_model(model, make_output("yolov8", [CAR]))
    prints.add(hash_detector(model, {}))
    assert len(prints) == 4
