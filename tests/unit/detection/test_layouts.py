"""Layouts of several outputs or normalised boxes return the encoded boxes and masks; others are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
import shapely
from onnx import TensorProto, helper

from facadelake.core.errors import ModelError
from facadelake.detection.card import ModelCard, OutputLayout
from facadelake.detection.inference.detector import OnnxDetector, load_detector
from facadelake.detection.inference.letterbox import fit_letterbox
from facadelake.detection.inference.mask_outline import trace_mask
from facadelake.detection.layouts.masks import QueryMasks
from tests.unit.detection.onnx_models import (
    CLASSES,
    GRID,
    HEIGHT,
    WIDTH,
    make_card,
    make_output,
    make_outputs,
    save_model,
    save_triple_model,
)

OTHER_LAYOUTS = (
    "yolov5_seg",
    "yolov8_seg",
    "nms6_seg",
    "rtdetr",
    "rtdetr_triple",
    "rtdetr_rows",
    "rfdetr",
    "rfdetr_seg",
)
SEGMENTERS = ("yolov5_seg", "yolov8_seg", "nms6_seg", "rfdetr_seg")
# candidate, centre x, centre y, width, height (px of the input), score, class.
CRACK = (10, 30.0, 20.0, 12.0, 8.0, 0.75, 0)
CAR = (15, 60.0, 40.0, 20.0, 30.0, 0.5, 1)
AGAIN = (11, 31.0, 20.0, 12.0, 8.0, 0.6, 0)
# Right of x = 28.3; below the line x + 2 y = 130.
PLANES = {10: (1.0, 0.0, -28.3), 15: (1.0, 2.0, -130.0)}
IMAGE = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)


# For maps: a box of whole cells with a probability above 0.5.
LARGE = (15, 60.0, 40.0, 24.0, 32.0, 0.625, 1)


def save_layout_model(tmp_path: Path, layout: str, boxes: list, planes: dict = PLANES) -> Path:
    path = tmp_path / "fixed.onnx"
    if layout == "rtdetr_triple":
        return save_triple_model(path, make_outputs(layout, boxes))
    if layout in ("yolox", "yolov5", "yolov8", "nms6"):
        return save_model(path, make_output(layout, boxes))
    return save_model(path, make_outputs(layout, boxes, planes))


def make_model_card(layout: str, **changes: object) -> ModelCard:
    return ModelCard.model_validate(make_card(layout, **changes))


@pytest.mark.parametrize("layout", OTHER_LAYOUTS)
def test_boxes_are_in_pixels_of_a_wide_photograph(tmp_path: Path, layout: str) -> None:
    detector = OnnxDetector(save_layout_model(tmp_path, layout, [CAR, CRACK]), make_model_card(layout))
    crack, car = detector.detect(np.zeros((150, 960, 3), dtype=np.uint8))
    # 960 px into 96: ten pixels of the photograph per pixel of the input.
    assert (crack.class_name, car.class_name) == CLASSES
    assert (crack.score, car.score) == pytest.approx((0.75, 0.5), rel=0, abs=1e-6)
    sides = [[b.box.x_px, b.box.y_px, b.box.width_px, b.box.height_px] for b in (crack, car)]
    assert sides[0] == pytest.approx([240, 160, 120, 80], rel=0, abs=0.01)  # px
    assert sides[1] == pytest.approx([500, 250, 200, 300], rel=0, abs=0.01)  # px


@pytest.mark.parametrize("resize", ["letterbox_corner", "letterbox_centre", "stretch"])
@pytest.mark.parametrize("layout", ["rtdetr", "rtdetr_triple", "rfdetr"])
def test_normalised_boxes_are_transformed_back_for_every_resize_mode(tmp_path: Path, layout: str, resize: str) -> None:
    content = make_card(layout)
    content["input"]["resize"] = resize
    detector = OnnxDetector(save_layout_model(tmp_path, layout, [CRACK]), ModelCard.model_validate(content))
    (crack,) = detector.detect(np.zeros((640, 320, 3), dtype=np.uint8))
    # 640 high into 64; 320 wide into 32 of 96, at the left, centred, or stretched to the full width.
    left = {"letterbox_corner": 24 * 10, "letterbox_centre": (24 - 32) * 10, "stretch": 24 * 320 / 96}[resize]
    width = {"stretch": 12 * 320 / 96}.get(resize, 120)
    box = crack.box
    assert [box.x_px, box.y_px, box.width_px, box.height_px] == pytest.approx(
        [left, 160, width, 80], rel=0, abs=0.01
    )  # px


@pytest.mark.parametrize("layout", OTHER_LAYOUTS)
def test_only_overlapping_layouts_are_suppressed(tmp_path: Path, layout: str) -> None:
    detector = OnnxDetector(save_layout_model(tmp_path, layout, [CRACK, AGAIN], {}), make_model_card(layout))
    kept = 1 if layout in ("yolov5_seg", "yolov8_seg") else 2
    assert [round(found.score, 5) for found in detector.detect(IMAGE)] == [0.75, 0.6][:kept]


@pytest.mark.parametrize("layout", SEGMENTERS)
def test_masks_are_outlines_clipped_to_the_box(tmp_path: Path, layout: str) -> None:
    content = make_card(layout)
    content["input"]["resize"] = "letterbox_centre"
    detector = OnnxDetector(save_layout_model(tmp_path, layout, [CRACK, CAR]), ModelCard.model_validate(content))
    # 480 wide into 96, 200 high into 40 of 64: gain 0.2, 12 px of padding above.
    crack, car = detector.detect(np.zeros((200, 480, 3), dtype=np.uint8))
    # Half-planes intersected with boxes, in pixels of the input; then x * 5, (y - 12) * 5.
    for found, corners in (
        (crack, [(28.3, 16), (36, 16), (36, 24), (28.3, 24)]),
        (car, [(70, 30), (70, 55), (50, 55), (50, 40)]),
    ):
        shape = shapely.Polygon([(x * 5, (y - 12) * 5) for x, y in corners]).intersection(shapely.box(0, 0, 480, 200))
        assert found.mask is not None
        assert found.mask.is_valid
        assert found.mask.symmetric_difference(shape).area < 0.01 * shape.area
        assert shapely.hausdorff_distance(found.mask, shape) < 0.5  # px


def test_an_empty_mask_is_none_as_of_a_model_without_masks(tmp_path: Path) -> None:
    (found,) = OnnxDetector(
        save_layout_model(tmp_path, "yolov8_seg", [CRACK], {}), make_model_card("yolov8_seg")
    ).detect(IMAGE)
    assert found.mask is None
    (found,) = OnnxDetector(save_layout_model(tmp_path, "yolov8", [CRACK]), make_model_card("yolov8")).detect(IMAGE)
    assert found.mask is None


def test_a_ring_keeps_its_hole_and_two_spots_stay_separate() -> None:
    rows, columns = GRID
    x, y = np.meshgrid((np.arange(columns) + 0.5) * 4, (np.arange(rows) + 0.5) * 4)
    away = np.hypot(x - 48, y - 32)
    ring = 6.0 - np.abs(away - 18.0)  # between 12 and 24 px of the centre
    spots = np.maximum(7.0 - np.hypot(x - 20, y - 20), 7.0 - np.hypot(x - 70, y - 40))
    masks = QueryMasks(all_logits=np.stack([ring, spots]).astype(np.float32), queries=np.array([0, 1]))
    box = fit_letterbox(make_model_card("rfdetr_seg").input, image_width_px=960, image_height_px=640)
    whole = np.array([0, 0, WIDTH, HEIGHT], dtype=np.float32)
    shape = trace_mask(masks, 0, whole, box)
    assert isinstance(shape, shapely.Polygon)
    assert len(shape.interiors) == 1
    # Straight lines between cells of 4 px: within a quarter of a cell (10 px of the photograph) of the circles.
    assert shape.area == pytest.approx(np.pi * (240**2 - 120**2), rel=0.05, abs=0)  # px2
    assert shapely.hausdorff_distance(shape.exterior, shapely.Point(480, 320).buffer(240).exterior) < 10  # px
    two = trace_mask(masks, 1, whole, box)
    assert isinstance(two, shapely.MultiPolygon)
    assert sorted(round(part.centroid.x / 10) for part in two.geoms) == [20, 70]


def test_a_mask_reaches_the_border_of_the_photograph() -> None:
    masks = QueryMasks(all_logits=np.ones((1, *GRID), dtype=np.float32), queries=np.array([0]))
    box = fit_letterbox(make_model_card("rfdetr_seg").input, image_width_px=960, image_height_px=640)
    shape = trace_mask(masks, 0, np.array([-5, -5, 50, 70], dtype=np.float32), box)
    assert shape is not None
    assert shape.symmetric_difference(shapely.box(0, 0, 500, 640)).area < 1e-6  # px2
    assert trace_mask(masks, 0, np.array([97, 5, 99, 9], dtype=np.float32), box) is None


# Layouts that are correct, too: fewer outputs of the same model, or without the column for no object.
COMPATIBLE = {("rtdetr", "rfdetr"), ("rfdetr_seg", "rfdetr")}


@pytest.mark.parametrize("layout", [str(layout) for layout in OutputLayout])
def test_another_layout_than_declared_is_refused(tmp_path: Path, layout: str) -> None:
    path = save_layout_model(tmp_path, layout, [CRACK, LARGE])
    for other in OutputLayout:
        if other == layout or (layout, other) in COMPATIBLE:
            assert OnnxDetector(path, make_model_card(other)).detect(IMAGE)
            continue
        with pytest.raises(ModelError, match=rf"fixed.onnx: .*fit layout .*{layout}.*; correct output.layout"):
            OnnxDetector(path, make_model_card(other))


def test_outputs_are_assigned_by_name_then_shape_then_card(tmp_path: Path) -> None:
    # Three classes and a column for no object: logits have the shape of boxes.
    given = make_outputs("rfdetr", [CRACK])
    boxes, logits = given["dets"], np.concatenate([given["labels"][..., :2], given["labels"][..., 2:] - 12.0], axis=2)
    logits = np.concatenate([logits, logits[..., 2:]], axis=2)
    names = ["crack", "car", "spalling"]
    named = save_model(tmp_path / "named.onnx", {"labels": logits, "dets": boxes})
    assert OnnxDetector(named, make_model_card("rfdetr", class_names=names)).detect(IMAGE)[0].class_name == "crack"
    unnamed = save_model(tmp_path / "unnamed.onnx", {"first": logits, "second": boxes})
    with pytest.raises(
        ModelError, match=r"could be boxes and logits in 2 ways; state which is which in the card: output.names"
    ):
        OnnxDetector(unnamed, make_model_card("rfdetr", class_names=names))
    stated = make_model_card("rfdetr", class_names=names, output={"layout": "rfdetr", "names": ["second", "first"]})
    assert OnnxDetector(unnamed, stated).detect(IMAGE)[0].class_name == "crack"
    by_shape = save_model(tmp_path / "shape.onnx", {"first": given["labels"], "second": boxes})
    assert OnnxDetector(by_shape, make_model_card("rfdetr")).detect(IMAGE)[0].class_name == "crack"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["dets"], r"output.names are 1 \(dets\), layout rfdetr has 2 \(boxes, logits\)"),
        (["dets", "logits"], r"it has no output 'logits' \(it has \['dets', 'labels'\]\)"),
        (["labels", "dets"], r"its outputs are dets \(1, 20, 4\), labels \(1, 20, 3\), layout rfdetr with 2 classes"),
    ],
)  # fmt: skip
def test_wrong_names_of_outputs_are_refused(tmp_path: Path, names: list[str], message: str) -> None:
    path = save_layout_model(tmp_path, "rfdetr", [CRACK])
    with pytest.raises(ModelError, match=message):
        OnnxDetector(path, make_model_card("rfdetr", output={"layout": "rfdetr", "names": names}))


def test_name_and_names_together_are_refused() -> None:
    with pytest.raises(ValueError, match="keep one of them"):
        make_model_card("rfdetr", output={"layout": "rfdetr", "name": "dets", "names": ["dets", "labels"]})


def test_probabilities_instead_of_logits_and_pixels_instead_of_fractions(tmp_path: Path) -> None:
    given = make_outputs("rtdetr", [CRACK])
    sure = {**given, "logits": 1 / (1 + np.exp(-given["logits"]))}
    with pytest.raises(ModelError, match="they are probabilities already; export the model without its sigmoid"):
        OnnxDetector(save_model(tmp_path / "sure.onnx", sure), make_model_card("rtdetr"))
    pixels = {**given, "pred_boxes": given["pred_boxes"] * [WIDTH, HEIGHT, WIDTH, HEIGHT]}
    with pytest.raises(ModelError, match=r"reach \d+ times the input's size .*they are not normalised to 0..1"):
        OnnxDetector(save_model(tmp_path / "pixels.onnx", pixels), make_model_card("rtdetr"))


def test_a_wrong_number_of_class_names_is_reported_with_the_right_one(tmp_path: Path) -> None:
    path = save_layout_model(tmp_path, "yolov8_seg", [CRACK])
    with pytest.raises(
        ModelError, match=r"candidates \(1, 7\+k, N\) and prototypes \(1, k, h, w\); with 2 class_names"
    ):
        OnnxDetector(path, make_model_card("yolov8_seg", class_names=["crack", "spalling", "moisture"]))


def test_every_class_of_a_query_counts(tmp_path: Path) -> None:
    both = make_outputs("rtdetr", [CRACK, (10, 30.0, 20.0, 12.0, 8.0, 0.4, 1)])
    found = OnnxDetector(save_model(tmp_path / "both.onnx", both), make_model_card("rtdetr")).detect(IMAGE)
    assert [(one.class_name, round(one.score, 5)) for one in found] == [("crack", 0.75), ("car", 0.4)]


@pytest.mark.parametrize("layout", ["map", "map_logits"])
def test_a_connected_component_of_a_map_is_one_box_with_its_mask(tmp_path: Path, layout: str) -> None:
    again = (0, 62.0, 8.0, 4.0, 8.0, 0.8, 0)
    content = make_card(layout)
    content["input"]["resize"] = "stretch"
    path = save_layout_model(tmp_path, layout, [CRACK, LARGE, again])
    small, crack, car = OnnxDetector(path, ModelCard.model_validate(content)).detect(np.zeros((640, 192, 3), np.uint8))
    # Two pixels of the photograph across and ten down per pixel of the input.
    sides = [(b.box.x_px, b.box.y_px, b.box.width_px, b.box.height_px) for b in (small, crack, car)]
    assert sides == [(120, 40, 8, 80), (48, 160, 24, 80), (96, 240, 48, 320)]
    assert [b.class_name for b in (small, crack, car)] == ["crack", "crack", "car"]
    assert [b.score for b in (small, crack, car)] == pytest.approx([0.8, 0.75, 0.625], rel=0, abs=1e-5)
    for found in (small, crack, car):
        assert found.mask is not None
        # The contour of 0.5 lies between centres of cells (8 x 40 px): the mask ends up to half a cell inside.
        box = found.box
        assert found.mask.within(shapely.box(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px))
        centre = shapely.Point(box.x_px + box.width_px / 2, box.y_px + box.height_px / 2)
        assert found.mask.contains(centre)
        across, down = found.mask.bounds[2] - found.mask.bounds[0], found.mask.bounds[3] - found.mask.bounds[1]
        assert box.width_px - 8 < across <= box.width_px
        assert box.height_px - 40 < down <= box.height_px


def test_a_background_class_is_ignored_and_selects_softmax(tmp_path: Path) -> None:
    maps = np.zeros((1, 3, *GRID))
    maps[0, 1, 4:8, 4:12] = np.log(6)  # 6 : 1 : 1
    maps[0, 0, 8:] = 5.0
    path = save_model(tmp_path / "map.onnx", maps)
    names = ["Background", "crack", "spalling"]
    (found,) = OnnxDetector(path, make_model_card("map_logits", class_names=names)).detect(IMAGE)
    assert (found.class_name, found.score) == ("crack", pytest.approx(0.75, rel=0, abs=1e-5))
    box = found.box
    assert (box.x_px, box.y_px, box.width_px, box.height_px) == (16, 16, 32, 16)


def test_nan_is_refused_at_load_and_reported_later(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for layout in OutputLayout:
        path = tmp_path / "fixed.onnx"
        given = (
            make_output(layout, [CRACK])
            if layout in ("yolox", "yolov5", "yolov8", "nms6")
            else make_outputs(layout, [CRACK])
        )
        if layout != "rtdetr_triple":
            outputs = given if isinstance(given, dict) else {"output": given}
            path = save_model(path, {name: np.full_like(values, np.nan) for name, values in outputs.items()})
            with pytest.raises(
                ModelError, match=r"\d+ values of the outputs for a probe image are not numbers \(NaN\)"
            ):
                OnnxDetector(path, make_model_card(layout))
    # The square root of 200 minus the mean: NaN for an image brighter than the probe's noise.
    model = onnx.load(save_model(path, make_output("yolov8", [CRACK])))
    del model.graph.node[0]
    for node in reversed(
        [
            helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
            helper.make_node("Sub", ["limit", "mean"], ["left"]),
            helper.make_node("Sqrt", ["left"], ["sum"]),
        ]
    ):
        model.graph.node.insert(0, node)
    model.graph.initializer.append(helper.make_tensor("limit", TensorProto.FLOAT, [], [200.0]))
    onnx.save(model, path)
    detector = OnnxDetector(path, make_model_card("yolov8"))
    assert detector.detect(IMAGE)
    caplog.clear()
    assert detector.detect(np.full((HEIGHT, WIDTH, 3), 255, dtype=np.uint8)) == ()
    assert "outputs for an image of 96 x 64 px contain values that are not numbers (NaN)" in caplog.text


@pytest.mark.parametrize(
    "changes", [{"score_calibration": {"slope": np.inf}}, {"score_calibration": {"intercept": np.nan}}]
)
def test_numbers_of_a_card_are_finite(changes: dict) -> None:
    with pytest.raises(ValueError, match="finite number"):
        make_model_card("yolov8", **changes)


def test_a_short_list_of_boxes_is_drafted_as_nms6(tmp_path: Path) -> None:
    rows = np.zeros((1, 20, 6))
    rows[0, :3] = [(10, 10, 20, 30, 0.8, 0), (40, 30, 60, 50, 0.5, 0), (5, 40, 20, 60, 0.3, 0)]
    with pytest.raises(ModelError, match="layout nms6"):
        load_detector(save_model(tmp_path / "few.onnx", rows))
