"""Reviews outlive a new run: they are matched with its detections by photograph, class and overlap."""

import numpy as np
import pytest

from facadelake.reviews.box_matching import compute_iou, corners_from_boxes, pair_greedily
from facadelake.reviews.review import Review
from facadelake.reviews.review_items import create_review
from facadelake.reviews.review_matching import ReviewStatus, match_reviews
from schemas.vocabulary import Verdict
from tests.unit.reviews.made_reviews import CRACK, NEW_MODEL, PROVENANCE, box, seen, unreviewed

FOUND = (
    ("p0.jpg", "crack", box(100, 100)),
    ("p0.jpg", "crack", box(600, 100)),
    ("p1.jpg", "spalling", box(50, 50, 300, 300)),
)
PLACES = unreviewed(*FOUND)


def matches_by_subject(status: ReviewStatus) -> dict[str, str | None]:
    return {one.review.subject: None if one.detection is None else one.detection.detection_id for one in status.current}


def made_reviews(*verdicts: Verdict) -> tuple[Review, ...]:
    return tuple(create_review(place, verdict, PROVENANCE) for place, verdict in zip(PLACES, verdicts, strict=False))


def test_same_run_is_matched_by_id() -> None:
    status = match_reviews(made_reviews(Verdict.CONFIRMED, Verdict.REJECTED), seen(*FOUND))
    assert set(matches_by_subject(status).values()) == {"p0.jpg#1", "p0.jpg#2"}
    assert [one.detection_id for one in status.unreviewed] == ["p1.jpg#3"]
    assert status.unmatched == ()


def test_a_new_model_renumbers_and_reviews_follow_the_boxes() -> None:
    moved = seen(
        ("p1.jpg", "spalling", box(60, 60, 300, 300)),  # 88 % of both
        ("p0.jpg", "crack", box(610, 100)),
        model=NEW_MODEL,
    )
    status = match_reviews(made_reviews(*[Verdict.CONFIRMED] * 3), moved)
    assert matches_by_subject(status) == {
        PLACES[0].subject: None,
        PLACES[1].subject: "p0.jpg#2",
        PLACES[2].subject: "p1.jpg#1",
    }
    assert [review.subject for review in status.unmatched] == [PLACES[0].subject]
    assert status.unreviewed == ()


def test_an_id_alone_is_no_match_and_another_class_neither() -> None:
    elsewhere = seen(("p0.jpg", "crack", box(900, 900)), ("p0.jpg", "moisture", box(600, 100)), model=NEW_MODEL)
    status = match_reviews(made_reviews(Verdict.REJECTED, Verdict.REJECTED), elsewhere)
    assert set(matches_by_subject(status).values()) == {None}
    assert len(status.unreviewed) == 2


def test_corrected_box_matches_a_model_that_learned_it() -> None:
    place = PLACES[0]
    moved = create_review(place, Verdict.CORRECTED, PROVENANCE, box=box(150, 100, 220, 60), defect_class=CRACK)
    learned = seen(("p0.jpg", "crack", box(155, 102, 215, 58)), model=NEW_MODEL)
    assert matches_by_subject(match_reviews((moved,), learned)) == {place.subject: "p0.jpg#1"}
    assert match_reviews((moved,), seen(*FOUND)).current[0].detection is not None


def test_overlaps_by_hand() -> None:
    share = compute_iou(
        corners_from_boxes([box(0, 0, 10, 10)]),
        corners_from_boxes([box(5, 0, 10, 10), box(10, 0, 5, 5), box(0, 0, 10, 10)]),
    )
    np.testing.assert_allclose(share, [[50 / 150, 0.0, 1.0]], rtol=0, atol=1e-12)
    assert compute_iou(corners_from_boxes([]), corners_from_boxes([box(0, 0)])).shape == (0, 1)


def test_each_box_is_matched_once_the_best_first() -> None:
    first, second = [box(0, 0, 10, 10), box(2, 0, 10, 10)], [box(2, 0, 10, 10), box(50, 50, 5, 5)]
    (pair,) = pair_greedily(compute_iou(corners_from_boxes(first), corners_from_boxes(second)), 0.1)
    assert (pair.first, pair.second) == (1, 0)
    assert pair.score == pytest.approx(1.0, abs=1e-12)
