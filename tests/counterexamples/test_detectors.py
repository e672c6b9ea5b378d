"""Models that do not match their card or overflow, and photographs of unusual formats."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import pyarrow as pa
import pytest
import yaml
from numpy.typing import NDArray
from onnx import helper
from PIL import Image

from facadelake.core.errors import ModelError
from facadelake.core.tables import table_from_rows
from facadelake.detection.campaign import detect_photographs
from facadelake.detection.card import ModelCard, parse_card
from facadelake.detection.inference.detector import OnnxDetector
from tests.unit.detection.onnx_models import HEIGHT, WIDTH, make_card, make_output, save_model, save_spot_model

CRACK = (10, 30.0, 20.0, 12.0, 8.0, 0.75, 0)
LAYOUTS = ("yolox", "yolov5", "yolov8", "nms6")
Spoiler = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def get_refusal(
    path: Path, output: NDArray[np.float64], layout: str, shape: tuple[int | str, ...] | None = None
) -> str:
    model = save_model(path / "m.onnx", output, **({} if shape is None else {"shape": shape}))
    with pytest.raises(ModelError) as raised:
        OnnxDetector(model, ModelCard.model_validate(make_card(layout)))
    return str(raised.value)


def make_spoiler(step: int, value: float) -> Spoiler:
    def spoil(output: NDArray[np.float64]) -> NDArray[np.float64]:
        spoilt = output.copy()
        spoilt.reshape(-1)[::step] = value
        return spoilt

    return spoil


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("step", [1, 7], ids=["all", "some"])
def test_a_model_with_nan_outputs_is_refused(tmp_path: Path, layout: str, step: int) -> None:
    """NaN is below every threshold: such a model would silently find nothing."""
    assert "are not numbers (NaN)" in get_refusal(
        tmp_path, make_spoiler(step, np.nan)(make_output(layout, [CRACK])), layout
    )


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_model_that_overflows_is_refused(tmp_path: Path, layout: str) -> None:
    assert "of a probe image" in get_refusal(tmp_path, make_spoiler(7, np.inf)(make_output(layout, [CRACK])), layout)


@pytest.mark.parametrize("layout", ["yolov5", "yolov8", "nms6"])
def test_normalised_boxes_are_refused(tmp_path: Path, layout: str) -> None:
    output = make_output(layout, [CRACK])
    boxes = output[:, :4] if layout == "yolov8" else output[..., :4]
    boxes /= WIDTH
    assert "normalised" in get_refusal(tmp_path, output, layout)


@pytest.mark.parametrize("layout", ["yolov5", "yolov8"])
def test_corners_in_the_place_of_centres_and_sizes_are_refused(tmp_path: Path, layout: str) -> None:
    """They were read as boxes as large as their corner is far from the upper left."""
    output = make_output(layout, [CRACK])
    rows = output.transpose(0, 2, 1) if layout == "yolov8" else output
    centre, size = rows[..., :2].copy(), rows[..., 2:4].copy()
    rows[..., :4] = np.concatenate([centre - size / 2, centre + size / 2], axis=-1)
    assert (
        "all 126 boxes of a probe image, read as centre and size, are wider and higher than their centres are from the "
        "upper left: they seem to be corners; export it with centres and sizes"
    ) in get_refusal(tmp_path, output, layout)


@pytest.mark.parametrize(
    ("shape", "names"),
    [
        ((4, 3, HEIGHT, WIDTH), "[4, 3, 64, 96]"),
        ((1, HEIGHT, WIDTH, 3), "[1, 64, 96, 3]"),
        ((1, 1, HEIGHT, WIDTH), "[1, 1, 64, 96]"),
        ((1, 3, WIDTH, HEIGHT), "[1, 3, 96, 64]"),
    ],
    ids=["batch of four", "channels last", "grey", "height and width swapped"],
)
def test_an_input_of_another_shape_is_refused(tmp_path: Path, shape: tuple[int, ...], names: str) -> None:
    message = get_refusal(tmp_path, make_output("yolov8", [CRACK]), "yolov8", shape)
    assert f"takes an input of shape {names}, its card declares [1, 3, 64, 96]" in message


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
@pytest.mark.parametrize("key", ["score_calibration.intercept", "input.scale", "score_threshold"])
def test_a_card_with_infinite_or_nan_values(key: str, value: float) -> None:
    """YAML has infinity and NaN; a calibration of NaN would make every score NaN."""
    content: dict[str, Any] = make_card("yolov8")
    part, _, name = key.rpartition(".")
    (content.setdefault(part, {}) if part else content)[name] = value
    with pytest.raises(ModelError, match=rf"a card: {key} is (nan|-?inf): "):
        parse_card(yaml.safe_dump(content), "a card")


def test_too_few_class_names_fail_with_the_remedy(tmp_path: Path) -> None:
    """The number of classes of layout nms6 is unknown until a class beyond the card's occurs."""
    output = make_output("nms6", [(*CRACK[:6], 7)])
    detector = OnnxDetector(save_model(tmp_path / "m.onnx", output), ModelCard.model_validate(make_card("nms6")))
    with pytest.raises(
        ModelError, match=r"returned class 7, its card names 2 classes \(0 to 1\); complete class_names"
    ):
        detector.detect(np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8))


