"""Calibration, false alarms and resampling against figures known beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from facadelake.core.errors import InputDataError
from facadelake.evaluation.detectors.average_precision import compute_average_precision, match_predictions
from facadelake.evaluation.detectors.bootstrap import estimate_interval
from facadelake.evaluation.detectors.calibration import compute_calibration
from facadelake.evaluation.detectors.false_alarms import compute_false_alarms
from facadelake.evaluation.detectors.operating_point import compute_recall_by_size
from tests.unit.evaluation.detectors.labelled import CRACK, MOISTURE, guess, image

HERE, THERE = (10.0, 10.0, 20.0, 20.0), (60.0, 40.0, 20.0, 20.0)


def test_calibration_by_hand() -> None:
    # At 0.9 nine of ten hit, at 0.15 none of two: errors 0 and 0.15.
    images = [image(f"{i}", HERE) for i in range(10)]
    found = {f"{i}": (guess(0.9, HERE if i else THERE),) for i in range(10)}
    for key in ("0", "1"):
        found[key] = (*found[key], guess(0.15, THERE if key == "1" else (80.0, 5.0, 10.0, 10.0)))
    calibration = compute_calibration(match_predictions(images, found, CRACK), 0.5)
    assert calibration.count == 12 and calibration.count_shown == 10
    assert calibration.ece == pytest.approx(2 / 12 * 0.15, abs=1e-12)
    assert calibration.ece_shown == pytest.approx(0.0, abs=1e-12)
    assert calibration.expected_precision == pytest.approx(0.9) == calibration.precision_shown
    assert [(one.low, one.count, one.precision) for one in calibration.bins] == [(0.1, 2, 0.0), (0.9, 10, 0.9)]


def test_a_score_of_one_lies_in_the_last_bin() -> None:
    calibration = compute_calibration(match_predictions([image("one", HERE)], {"one": (guess(1.0, HERE),)}, CRACK), 0.5)
    assert [(one.high, one.count) for one in calibration.bins] == [(1.0, 1)] and calibration.ece == 0


def test_nothing_found_has_no_calibration() -> None:
    calibration = compute_calibration(match_predictions([image("one", HERE)], {"one": ()}, CRACK), 0.5)
    assert (calibration.count, calibration.ece, calibration.expected_precision) == (0, None, None)


def test_false_alarms_by_hand() -> None:
    images = [image("one", area_m2=30.0), image("two", area_m2=70.0), image("three", area_m2=100.0)]
    low = {
        "one": (guess(0.9, HERE), guess(0.6, THERE, MOISTURE), guess(0.12, THERE)),
        "two": (guess(0.7, HERE),),
        "three": (),
    }
    shown = {key: tuple(one for one in found if one.score >= 0.5) for key, found in low.items()}
    alarms = compute_false_alarms("walls", images, shown, low)
    every, crack, spalling, moisture = alarms.rates
    assert every.count == 3 and every.with_one == 2 and every.area_m2 == pytest.approx(200.0)
    assert every.per_10_m2 == pytest.approx(0.15) and crack.per_10_m2 == pytest.approx(0.1)
    assert spalling.count == 0 and moisture.per_10_m2 == pytest.approx(0.05)
    # Poisson, 3 counted: 0.619 to 8.77 (tables of Garwood); none counted: up to 3.689.
    assert every.low_per_10_m2 is not None and every.low_per_10_m2 <= 0.619 / 20
    assert every.high_per_10_m2 is not None and every.high_per_10_m2 >= 8.767 / 20
    assert spalling.low_per_10_m2 == 0 and spalling.high_per_10_m2 == pytest.approx(3.689 / 20, abs=1e-3)
    at = {one.score: one.count for one in alarms.by_threshold}
    assert (at[0.1], at[0.15], at[0.6], at[0.65], at[0.9], at[0.95]) == (4, 3, 3, 2, 1, 0)


def test_without_every_area_there_is_no_rate() -> None:
    images = [image("one", area_m2=30.0), image("two")]
    found = {"one": (guess(0.9, HERE),), "two": ()}
    rate = compute_false_alarms("walls", images, found, found).rates[0]
    assert rate.count == 1 and rate.area_m2 is None and rate.per_10_m2 is None and rate.high_per_10_m2 is None


def test_resampling_sites_is_wider_than_resampling_their_photographs() -> None:
    # Three sites of twenty photographs each, found wholly, by half, and not at all: the site decides.
    images = [image(f"{s}-{i}", HERE, site=f"{s}") for s in range(3) for i in range(20)]
    found = {
        one.key: (guess(0.5 + 0.001 * i, HERE if one.site == "0" or (one.site == "1" and i % 2) else THERE),)
        for i, one in enumerate(images)
    }
    matches = match_predictions(images, found, CRACK)

    def figure(weights: np.ndarray) -> float:
        return float(compute_average_precision(matches, weights)[0])

    by_site = estimate_interval(images, figure, by_site=True, draws=200)
    by_photograph = estimate_interval(images, figure, by_site=False, draws=200)
    assert by_site is not None and by_photograph is not None
    assert (by_site.groups, by_site.unit, by_photograph.groups, by_photograph.unit) == (3, "site", 60, "photograph")
    assert by_site.high - by_site.low > 2 * (by_photograph.high - by_photograph.low)
    whole = figure(np.ones(60))
    assert by_photograph.low < whole < by_photograph.high and by_site.low <= whole <= by_site.high


def test_one_site_says_nothing_of_others() -> None:
    images = [image(f"{i}", HERE, site="one") for i in range(5)]
    assert estimate_interval(images, lambda weights: float(weights.sum()), by_site=True) is None


def test_no_photographs_are_refused() -> None:
    with pytest.raises(InputDataError, match="none of the photographs without defects"):
        compute_false_alarms("walls", [], {}, {})


def test_recall_by_size_by_hand() -> None:
    """Twelve boxes of 8 px of which three are found, twelve of 20 px of which eleven are, four of 40 px, all found."""
    sizes = [8.0] * 12 + [20.0] * 12 + [40.0] * 4
    found = [i < 3 or i >= 13 for i in range(28)]
    boxes = [(10.0, 10.0, side, side) for side in sizes]
    images = [image(f"{i:02d}", box) for i, box in enumerate(boxes)]
    shown = {
        f"{i:02d}": (guess(0.9, box),) if known else () for i, (box, known) in enumerate(zip(boxes, found, strict=True))
    }
    small, large = compute_recall_by_size(match_predictions(images, shown, CRACK))
    assert (small.size_px, small.recall, small.truths) == (8.0, 0.25, 12)
    # Four boxes are too few for a range of their own.
    assert (large.size_px, large.recall, large.truths) == (20.0, 15 / 16, 16)


def test_few_boxes_have_no_recall_by_size() -> None:
    images = [image(f"{i}", HERE) for i in range(9)]
    shown = {f"{i}": (guess(0.9, HERE),) for i in range(9)}
    assert compute_recall_by_size(match_predictions(images, shown, CRACK)) == ()
    assert compute_recall_by_size(match_predictions(images, shown, MOISTURE)) == ()
