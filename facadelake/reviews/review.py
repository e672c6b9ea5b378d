"""A review, a person's word on one place of a photograph, and the rows of table ``reviews`` it is kept in."""

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
    """A word on a place of a photograph, in its pixels.

    ``subject`` names the place: of two reviews of one subject the later counts. ``reviewed_box`` and
    ``reviewed_class`` are what the detector had there (None: nothing); ``box``, ``mask`` (WKT) and
    ``defect_class`` what the reviewer found there (None: no defect).
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
        """The box as the person drew it, else as it was judged."""
        place = self.box or self.reviewed_box
        assert place is not None  # importers refuse a word without a place
        return place


def make_subject(photo_id: str, box: Box, defect_class: DefectClass) -> str:
    """Name of a place that has none yet: photograph, class and box, to a tenth of a pixel."""
    return f"{photo_id}@{','.join(f'{getattr(box, side):.1f}' for side in _SIDES)} {defect_class}"


def box_from_row(row: Mapping[str, Any], prefix: str = "box") -> Box | None:
    """The box in the columns ``<prefix>_x_px``, ..., None where they are empty."""
    values = {side: row[f"{prefix}_{side}"] for side in _SIDES}
    return None if None in values.values() else Box(**values)


def reviews_from_table(table: pa.Table) -> tuple[Review, ...]:
    """Rows of table ``reviews``, the oldest first; those said at once in the order of their ids."""
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
    """Reviews as rows of table ``reviews``; the lake gives those their ids that have none."""
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
    """The last word on each subject, of ``reviews`` in the order of time."""
    last: dict[str, Review] = {}
    for review in reviews:
        last.pop(review.subject, None)
        last[review.subject] = review
    return tuple(last.values())


_UNCONVERTED_COLUMNS = (
    "run_id", "review_id", "photo_id", "subject", "detection_id", "defect_id", "mask", "detector_sha256", "reviewer",
    "reviewed_at", "note",
)  # fmt: skip


def _parse_class(word: str | None) -> DefectClass | None:
    return None if word is None else DefectClass(word)


def _columns_from_box(box: Box | None, prefix: str) -> dict[str, float | None]:
    return {f"{prefix}_{side}": None if box is None else getattr(box, side) for side in _SIDES}
