"""The detector that is shipped: loads by its card, is small, finds a drawn crack and is quiet on plain walls."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from facadelake.core.hashing import hash_file
from facadelake.detection.inference.detector import OnnxDetector, load_detector
from facadelake.detection.model_registry import MODELS_FOLDER, SHIPPED_MODEL
from facadelake.detection.tiling.tiled_detection import detect_image
from training.data.sample import CLASSES

MODEL = MODELS_FOLDER / SHIPPED_MODEL
LOOSE_PX = 10.0  # people draw boxes of cracks so


@pytest.fixture(scope="module")
def detector() -> OnnxDetector:
    return load_detector(MODEL, threads=1)


def _wall(seed: int, side_px: int = 416) -> np.ndarray:
    """Plaster of one tone with soft stains and grain."""
    rng = np.random.default_rng(seed)
    stains = cv2.GaussianBlur(rng.normal(0, 1, (side_px, side_px)).astype(np.float32), (0, 0), 40) * 200
    grain = cv2.GaussianBlur(rng.normal(0, 9, (side_px, side_px)).astype(np.float32), (0, 0), 0.8)
    tone = rng.uniform(120, 200) + stains + grain
    return np.clip(tone[..., None] * rng.uniform(0.92, 1.0, 3), 0, 255).astype(np.uint8)


def _cracked(seed: int) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """A wall with a crack of 2 to 4 px that wanders from side to side; its box as drawn by hand."""
    image = _wall(seed)
    rng = np.random.default_rng(100 + seed)
    x = np.linspace(-5, 421, 90)
    y = 208 + np.cumsum(rng.normal(0, 5, 90))
    points = np.column_stack([x, y - y.mean() + 208])
    for start, end in pairwise(points):
        ends = [tuple(np.round(p * 16).astype(int).tolist()) for p in (start, end)]
        cv2.line(image, ends[0], ends[1], (48, 50, 55), int(rng.integers(2, 5)), cv2.LINE_AA, 4)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    return image, (0.0, float(points[:, 1].min()) - LOOSE_PX, 416.0, float(points[:, 1].max()) + LOOSE_PX)


def test_it_is_small_and_its_card_names_its_hash() -> None:
    assert MODEL.stat().st_size <= 15_000_000
    assert hash_file(MODEL) in MODEL.with_suffix(".card.yaml").read_text(encoding="utf-8")


def test_its_card_says_what_it_learned_from(detector: OnnxDetector) -> None:
    card = detector.card
    assert card.class_names == tuple(str(name) for name in CLASSES)
    assert card.licence == "Apache-2.0"
    assert any("CC BY-SA" in line for line in card.training_data)
    assert detector.supports_batches


def test_it_finds_drawn_cracks(detector: OnnxDetector) -> None:
    hits = 0
    for seed in range(8):
        image, (left, top, right, bottom) = _cracked(seed)
        for one in detect_image(detector, image):
            box = one.box
            wide = max(0.0, min(right, box.x_px + box.width_px) - max(left, box.x_px))
            high = max(0.0, min(bottom, box.y_px + box.height_px) - max(top, box.y_px))
            union = (right - left) * (bottom - top) + box.width_px * box.height_px - wide * high
            if one.class_name == "crack" and wide * high / union >= 0.5:
                hits += 1
                break
    assert hits >= 7  # of 8


def test_it_is_quiet_on_plain_walls(detector: OnnxDetector) -> None:
    assert sum(len(detect_image(detector, _wall(seed))) for seed in range(50, 62)) <= 1
