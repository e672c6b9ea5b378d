"""What a person is shown of a campaign: its detections, as far as earlier words left them standing."""

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
    """A place of a photograph where a defect is said to be, by the detector or by a person's last word.

    ``reviewed_box`` and ``reviewed_class`` are the detector's, None where a person found it; ``verdict`` the last word.
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
        """Whether nobody has said last that no defect is there."""
        return self.verdict is not Verdict.REJECTED


@dataclass(frozen=True, kw_only=True)
class ReviewProvenance:
    """Who says it, when, and of which run's results."""

    reviewer: str
    reviewed_at: datetime
    run_id: str


def list_review_items(judgement: ReviewStatus, defects: Mapping[str, str]) -> tuple[ReviewItem, ...]:
    """All places spoken of or detected, by photograph, rejected ones too. ``defects``: defect_id by detection_id."""
    places = [
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
        for one in judgement.unreviewed
    ]
    for standing in judgement.current:
        word, now = standing.review, standing.detection
        defect_class = word.defect_class or word.reviewed_class
        assert defect_class is not None  # a word without a defect is about a judged class
        detection_id = word.detection_id if now is None else now.detection_id
        places.append(
            ReviewItem(
                subject=word.subject,
                photo_id=word.photo_id,
                defect_class=defect_class,
                box=word.effective_box,
                mask=word.mask,
                score=1.0,
                detection_id=detection_id,
                defect_id=defects.get(detection_id or "", word.defect_id),
                detector_sha256=word.detector_sha256 if now is None else now.detector_sha256,
                reviewed_box=word.reviewed_box,
                reviewed_class=word.reviewed_class,
                verdict=word.verdict,
            )
        )
    return tuple(sorted(places, key=lambda place: (place.photo_id, place.box.y_px, place.box.x_px)))


def create_review(
    place: ReviewItem,
    verdict: Verdict,
    said: ReviewProvenance,
    *,
    box: Box | None = None,
    defect_class: DefectClass | None = None,
    mask: str | None = None,
    note: str | None = None,
) -> Review:
    """A word on a shown place; a corrected one says its new ``box`` and ``defect_class``."""
    judged: dict[str, Any] = {"reviewed_box": place.reviewed_box, "reviewed_class": place.reviewed_class}
    if verdict is Verdict.REJECTED and place.reviewed_box is None:  # what a person had found another one takes back
        judged = {"reviewed_box": place.box, "reviewed_class": place.defect_class}
    there: dict[str, Any] = {"box": place.box, "defect_class": place.defect_class, "mask": place.mask}
    if verdict is Verdict.REJECTED:
        there = {}
    elif verdict is Verdict.CORRECTED:
        there = {"box": box or place.box, "defect_class": defect_class or place.defect_class, "mask": mask}
    elif place.reviewed_box is None:
        verdict = Verdict.MISSED  # confirming what a person found leaves it a defect that the detector missed
    return Review(
        photo_id=place.photo_id,
        subject=place.subject,
        verdict=verdict,
        reviewer=said.reviewer,
        reviewed_at=said.reviewed_at,
        run_id=said.run_id,
        detection_id=place.detection_id,
        defect_id=place.defect_id,
        detector_sha256=place.detector_sha256,
        note=note,
        **there,
        **judged,
    )


def create_missed_review(
    photo_id: str,
    box: Box,
    defect_class: DefectClass,
    said: ReviewProvenance,
    *,
    mask: str | None = None,
    note: str | None = None,
) -> Review:
    """A defect that the detector did not find."""
    return Review(
        photo_id=photo_id,
        subject=make_subject(photo_id, box, defect_class),
        verdict=Verdict.MISSED,
        reviewer=said.reviewer,
        reviewed_at=said.reviewed_at,
        run_id=said.run_id,
        defect_class=defect_class,
        box=box,
        mask=mask,
        note=note,
    )


def polygons_from_wkt(mask: str | None) -> list[list[float]]:
    """COCO's segmentation of a mask in WKT; holes are filled, as COCO's polygons have none."""
    if mask is None:
        return []
    parts: Sequence[Any] = shapely.get_parts(shapely.from_wkt(mask))
    return [[round(float(value), 2) for point in part.exterior.coords[:-1] for value in point] for part in parts]
