"""Detections and reviews made by hand."""

from datetime import UTC, datetime
from typing import Any

import pyarrow as pa

from facadelake.core.tables import table_from_rows
from facadelake.detection.boxes import Box
from facadelake.reviews.review_items import ReviewItem, ReviewProvenance, list_review_items
from facadelake.reviews.review_matching import (
    AcceptedDetection,
    ReviewStatus,
    match_reviews,
    select_accepted_detections,
)
from schemas.vocabulary import DefectClass

CRACK, SPALLING, MOISTURE = DefectClass.CRACK, DefectClass.SPALLING, DefectClass.MOISTURE
PROVENANCE = ReviewProvenance(reviewer="A. Mason", reviewed_at=datetime(2026, 5, 1, 9, tzinfo=UTC), run_id="run-1")
OLD_MODEL, NEW_MODEL = "a" * 64, "b" * 64
SIZES = {"p0.jpg": (1600, 1200), "p1.jpg": (1600, 1200)}


def box(x: float, y: float, width: float = 100.0, height: float = 40.0) -> Box:
    return Box(x_px=x, y_px=y, width_px=width, height_px=height)


def rows(*found: tuple[str, str, Box], model: str = OLD_MODEL, first: int = 1, score: float = 0.9) -> pa.Table:
    """Detections (photo_id, class, box) as table ``detections``; ids count on from ``first`` as an ONNX run's do."""
    return table_from_rows(
        "detections",
        [
            {
                "detection_id": f"{photo}#{number}", "photo_id": photo, "detection_outcome": "accepted",
                "defect_class": name, "source_class": name, "score": score, "detector": "onnx:m",
                "detector_sha256": model, **{f"box_{side}": value for side, value in vars(where).items()},
            }
            for number, (photo, name, where) in enumerate(found, start=first)
        ],
    )  # fmt: skip


def seen(*found: tuple[str, str, Box], **settings: Any) -> tuple[AcceptedDetection, ...]:
    return select_accepted_detections(rows(*found, **settings))


def unreviewed(*found: tuple[str, str, Box]) -> tuple[ReviewItem, ...]:
    status: ReviewStatus = match_reviews((), seen(*found))
    return list_review_items(status, {one.detection_id: f"D{i}" for i, one in enumerate(seen(*found))})
