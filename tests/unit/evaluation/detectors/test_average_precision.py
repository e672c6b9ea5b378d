"""Average precision against rankings worked out by hand, and against pycocotools where weights are one."""

from __future__ import annotations

import numpy as np
import pytest

from facadelake.evaluation.detectors.average_precision import (
    PredictionMatches,
    compute_average_precision,
    match_predictions,
)
from facadelake.evaluation.detectors.labels.labels import LabelledImage
from facadelake.evaluation.detectors.operating_point import (
    compute_operating_point,
    count_confusions,
    sum_operating_points,
)
from facadelake.evaluation.detectors.predictions import Prediction
from tests.unit.evaluation.detectors.labelled import CRACK, MOISTURE, SPALLING, Corner, guess, image

A, B, C = (10.0, 10.0, 20.0, 20.0), (50.0, 10.0, 20.0, 20.0), (10.0, 50.0, 20.0, 20.0)
NOWHERE = (75.0, 55.0, 10.0, 10.0)


def both(matches: PredictionMatches) -> np.ndarray:
    """Our average precision, after making sure that pycocotools' is the same."""
    ours = compute_average_precision(matches)
    np.testing.assert_allclose(ours, matches.coco_precision, rtol=0, atol=1e-12)
    return ours


def test_a_ranking_by_hand() -> None:
    # Right, wrong, right, and one truth never found. Recall 1/3 at precision 1, 2/3 at 2/3, then nothing.
    images = [image("one", A, B, C)]
    found = {"one": (guess(0.9, A), guess(0.8, NOWHERE), guess(0.7, B))}
    expected = (34 * 1.0 + 33 * 2 / 3) / 101  # recalls 0.00 to 0.33 and 0.34 to 0.66 of 101
    assert both(match_predictions(images, found, CRACK))[0] == pytest.approx(expected, abs=1e-12)


def test_a_perfect_detector_has_one_and_a_shifted_one_zero() -> None:
    images = [image("one", A, B), image("two", C), image("empty")]
    perfect = {one.key: tuple(guess(0.9, tuple(vars(b.box).values())) for b in one.boxes) for one in images}
    shifted = {key: tuple(guess(0.9, (g.box.x_px + 15, g.box.y_px, 20, 20)) for g in gs) for key, gs in perfect.items()}
    np.testing.assert_allclose(both(match_predictions(images, perfect, CRACK)), 1.0, rtol=0, atol=1e-12)
    assert (both(match_predictions(images, shifted, CRACK)) == 0).all()  # an IoU of 1/7


@pytest.mark.parametrize(("width", "reached"), [(10.0, 1), (9.9, 0), (15.0, 6), (14.9, 5), (20.0, 10)])
def test_an_overlap_of_exactly_the_threshold_is_a_hit(width: float, reached: int) -> None:
    # A guess of that width inside a truth 20 wide has an IoU of width / 20: hits at 0.50, 0.55, ... up to it.
    found = {"one": (guess(0.9, (10, 10, width, 20)),)}
    precision = both(match_predictions([image("one", A)], found, CRACK))
    assert (precision == 1).sum() == reached and (precision == 0).sum() == 10 - reached


def test_a_second_box_on_one_truth_is_a_false_alarm() -> None:
    found = {"one": (guess(0.9, A), guess(0.8, A))}
    counts = compute_operating_point(match_predictions([image("one", A, B)], found, CRACK))
    assert (counts.hits, counts.false_alarms, counts.misses) == (1, 1, 1)
    assert counts.precision == counts.recall == counts.f1 == 0.5


def test_ignored_truths_count_neither_way() -> None:
    images = [image("one", A, ignored=(B,))]
    found = {"one": (guess(0.95, B), guess(0.9, A))}
    matches = match_predictions(images, found, CRACK)
    np.testing.assert_allclose(both(matches), 1.0, rtol=0, atol=1e-12)
    counts = compute_operating_point(matches)
    assert (counts.hits, counts.false_alarms, counts.misses) == (1, 0, 0)
    assert compute_operating_point(match_predictions(images, {"one": ()}, CRACK)).misses == 1
    assert [(one.truth, one.shown, one.count) for one in count_confusions(images, found)] == [("crack", "crack", 1)]


def test_without_truth_there_is_no_precision() -> None:
    assert np.isnan(
        compute_average_precision(match_predictions([image("one")], {"one": (guess(0.9, A),)}, CRACK))
    ).all()
    assert np.isnan(compute_average_precision(match_predictions([], {}, CRACK))).all()
    none = compute_operating_point(match_predictions([image("one")], {"one": ()}, CRACK))
    assert none.precision is None and none.recall is None and none.f1 is None


