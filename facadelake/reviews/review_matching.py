"""What holds of a campaign's detections after all reviews: the last words, met with the detections there are now."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from facadelake.core.arrays import Float64Array
from facadelake.detection import Box
from facadelake.reviews.box_matching import compute_iou, corners_from_boxes, pair_greedily
from facadelake.reviews.review import Review, box_from_row, select_current_reviews
from schemas.vocabulary import DefectClass, DetectionOutcome

# A new run's box that shares less with the one that was judged may be another defect's.
MATCH_IOU_MIN = 0.5
_UNCHANGED_IOU_MIN = 0.98  # the same detection by its id, if the box is the same, too


@dataclass(frozen=True, kw_only=True)
class AcceptedDetection:
    """An accepted detection, as reviews look at it; ``mask`` is WKT."""

    detection_id: str
    photo_id: str
    defect_class: DefectClass
    score: float
    box: Box
    mask: str | None
    detector: str
    detector_sha256: str


@dataclass(frozen=True, kw_only=True)
class MatchedReview:
    """The last word on a subject and the detection that it is about now, None where there is none any more."""

    review: Review
    detection: AcceptedDetection | None


@dataclass(frozen=True, kw_only=True)
class ReviewStatus:
    """A campaign as reviewed: the words that count, and the detections that nobody has spoken of."""

    current: tuple[MatchedReview, ...]
    unreviewed: tuple[AcceptedDetection, ...]

    @property
    def unmatched(self) -> tuple[Review, ...]:
        """Words on detections that the campaign no longer has; a word on a missed defect needs none."""
        return tuple(
            one.review for one in self.current if one.detection is None and one.review.reviewed_box is not None
        )


def select_accepted_detections(detections: pa.Table) -> tuple[AcceptedDetection, ...]:
    """The accepted rows of table ``detections``."""
    return tuple(
        AcceptedDetection(
            detection_id=row["detection_id"],
            photo_id=row["photo_id"],
            defect_class=DefectClass(row["defect_class"]),
            score=row["score"],
            box=box,
            mask=row["mask"],
            detector=row["detector"],
            detector_sha256=row["detector_sha256"],
        )
        for row in detections.to_pylist()
        if row["detection_outcome"] == DetectionOutcome.ACCEPTED and (box := box_from_row(row)) is not None
    )


def match_reviews(reviews: Sequence[Review], detections: Sequence[AcceptedDetection]) -> ReviewStatus:
    """Meet the last words of ``reviews`` (in the order of time) with ``detections``.

    A word holds for the detection that it was about where that is unchanged; else, after another run or model, for the
    one of a fitting class in the same photograph that overlaps most with the box judged or drawn (0.5 or more).
    """
    words = select_current_reviews(reviews)
    met: dict[int, AcceptedDetection] = {}
    spoken: set[str] = set()
    by_photo: dict[str, list[AcceptedDetection]] = defaultdict(list)
    for one in detections:
        by_photo[one.photo_id].append(one)
    places: dict[str, list[int]] = defaultdict(list)
    for place, word in enumerate(words):
        places[word.photo_id].append(place)
    for photo_id, ours in places.items():
        there = by_photo.get(photo_id, [])
        for pair in pair_greedily(_score_matches([words[place] for place in ours], there), MATCH_IOU_MIN):
            met[ours[pair.first]] = there[pair.second]
            spoken.add(there[pair.second].detection_id)
    return ReviewStatus(
        current=tuple(MatchedReview(review=word, detection=met.get(place)) for place, word in enumerate(words)),
        unreviewed=tuple(one for one in detections if one.detection_id not in spoken),
    )


def _score_matches(words: Sequence[Review], there: Sequence[AcceptedDetection]) -> Float64Array:
    """How well each word (rows) fits each detection of its photograph: the overlap, 2 for the very one."""
    boxes = corners_from_boxes(one.box for one in there)
    judged = compute_iou(corners_from_boxes(word.reviewed_box or word.effective_box for word in words), boxes)
    fit = np.maximum(judged, compute_iou(corners_from_boxes(word.effective_box for word in words), boxes))
    for i, word in enumerate(words):
        for j, one in enumerate(there):
            if one.defect_class not in (word.reviewed_class, word.defect_class):
                fit[i, j] = 0.0
            elif (word.detection_id, word.detector_sha256) == (one.detection_id, one.detector_sha256):
                fit[i, j] = 2.0 if judged[i, j] >= _UNCHANGED_IOU_MIN else fit[i, j]
    return fit