def make_photos_table(folder: Path, names: list[str]) -> pa.Table:
    return table_from_rows(
        "photos",
        [
            {
                "photo_id": name, "sha256": name, "bytes": 1, "photo_outcome": "accepted",
                "prior_source": "none", "prior_height_datum": "unknown",
            }
            for name in names
        ],
    )  # fmt: skip


def make_spot_detector(folder: Path) -> OnnxDetector:
    """A detector of the centroids of red and green in its input."""
    content = make_card("nms6", score_threshold=0.3, nms_iou=0.99)
    content["input"] = {**content["input"], "pad_value": 0}
    return OnnxDetector(save_spot_model(folder / "m.onnx", batch=1), ModelCard.model_validate(content))


def store_variants(folder: Path) -> list[str]:
    """One image, a bright rectangle at 110 to 150, 10 to 40 px of 192 x 80, in many formats."""
    values = np.zeros((80, 192), dtype=np.uint8)
    values[10:40, 110:150] = 255
    colour = np.repeat(values[..., None], 3, axis=2)
    Image.fromarray(colour).save(folder / "rgb.png")
    Image.fromarray(values).save(folder / "grey.jpg", quality=100)
    Image.fromarray(values.astype(np.uint16) * 257).save(folder / "grey16.tif")
    cv2.imwrite(str(folder / "rgb16.png"), colour.astype(np.uint16) * 257)
    Image.fromarray(np.dstack([colour, np.full_like(values, 255)])).save(folder / "alpha.png")
    Image.fromarray(colour).convert("CMYK").save(folder / "cmyk.jpg", quality=100)
    Image.fromarray(colour).quantize(4).save(folder / "palette.png")
    for orientation in (3, 6):
        exif = Image.Exif()
        exif[274] = orientation
        Image.fromarray(colour).save(folder / f"turned{orientation}.jpg", quality=100, exif=exif)
    return sorted(path.name for path in folder.iterdir())


def test_photographs_in_other_formats_give_the_same_detection(tmp_path: Path) -> None:
    folder = tmp_path / "photographs"
    folder.mkdir()
    names = store_variants(folder)
    rows = detect_photographs(make_photos_table(folder, names), folder, make_spot_detector(tmp_path)).to_pylist()
    red = {row["photo_id"]: row for row in rows if row["source_class"] == "crack"}
    assert sorted(red) == names
    for name, row in red.items():
        centre = (row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2)
        # The black of CMYK is not 0; rotated pixels would be 60 px away.
        assert centre == pytest.approx((130, 25), rel=0, abs=2.0), name  # px of the photograph as stored


def test_one_pixel_and_a_panorama_among_bad_files(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = tmp_path / "photographs"
    folder.mkdir()
    Image.new("RGB", (1, 1), (255, 255, 255)).save(folder / "pixel.png")
    panorama = np.zeros((60, 5000, 3), dtype=np.uint8)
    panorama[20:30, 4800:4810] = 255
    Image.fromarray(panorama).save(folder / "panorama.png")
    Image.fromarray(panorama).save(folder / "cut.png")
    whole = (folder / "cut.png").read_bytes()
    (folder / "cut.png").write_bytes(whole[:20])
    (folder / "empty.jpg").write_bytes(b"")
    names = ["cut.png", "empty.jpg", "gone.jpg", "panorama.png", "pixel.png"]
    with caplog.at_level(logging.WARNING):
        rows = detect_photographs(make_photos_table(folder, names), folder, make_spot_detector(tmp_path)).to_pylist()
    for name in ("cut.png", "empty.jpg", "gone.jpg"):
        assert f"{name} cannot be read: the detector did not process it" in caplog.text
    assert {row["photo_id"] for row in rows} == {"panorama.png", "pixel.png"}
    spots = [row for row in rows if row["photo_id"] == "panorama.png" and row["source_class"] == "crack"]
    assert min(abs(row["box_x_px"] + row["box_width_px"] / 2 - 4805) for row in spots) < 1.0  # px
    pixel = next(row for row in rows if row["photo_id"] == "pixel.png")
    assert pixel["box_x_px"] >= 0
    assert pixel["box_x_px"] + pixel["box_width_px"] <= 1


def test_values_that_overflow_in_one_photograph_are_reported_and_the_others_count(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The logarithm of the sum is NaN for a black photograph only."""
    path = save_model(tmp_path / "m.onnx", make_output("yolov8", [CRACK]))
    model = onnx.load(path)
    graph = model.graph
    index = next(i for i, node in enumerate(graph.node) if node.op_type == "Mul")
    graph.node.insert(index, helper.make_node("Log", ["sum"], ["log"]))
    graph.node[index + 1].input[0] = "log"
    onnx.save(model, path)
    folder = tmp_path / "photographs"
    folder.mkdir()
    for name, grey in (("black.png", 0), ("wall.png", 128)):
        Image.new("RGB", (WIDTH, HEIGHT), (grey, grey, grey)).save(folder / name)
    detector = OnnxDetector(path, ModelCard.model_validate(make_card("yolov8")))
    with caplog.at_level(logging.WARNING):
        rows = detect_photographs(make_photos_table(folder, ["black.png", "wall.png"]), folder, detector).to_pylist()
    assert {row["photo_id"] for row in rows} == {"wall.png"}
    assert "not numbers (NaN)" in caplog.text