def test_photographs_without_labels_of_a_class_do_not_judge_it() -> None:
    images = [image("cracks", A), image("spalls", B, defect_class=SPALLING, labelled=(SPALLING,))]
    found = {"cracks": (guess(0.9, A), guess(0.9, B, SPALLING)), "spalls": (guess(0.8, B, SPALLING), guess(0.9, C))}
    for one in (CRACK, SPALLING):
        matches = match_predictions(images, found, one)
        np.testing.assert_allclose(both(matches), 1.0, rtol=0, atol=1e-12)
        assert compute_operating_point(matches).false_alarms == 0
    counts_by_pair = {(one.truth, one.shown): one.count for one in count_confusions(images, found)}
    assert counts_by_pair == {("crack", "crack"): 1, ("spalling", "spalling"): 1}


def test_confusions_pair_the_same_class_first() -> None:
    both_classes = (CRACK, SPALLING)
    images = [image("one", A, B, labelled=both_classes)]
    found = {"one": (guess(0.9, A, SPALLING), guess(0.5, A), guess(0.4, B, SPALLING), guess(0.3, C, MOISTURE))}
    counts_by_pair = {(one.truth, one.shown): one.count for one in count_confusions(images, found)}
    assert counts_by_pair == {("crack", "crack"): 1, ("crack", "spalling"): 1, ("nothing", "spalling"): 1}


def random_set(seed: int) -> tuple[list[LabelledImage], dict[str, tuple[Prediction, ...]]]:
    """Twelve photographs of three sites with truths, jittered guesses and noise; some scores are equal."""
    random = np.random.default_rng(seed)

    def corner() -> Corner:
        x, y = random.uniform(0, 60, 2)
        w, h = random.uniform(8, 30, 2)
        return float(x), float(y), float(w), float(h)

    images, found = [], {}
    for i in range(12):
        truths = [corner() for _ in range(random.integers(0, 4))]
        images.append(image(f"{i}", *truths, site=f"site {i % 3}", ignored=(corner(),) if i % 4 == 0 else ()))
        near = [tuple(float(v) for v in np.array(t) + random.normal(0, 2.0, 4)) for t in truths]
        boxes = [*near, *(corner() for _ in range(3))]
        scored = [guess(round(float(random.uniform()), 1), one) for one in boxes]  # type: ignore[arg-type]
        found[f"{i}"] = tuple(sorted(scored, key=lambda g: -g.score))
    return images, found


@pytest.mark.parametrize("seed", range(4))
def test_our_accumulation_is_pycocotools(seed: int) -> None:
    images, found = random_set(seed)
    matches = match_predictions(images, found, CRACK)
    assert 0.05 < both(matches)[0] < 0.95
    # A site by weights is the site alone, and sites' counts add up to the whole.
    parts = []
    for site in ("site 0", "site 1", "site 2"):
        of_site = [one for one in images if one.site == site]
        weights = np.array([float(one.site == site) for one in images])
        alone = match_predictions(of_site, found, CRACK)
        np.testing.assert_allclose(
            compute_average_precision(matches, weights), alone.coco_precision, rtol=0, atol=1e-12
        )
        assert compute_operating_point(matches, weights) == compute_operating_point(alone)
        parts.append(compute_operating_point(alone))
    assert sum_operating_points(parts) == compute_operating_point(matches)
    # Twice every photograph changes nothing but the counts.
    twice = np.full(len(images), 2.0)
    np.testing.assert_allclose(
        compute_average_precision(matches, twice), compute_average_precision(matches), rtol=0, atol=1e-12
    )
    assert compute_operating_point(matches, twice).hits == 2 * compute_operating_point(matches).hits
    counts_by_pair = count_confusions(images, found)
    assert sum(one.count for one in counts_by_pair if one.shown == "nothing") == compute_operating_point(matches).misses


def test_only_the_best_of_a_photograph_count() -> None:
    found = {"one": (*(guess(0.9 - i / 1000, NOWHERE) for i in range(100)), guess(0.1, A))}
    assert both(match_predictions([image("one", A)], found, CRACK))[0] == 0
    assert both(match_predictions([image("one", A)], found, CRACK, boxes_max=101))[0] == pytest.approx(
        1 / 101, abs=1e-12
    )
