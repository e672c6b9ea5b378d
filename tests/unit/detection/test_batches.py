"""Spots are detected at their drawn positions to half a pixel, singly and in a batch."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import TensorProto, helper

from facadelake.detection.card import ModelCard, ResizeMode
from facadelake.detection.inference.card_lookup import find_card
from facadelake.detection.inference.detector import DetectedBox, OnnxDetector
from tests.unit.detection.onnx_models import HEIGHT, WIDTH, make_card, save_spot_model

SIZES = [(1536, 1024), (1024, 1536), (2000, 251), (333, 1999), (60, 50), (WIDTH, HEIGHT)]


def draw_spots(width: int, height: int, seed: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """A black photograph with a red and a green spot, and their centres (2: red, green; x, y)."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width, 3), dtype=np.uint8)
    # Gaussians of 1.5 px of the input: resampling would shift sharp edges.
    sigma = 1.5 * max(1.0, width / WIDTH, height / HEIGHT)
    centres = []
    for channel in (2, 1):
        x, y = (float(rng.uniform(3.3 * sigma, max(side - 3.3 * sigma, 3.3 * sigma + 1))) for side in (width, height))
        bells = [np.exp(-((np.arange(n) + 0.5 - c) ** 2) / (2 * sigma**2)) for n, c in ((height, y), (width, x))]
        image[..., channel] = np.round(255 * np.outer(*bells))
        centres.append((x, y))
    return image, np.array(centres)


def make_detector(
    path: Path, *, resize: str = "letterbox_corner", batch: int | str = "n", **changes: object
) -> OnnxDetector:
    content = make_card("nms6", **{"score_threshold": 0.01, **changes})
    content["input"] = {**content["input"], "resize": resize, "pad_value": 0}
    return OnnxDetector(save_spot_model(path, batch=batch), ModelCard.model_validate(content))


def compute_centre(found: DetectedBox) -> tuple[float, float]:
    return found.box.x_px + found.box.width_px / 2, found.box.y_px + found.box.height_px / 2


@pytest.mark.parametrize("resize", list(ResizeMode))
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_spots_are_found_to_half_a_pixel(tmp_path: Path, resize: str, width: int, height: int) -> None:
    finder = make_detector(tmp_path / "spots.onnx", resize=resize)
    for seed in range(2):
        image, drawn = draw_spots(width, height, seed)
        by_name = {found.class_name: compute_centre(found) for found in finder.detect(image)}
        assert by_name["crack"] == pytest.approx(drawn[0], rel=0, abs=0.5)  # px of the photograph
        assert by_name["car"] == pytest.approx(drawn[1], rel=0, abs=0.5)  # px of the photograph


@pytest.mark.parametrize(("batch", "together"), [("n", True), (1, False)])
def test_a_batch_equals_single_photographs(tmp_path: Path, batch: int | str, together: bool) -> None:
    finder = make_detector(tmp_path / "spots.onnx", batch=batch, resize="letterbox_centre")
    assert finder.supports_batches is together
    images = [draw_spots(width, height, seed)[0] for seed, (width, height) in enumerate(SIZES)]
    alone = tuple(finder.detect(image) for image in images)
    assert finder.detect_batch(images) == alone
    assert len({found for one in alone for found in one}) == 2 * len(images)
    assert finder.detect_batch([]) == ()
    assert finder.detect_batch(images[:1]) == alone[:1]


def test_a_view_of_a_photograph_needs_no_copy(tmp_path: Path) -> None:
    finder = make_detector(tmp_path / "spots.onnx")
    image, drawn = draw_spots(400, 300, 3)
    left, top = (int(side) for side in np.clip(drawn.min(axis=0) - 20, 0, (400 - WIDTH, 300 - HEIGHT)))
    tile = image[top : top + HEIGHT, left : left + WIDTH]
    assert not tile.flags.c_contiguous
    assert finder.detect(tile) == finder.detect(tile.copy())


def test_a_graph_whose_batches_fail_is_run_one_by_one(tmp_path: Path) -> None:
    path = save_spot_model(tmp_path / "spots.onnx", batch="n")
    model = onnx.load(path)
    # A static reshape in an export can return the first image of a batch for all.
    (last,) = [node for node in model.graph.node if "output" in node.output]
    last.output[0] = "per image"
    model.graph.initializer.append(helper.make_tensor("only first", TensorProto.INT64, [1], [0]))
    model.graph.node.append(helper.make_node("Gather", ["per image", "only first"], ["output"], axis=0))
    onnx.save(model, path)
    finder = OnnxDetector(path, ModelCard.model_validate(make_card("nms6", score_threshold=0.01)))
    assert not finder.supports_batches
    images = [draw_spots(WIDTH, HEIGHT, seed)[0] for seed in (1, 2)]
    assert finder.detect_batch(images) == (finder.detect(images[0]), finder.detect(images[1]))


def test_calibrated_scores_and_their_threshold(tmp_path: Path) -> None:
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    image[10:20, 10:20, 2] = 204  # score 0.8, logit ln 4
    image[30:40, 30:40, 1] = 51  # score 0.2, logit -ln 4
    line = {"slope": 0.5, "intercept": -np.log(2)}
    plain = make_detector(tmp_path / "spots.onnx").detect(image)
    assert [found.score for found in plain] == pytest.approx([0.8, 0.2], rel=0, abs=1e-6)
    # 0.5 * ln 4 - ln 2 = 0, so 1/2; 0.5 * -ln 4 - ln 2 = -ln 4, so 1/5.
    found = make_detector(tmp_path / "spots.onnx", score_calibration=line).detect(image)
    assert [one.score for one in found] == pytest.approx([0.5, 0.2], rel=0, abs=1e-6)
    strict = make_detector(tmp_path / "spots.onnx", score_calibration=line, score_threshold=0.49).detect(image)
    assert [one.class_name for one in strict] == ["crack"]
    stricter = make_detector(tmp_path / "spots.onnx", score_calibration=line, score_threshold=0.51).detect(image)
    assert stricter == ()


def test_the_shipped_model_gives_the_same_in_a_batch() -> None:
    model = Path(__file__).parents[3] / "data" / "detector" / "facadelake-nano.onnx"
    everything = find_card(model).model_copy(update={"score_threshold": 0.0, "nms_iou": 1.0, "max_detections": 50})
    shipped = OnnxDetector(model, everything, threads=1)
    assert shipped.supports_batches
    images = []
    for seed in range(2):
        wall = np.random.default_rng(seed).normal(150, 12, (300, 500, 3)).clip(0, 255).astype(np.uint8)
        cv2.line(wall, (40 + 90 * seed, 0), (300, 299), (45, 45, 45), 3 + seed)
        images.append(wall)
    alone = [[found.score for found in shipped.detect(image)] for image in images]
    together = [[found.score for found in one] for one in shipped.detect_batch(images)]
    assert [len(scores) for scores in alone] == [50, 50]
    assert alone[0] != pytest.approx(alone[1], rel=0, abs=1e-3)
    for one, other in zip(alone, together, strict=True):
        assert one == pytest.approx(other, rel=0, abs=1e-3)
