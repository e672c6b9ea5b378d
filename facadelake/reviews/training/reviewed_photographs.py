"""What of a photograph a model may learn: defects, places that are none, and places of which nobody has spoken."""

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
    """A defect that a person confirmed, corrected or drew; ``mask`` is a shapely polygon or None."""

    box: Box
    defect_class: DefectClass
    mask: Any | None = None


@dataclass(frozen=True, kw_only=True)
class ReviewedPhotograph:
    """A photograph as reviewed: ``defects``, ``rejected`` boxes, and boxes of detections that nobody looked at."""

    photo_id: str
    defects: tuple[TrainingBox, ...]
    rejected: tuple[Box, ...]
    unreviewed: tuple[Box, ...]


@dataclass
class _PhotographBoxes:
    defects: list[TrainingBox] = field(default_factory=list)
    rejected: list[Box] = field(default_factory=list)
    unreviewed: list[Box] = field(default_factory=list)


def collect_reviewed_photographs(judgement: ReviewStatus) -> tuple[ReviewedPhotograph, ...]:
    """The photographs that someone has spoken of, in order."""
    photographs: dict[str, _PhotographBoxes] = defaultdict(_PhotographBoxes)
    for one in judgement.current:
        word, there = one.review, photographs[one.review.photo_id]
        if word.box is None or word.defect_class is None:
            there.rejected.append(word.effective_box)
            continue
        mask = None if word.mask is None else polygons_from_wkt(word.mask)
        there.defects.append(TrainingBox(box=word.box, defect_class=word.defect_class, mask=mask))
    for detection in judgement.unreviewed:
        if detection.photo_id in photographs:
            photographs[detection.photo_id].unreviewed.append(detection.box)
    return tuple(
        ReviewedPhotograph(
            photo_id=photo_id,
            defects=tuple(there.defects),
            rejected=tuple(there.rejected),
            unreviewed=tuple(there.unreviewed),
        )
        for photo_id, there in sorted(photographs.items())
    )
