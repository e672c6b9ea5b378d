"""The current reviews of a campaign matched with its detections, which another run or model may have changed."""

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

# Below this IoU a box of a later run may show another defect than the reviewed box.
MATCH_IOU_MIN = 0.5
_UNCHANGED_IOU_MIN = 0.98  # equal ids mean the same detection only where the boxes are equal, too


@dataclass(frozen=True, kw_only=True)
class AcceptedDetection:
    """An accepted row of table ``detections``; ``box`` in px of the photograph, ``mask`` is WKT in the same pixels."""

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
    """The current review of a subject and the detection that it applies to; None where no detection matches."""

    review: Review
    detection: AcceptedDetection | None


@dataclass(frozen=True, kw_only=True)
class ReviewStatus:
    """The current reviews of a campaign, and its detections without a review."""

    current: tuple[MatchedReview, ...]
    unreviewed: tuple[AcceptedDetection, ...]

    @property
    def unmatched(self) -> tuple[Review, ...]:
        """Reviews of detections that the campaign no longer has. A review of a missed defect has no detection."""
        return tuple(
            matched.review
            for matched in self.current
            if matched.detection is None and matched.review.reviewed_box is not None
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
    """Match the current ones of ``reviews`` (sorted by time) with ``detections``.

    A review applies to the detection that was reviewed where that is unchanged. After another run or with another model
    it applies to the detection of the reviewed or corrected class in the same photograph that overlaps most with the
    reviewed or the corrected box (IoU of 0.5 or more).
    """
    current = select_current_reviews(reviews)
    detection_by_index: dict[int, AcceptedDetection] = {}
    reviewed_ids: set[str] = set()
    detections_by_photo: dict[str, list[AcceptedDetection]] = defaultdict(list)
    for detection in detections:
        detections_by_photo[detection.photo_id].append(detection)
    indices_by_photo: dict[str, list[int]] = defaultdict(list)
    for index, review in enumerate(current):
        indices_by_photo[review.photo_id].append(index)
    for photo_id, indices in indices_by_photo.items():
        candidates = detections_by_photo.get(photo_id, [])
        for pair in pair_greedily(_score_matches([current[i] for i in indices], candidates), MATCH_IOU_MIN):
            detection_by_index[indices[pair.first]] = candidates[pair.second]
            reviewed_ids.add(candidates[pair.second].detection_id)
    return ReviewStatus(
        current=tuple(
            MatchedReview(review=review, detection=detection_by_index.get(index))
            for index, review in enumerate(current)
        ),
        unreviewed=tuple(one for one in detections if one.detection_id not in reviewed_ids),
    )


def _score_matches(reviews: Sequence[Review], detections: Sequence[AcceptedDetection]) -> Float64Array:
    """Scores of reviews (rows) against the detections of their photograph (columns): IoU, 2 for the same detection, 0
    for another class."""
    boxes = corners_from_boxes(detection.box for detection in detections)
    reviewed_iou = compute_iou(
        corners_from_boxes(review.reviewed_box or review.effective_box for review in reviews), boxes
    )
    scores = np.maximum(
        reviewed_iou, compute_iou(corners_from_boxes(review.effective_box for review in reviews), boxes)
    )
    for i, review in enumerate(reviews):
        for j, detection in enumerate(detections):
            if detection.defect_class not in (review.reviewed_class, review.defect_class):
                scores[i, j] = 0.0
            elif (review.detection_id, review.detector_sha256) == (detection.detection_id, detection.detector_sha256):
                scores[i, j] = 2.0 if reviewed_iou[i, j] >= _UNCHANGED_IOU_MIN else scores[i, j]
    return scores
