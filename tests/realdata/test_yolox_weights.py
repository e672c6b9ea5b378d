"""Published YOLOX weights find what is plainly to be seen in real photographs, where it is to be seen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from facadelake.core.errors import ModelError
from facadelake.detection.card import ModelCard
from facadelake.detection.inference.detector import DetectedBox, OnnxDetector

pytestmark = pytest.mark.realdata

# COCO's eighty classes; those that the assertions name, at their indices.
NAMES = [f"coco {i}" for i in range(80)]
NAMES[0], NAMES[2], NAMES[7], NAMES[74] = "person", "car", "truck", "clock"

STREET = "drone/lund_street/26.jpg"


def card(layout: str = "yolox", names: list[str] = NAMES) -> ModelCard:
    size = {"width_px": 416, "height_px": 416}
    return ModelCard.model_validate(
        {
            "name": "yolox-nano-coco",
            "licence": "Apache-2.0",
            "class_names": names,
            "input": {**size, "colour": "bgr", "scale": 1.0, "resize": "letterbox_corner"},
            "output": {"layout": layout},
            "score_threshold": 0.45,
        }
    )


@pytest.fixture(scope="module")
def weights(shared_data: Path) -> Path:
    path = shared_data / "weights" / "yolox_nano_coco" / "yolox_nano.onnx"
    if not path.is_file():
        pytest.skip(f"no weights at {path}")
    return path


def overlap(found: DetectedBox, left: float, top: float, right: float, bottom: float) -> float:
    """Intersection over union with a box drawn by a person."""
    box = found.box
    wide = min(box.x_px + box.width_px, right) - max(box.x_px, left)
    high = min(box.y_px + box.height_px, bottom) - max(box.y_px, top)
    both = max(wide, 0.0) * max(high, 0.0)
    return both / (box.width_px * box.height_px + (right - left) * (bottom - top) - both)


@pytest.mark.parametrize(
    ("photograph", "name", "person_saw"),
    [
        # The tractor in the yard and the arched window that looks like a clock; two parked cars in a street.
        ("castle/images/multiview/IMG_0005.JPG", "truck", (1575, 1420, 2185, 1970)),
        ("castle/images/closerange/IMG_0024.JPG", "clock", (1740, 500, 2060, 720)),
        (STREET, "car", (0, 422, 340, 648)),
        (STREET, "car", (352, 424, 470, 505)),
    ],
)
def test_everyday_objects_are_found_in_place(
    weights: Path, shared_data: Path, photograph: str, name: str, person_saw: tuple[float, float, float, float]
) -> None:
    image = cv2.imread(str(shared_data / photograph))
    found = [f for f in OnnxDetector(weights, card()).detect(image) if f.class_name == name]
    assert max(overlap(f, *person_saw) for f in found) > 0.7


def test_a_photograph_moved_moves_its_boxes(weights: Path, shared_data: Path) -> None:
    image = cv2.imread(str(shared_data / STREET))
    height, width = image.shape[:2]
    wider = np.full((height + 200, width + 300, 3), 114, dtype=np.uint8)
    wider[200:, 300:] = image
    cars = [f for f in OnnxDetector(weights, card()).detect(wider) if f.class_name == "car"]
    assert max(overlap(f, 300, 622, 640, 848) for f in cars) > 0.7


def test_the_weights_under_another_declaration_are_refused(weights: Path) -> None:
    # Raw outputs read as pixels: the shape fits, the values do not.
    with pytest.raises(ModelError, match=r"read as layout yolov5, reach 0.0\d+ times .* fit layout yolox"):
        OnnxDetector(weights, card("yolov5"))
    with pytest.raises(ModelError, match=r"shape \(1, 3549, 85\), layout yolox with 3 classes .* has \(1, 3549, 8\)"):
        OnnxDetector(weights, card(names=["crack", "spalling", "moisture"]))
    with pytest.raises(ModelError, match=r"fit layout yolox"):
        OnnxDetector(weights, card("yolov8"))
