"""Words outlive a new run: they are met with its detections by photograph, class and overlap."""

import numpy as np
import pytest

from facadelake.reviews.box_matching import compute_iou, corners_from_boxes, matched
from facadelake.reviews.review import Review
from facadelake.reviews.review_items import create_review
from facadelake.reviews.review_matching import ReviewStatus, match_reviews
from schemas.vocabulary import Verdict
from tests.unit.reviews.made_reviews import CRACK, NEW_MODEL, SAID, box, seen, unreviewed

FOUND = (
    ("p0.jpg", "crack", box(100, 100)),
    ("p0.jpg", "crack", box(600, 100)),
    ("p1.jpg", "spalling", box(50, 50, 300, 300)),
)
PLACES = unreviewed(*FOUND)


def fates(judgement: ReviewStatus) -> dict[str, str | None]:
    return {
        one.review.subject: None if one.detection is None else one.detection.detection_id for one in judgement.current
    }


def words(*verdicts: Verdict) -> tuple[Review, ...]:
    return tuple(create_review(place, verdict, SAID) for place, verdict in zip(PLACES, verdicts, strict=False))


def test_same_run_is_met_by_id() -> None:
    judgement = match_reviews(words(Verdict.CONFIRMED, Verdict.REJECTED), seen(*FOUND))
    assert set(fates(judgement).values()) == {"p0.jpg#1", "p0.jpg#2"}
    assert [one.detection_id for one in judgement.unreviewed] == ["p1.jpg#3"]
    assert judgement.unmatched == ()


def test_a_new_model_numbers_anew_and_words_follow_the_places() -> None:
    moved = seen(
        ("p1.jpg", "spalling", box(60, 60, 300, 300)),  # 88 % of both
        ("p0.jpg", "crack", box(610, 100)),
        model=NEW_MODEL,
    )
    judgement = match_reviews(words(*[Verdict.CONFIRMED] * 3), moved)
    assert fates(judgement) == {
        PLACES[0].subject: None,
        PLACES[1].subject: "p0.jpg#2",
        PLACES[2].subject: "p1.jpg#1",
    }
    assert [word.subject for word in judgement.unmatched] == [PLACES[0].subject]
    assert judgement.unreviewed == ()


def test_an_id_alone_is_no_match_and_another_class_neither() -> None:
    elsewhere = seen(("p0.jpg", "crack", box(900, 900)), ("p0.jpg", "moisture", box(600, 100)), model=NEW_MODEL)
    judgement = match_reviews(words(Verdict.REJECTED, Verdict.REJECTED), elsewhere)
    assert set(fates(judgement).values()) == {None}
    assert len(judgement.unreviewed) == 2


def test_corrected_box_meets_a_model_that_learned_it() -> None:
    place = PLACES[0]
    moved = create_review(place, Verdict.CORRECTED, SAID, box=box(150, 100, 220, 60), defect_class=CRACK)
    learned = seen(("p0.jpg", "crack", box(155, 102, 215, 58)), model=NEW_MODEL)
    assert fates(match_reviews((moved,), learned)) == {place.subject: "p0.jpg#1"}
    assert match_reviews((moved,), seen(*FOUND)).current[0].detection is not None


def test_overlaps_by_hand() -> None:
    share = compute_iou(
        corners_from_boxes([box(0, 0, 10, 10)]),
        corners_from_boxes([box(5, 0, 10, 10), box(10, 0, 5, 5), box(0, 0, 10, 10)]),
    )
    np.testing.assert_allclose(share, [[50 / 150, 0.0, 1.0]], rtol=0, atol=1e-12)
    assert compute_iou(corners_from_boxes([]), corners_from_boxes([box(0, 0)])).shape == (0, 1)


def test_each_box_is_matched_once_the_best_first() -> None:
    ones, others = [box(0, 0, 10, 10), box(2, 0, 10, 10)], [box(2, 0, 10, 10), box(50, 50, 5, 5)]
    (pair,) = matched(ones, others, 0.1)
    assert (pair.one, pair.other) == (1, 0)
    assert pair.overlap == pytest.approx(1.0, abs=1e-12)
