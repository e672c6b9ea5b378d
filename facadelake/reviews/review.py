"""The review of one location in a photograph by a person, and its row of table ``reviews``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import pyarrow as pa

from facadelake.detection import Box
from schemas.tables import LAKE_TABLES
from schemas.vocabulary import DefectClass, Verdict

_SIDES = ("x_px", "y_px", "width_px", "height_px")


@dataclass(frozen=True, kw_only=True)
class Review:
    """A verdict on one location in a photograph; boxes and mask in pixels of the photograph.

    ``subject`` identifies the location: of several reviews of one subject the latest is the current one.
    ``reviewed_box`` and ``reviewed_class`` are the detector's result there (None: it detected nothing); ``box``,
    ``mask`` (WKT) and ``defect_class`` are the reviewer's (None: no defect).
    """

    photo_id: str
    subject: str
    verdict: Verdict
    reviewer: str
    reviewed_at: datetime
    run_id: str
    review_id: str = ""
    detection_id: str | None = None
    defect_id: str | None = None
    defect_class: DefectClass | None = None
    box: Box | None = None
    mask: str | None = None
    reviewed_class: DefectClass | None = None
    reviewed_box: Box | None = None
    detector_sha256: str | None = None
    note: str | None = None

    @property
    def effective_box(self) -> Box:
        """The reviewer's box, or the reviewed box where the reviewer rejected it."""
        box = self.box or self.reviewed_box
        assert box is not None  # importers refuse a review without a box
        return box


@dataclass(frozen=True, kw_only=True)
class ParsedReviews:
    """The reviews that a file holds, and remarks on the entries that cannot be used."""

    reviews: tuple[Review, ...]
    remarks: tuple[str, ...]


def make_subject(photo_id: str, box: Box, defect_class: DefectClass) -> str:
    """The subject of a location that has none yet: photograph, box to a tenth of a pixel, and class."""
    return f"{photo_id}@{','.join(f'{getattr(box, side):.1f}' for side in _SIDES)} {defect_class}"


def box_from_row(row: Mapping[str, Any], prefix: str = "box") -> Box | None:
    """The box in the columns ``<prefix>_x_px``, ``<prefix>_y_px``, ...; None where one of them is empty."""
    values = {side: row[f"{prefix}_{side}"] for side in _SIDES}
    return None if None in values.values() else Box(**values)


def reviews_from_table(table: pa.Table) -> tuple[Review, ...]:
    """Rows of table ``reviews``, the oldest first; those of the same time by ``review_id``."""
    rows = table.sort_by([("reviewed_at", "ascending"), ("review_id", "ascending")]).to_pylist()
    return tuple(
        Review(
            **{name: row[name] for name in _UNCONVERTED_COLUMNS},
            verdict=Verdict(row["verdict"]),
            defect_class=_parse_class(row["defect_class"]),
            reviewed_class=_parse_class(row["reviewed_class"]),
            box=box_from_row(row),
            reviewed_box=box_from_row(row, "reviewed_box"),
        )
        for row in rows
    )


def table_from_reviews(reviews: Sequence[Review], *, building_id: str, campaign_id: str) -> pa.Table:
    """Reviews as rows of table ``reviews``; the lake assigns the missing ``review_id``."""
    rows = [
        {
            "building_id": building_id,
            "campaign_id": campaign_id,
            **{name: getattr(review, name) for name in _UNCONVERTED_COLUMNS},
            "verdict": str(review.verdict),
            "defect_class": None if review.defect_class is None else str(review.defect_class),
            "reviewed_class": None if review.reviewed_class is None else str(review.reviewed_class),
            **_columns_from_box(review.box, "box"),
            **_columns_from_box(review.reviewed_box, "reviewed_box"),
        }
        for review in reviews
    ]
    return pa.Table.from_pylist(rows, schema=LAKE_TABLES["reviews"].arrow)


def select_current_reviews(reviews: Iterable[Review]) -> tuple[Review, ...]:
    """The latest review of each subject; ``reviews`` are sorted by time."""
    current: dict[str, Review] = {}
    for review in reviews:
        current.pop(review.subject, None)
        current[review.subject] = review
    return tuple(current.values())


_UNCONVERTED_COLUMNS = (
    "run_id", "review_id", "photo_id", "subject", "detection_id", "defect_id", "mask", "detector_sha256", "reviewer",
    "reviewed_at", "note",
)  # fmt: skip


def _parse_class(name: str | None) -> DefectClass | None:
    return None if name is None else DefectClass(name)


def _columns_from_box(box: Box | None, prefix: str) -> dict[str, float | None]:
    return {f"{prefix}_{side}": None if box is None else getattr(box, side) for side in _SIDES}
