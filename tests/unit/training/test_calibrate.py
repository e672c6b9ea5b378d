"""Calibration line, figures by score threshold, and the card."""

from __future__ import annotations

import numpy as np
import pytest

from facadelake.detection.card import OutputLayout, calibrate_scores, format_card, parse_card
from training.calibrate import MatchedDetections, create_card, fit_platt_line


def test_the_line_that_generated_the_hits_is_found() -> None:
    rng = np.random.default_rng(0)
    score = rng.uniform(0.02, 0.98, 20_000)
    right = 1 / (1 + np.exp(-(1.8 * np.log(score / (1 - score)) - 0.7)))
    line = fit_platt_line(score, rng.random(20_000) < right)
    assert line.slope == pytest.approx(1.8, abs=0.1)
    assert line.intercept == pytest.approx(-0.7, abs=0.1)
    calibrated = calibrate_scores(score.astype(np.float32), line)
    assert np.abs(calibrated - right).max() < 0.03  # of probability


def test_f1_and_false_boxes_count_detections_above_the_threshold() -> None:
    detections = MatchedDetections(
        score=np.array([0.9, 0.8, 0.6, 0.3]),
        hit=np.array([True, False, True, True]),
        kind=np.array([0, 0, 0, 1]),
        truths=np.array([3, 1, 0]),
        sound=np.array([False, True, False, False]),
        sound_pictures=2,
    )
    assert detections.compute_f1(0.85) == pytest.approx((2 * 1 / (1 + 3) + 0) / 2)
    assert detections.compute_f1(0.2) == pytest.approx((2 * 2 / (3 + 3) + 1) / 2)
    assert detections.compute_false_box_rate(0.5) == pytest.approx(0.5)
    assert detections.compute_false_box_rate(0.85) == 0


def test_the_card_can_be_read_again() -> None:
    card = create_card("facadelake-nano", nms_iou=0.6)
    again = parse_card(format_card(card), "test")
    assert again == card
    assert again.output.layout is OutputLayout.YOLOX and again.input.width_px == 416
