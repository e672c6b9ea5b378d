"""Reviewed photographs of a campaign: their defects, rejected boxes and detections without a review."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

from facadelake.detection import Box
from facadelake.detection.coco import polygons_from_wkt
from facadelake.reviews.review_matching import ReviewStatus
from schemas.vocabulary import DefectClass


@dataclass(frozen=True, kw_only=True)
class TrainingBox:
    """A confirmed, corrected or missed defect; ``box`` in px, ``mask`` a shapely polygon in the same pixels or None."""

    box: Box
    defect_class: DefectClass
    mask: Any | None = None


@dataclass(frozen=True, kw_only=True)
class ReviewedPhotograph:
    """A photograph with a review: its ``defects``, ``rejected`` boxes, and the boxes of ``unreviewed`` detections."""

    photo_id: str
    defects: tuple[TrainingBox, ...]
    rejected: tuple[Box, ...]
    unreviewed: tuple[Box, ...]


@dataclass
class _PhotographBoxes:
    defects: list[TrainingBox] = field(default_factory=list)
    rejected: list[Box] = field(default_factory=list)
    unreviewed: list[Box] = field(default_factory=list)


def collect_reviewed_photographs(status: ReviewStatus) -> tuple[ReviewedPhotograph, ...]:
    """The photographs with a review, sorted by photo_id."""
    photographs: dict[str, _PhotographBoxes] = defaultdict(_PhotographBoxes)
    for matched in status.current:
        review, boxes = matched.review, photographs[matched.review.photo_id]
        if review.box is None or review.defect_class is None:
            boxes.rejected.append(review.effective_box)
            continue
        mask = None if review.mask is None else polygons_from_wkt(review.mask)
        boxes.defects.append(TrainingBox(box=review.box, defect_class=review.defect_class, mask=mask))
    for detection in status.unreviewed:
        if detection.photo_id in photographs:
            photographs[detection.photo_id].unreviewed.append(detection.box)
    return tuple(
        ReviewedPhotograph(
            photo_id=photo_id,
            defects=tuple(boxes.defects),
            rejected=tuple(boxes.rejected),
            unreviewed=tuple(boxes.unreviewed),
        )
        for photo_id, boxes in sorted(photographs.items())
    )
