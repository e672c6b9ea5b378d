"""Items of a review: the locations of a campaign that a reviewer is shown, and the reviews made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import shapely

from facadelake.detection import Box
from facadelake.reviews.review import Review, make_subject
from facadelake.reviews.review_matching import ReviewStatus
from schemas.vocabulary import DefectClass, Verdict


@dataclass(frozen=True, kw_only=True)
class ReviewItem:
    """A location in a photograph with a defect, by the detector or by the current review; boxes in px.

    ``reviewed_box`` and ``reviewed_class`` are the detector's, None where a reviewer added the defect. ``verdict`` is
    that of the current review, None where there is no review.
    """

    subject: str
    photo_id: str
    defect_class: DefectClass
    box: Box
    mask: str | None
    score: float
    detection_id: str | None = None
    defect_id: str | None = None
    detector_sha256: str | None = None
    reviewed_box: Box | None = None
    reviewed_class: DefectClass | None = None
    verdict: Verdict | None = None

    @property
    def is_defect(self) -> bool:
        """False where the current review rejected the defect."""
        return self.verdict is not Verdict.REJECTED


@dataclass(frozen=True, kw_only=True)
class ReviewProvenance:
    """The reviewer, the time of the review, and the run whose results were reviewed."""

    reviewer: str
    reviewed_at: datetime
    run_id: str


def list_review_items(status: ReviewStatus, defects: Mapping[str, str]) -> tuple[ReviewItem, ...]:
    """All reviewed or detected locations, rejected ones too, sorted by photograph. ``defects``: defect_id by
    detection_id."""
    items = [
        ReviewItem(
            subject=make_subject(one.photo_id, one.box, one.defect_class),
            photo_id=one.photo_id,
            defect_class=one.defect_class,
            box=one.box,
            mask=one.mask,
            score=one.score,
            detection_id=one.detection_id,
            defect_id=defects.get(one.detection_id),
            detector_sha256=one.detector_sha256,
            reviewed_box=one.box,
            reviewed_class=one.defect_class,
        )
        for one in status.unreviewed
    ]
    for matched in status.current:
        review, detection = matched.review, matched.detection
        defect_class = review.defect_class or review.reviewed_class
        assert defect_class is not None  # a review that rejects has the reviewed class
        detection_id = review.detection_id if detection is None else detection.detection_id
        items.append(
            ReviewItem(
                subject=review.subject,
                photo_id=review.photo_id,
                defect_class=defect_class,
                box=review.effective_box,
                mask=review.mask,
                score=1.0,
                detection_id=detection_id,
                defect_id=defects.get(detection_id or "", review.defect_id),
                detector_sha256=review.detector_sha256 if detection is None else detection.detector_sha256,
                reviewed_box=review.reviewed_box,
                reviewed_class=review.reviewed_class,
                verdict=review.verdict,
            )
        )
    return tuple(sorted(items, key=lambda item: (item.photo_id, item.box.y_px, item.box.x_px)))


def create_review(
    item: ReviewItem,
    verdict: Verdict,
    provenance: ReviewProvenance,
    *,
    box: Box | None = None,
    defect_class: DefectClass | None = None,
    mask: str | None = None,
    note: str | None = None,
) -> Review:
    """The review of an item.

    Args:
        item: What the reviewer was shown.
        verdict: The reviewer's verdict. Confirming a defect that a reviewer added gives ``missed`` again.
        provenance: Reviewer, time and run.
        box: The corrected box, px of the photograph; the item's where left out.
        defect_class: The corrected class; the item's where left out.
        mask: The corrected mask, WKT in px of the photograph; a corrected item keeps no other.
        note: The reviewer's remark.

    Returns:
        The review; ``box``, ``defect_class`` and ``mask`` are None where ``verdict`` is ``rejected``.
    """
    reviewed: dict[str, Any] = {"reviewed_box": item.reviewed_box, "reviewed_class": item.reviewed_class}
    if verdict is Verdict.REJECTED and item.reviewed_box is None:  # withdraws a defect that a reviewer added
        reviewed = {"reviewed_box": item.box, "reviewed_class": item.defect_class}
    result: dict[str, Any] = {"box": item.box, "defect_class": item.defect_class, "mask": item.mask}
    if verdict is Verdict.REJECTED:
        result = {}
    elif verdict is Verdict.CORRECTED:
        result = {"box": box or item.box, "defect_class": defect_class or item.defect_class, "mask": mask}
    elif item.reviewed_box is None:
        verdict = Verdict.MISSED  # the detector missed it, whoever confirms it
    return Review(
        photo_id=item.photo_id,
        subject=item.subject,
        verdict=verdict,
        reviewer=provenance.reviewer,
        reviewed_at=provenance.reviewed_at,
        run_id=provenance.run_id,
        detection_id=item.detection_id,
        defect_id=item.defect_id,
        detector_sha256=item.detector_sha256,
        note=note,
        **result,
        **reviewed,
    )


def create_missed_review(
    photo_id: str,
    box: Box,
    defect_class: DefectClass,
    provenance: ReviewProvenance,
    *,
    mask: str | None = None,
    note: str | None = None,
) -> Review:
    """The review of a defect that the detector missed.

    Args:
        photo_id: The photograph.
        box: The reviewer's box, px of the photograph.
        defect_class: The reviewer's class.
        provenance: Reviewer, time and run.
        mask: The reviewer's mask, WKT in px of the photograph.
        note: The reviewer's remark.
    """
    return Review(
        photo_id=photo_id,
        subject=make_subject(photo_id, box, defect_class),
        verdict=Verdict.MISSED,
        reviewer=provenance.reviewer,
        reviewed_at=provenance.reviewed_at,
        run_id=provenance.run_id,
        defect_class=defect_class,
        box=box,
        mask=mask,
        note=note,
    )


def coco_polygons_from_wkt(mask: str | None) -> list[list[float]]:
    """A mask in WKT as COCO's polygons [x1, y1, x2, y2, ...], px. Holes are filled: COCO's polygons have none."""
    if mask is None:
        return []
    parts: Sequence[Any] = shapely.get_parts(shapely.from_wkt(mask))
    return [[round(float(value), 2) for point in part.exterior.coords[:-1] for value in point] for part in parts]
