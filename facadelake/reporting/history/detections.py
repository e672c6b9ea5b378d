"""The defects of all campaigns of a building with the sizes that tracking compares, and changes between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from facadelake.tracking import (
    SIZE_COLUMNS,
    SizedDefects,
    SizeDifference,
    compare_sized_pairs,
    concatenate_sized,
    read_sizes,
    share_blur,
)
from schemas.vocabulary import DefectClass, TrendQuantity

Row = Mapping[str, Any]
Key = tuple[str, str]
OBSERVATION_COLUMNS = ("campaign_id", *SIZE_COLUMNS)
_OF_SIGHTINGS = (TrendQuantity.LENGTH, TrendQuantity.AREA)


@dataclass(frozen=True, kw_only=True, eq=False)
class Detections:
    """Defects by campaign and id. ``rows``: those of table ``defects``, but length and area are the medians of the
    sightings, whose difference a change is, where there are such; ``places``: of each in ``sized``."""

    rows: Mapping[Key, Row]
    places: Mapping[Key, int]
    sized: SizedDefects

    def find(self, campaign_id: str, defect_id: str | None) -> Row | None:
        """A defect; None where there is none."""
        return self.rows.get((campaign_id, defect_id or ""))

    def compare(self, pairs: Sequence[tuple[Row, Row]]) -> list[dict[TrendQuantity, SizeDifference]]:
        """Changes between pairs of defects, significant over all of them."""
        if not pairs:
            return []
        before, after = (
            self.sized.take(np.array([self.places[_name(pair[side])] for pair in pairs], dtype=np.int64))
            for side in (0, 1)
        )
        return compare_sized_pairs(before, after).changes


def _name(row: Row) -> Key:
    return str(row["campaign_id"]), str(row["defect_id"])


def read_detections(defects: pa.Table, observations: pa.Table) -> Detections:
    """The defects of a building, from the rows of tables ``defects`` and ``observations`` of all its campaigns."""
    rows: dict[Key, Row] = {}
    own, sizes = [], []
    for campaign in pc.unique(defects["campaign_id"]).to_pylist():
        found, seen = (table.filter(pc.equal(table["campaign_id"], campaign)) for table in (defects, observations))
        own.append(found)
        sizes.append(read_sizes(found, seen))
        for k, row in enumerate(found.to_pylist()):
            medians = {str(quantity): exp(sizes[-1][quantity].log_size[k]) for quantity in _OF_SIGHTINGS
                       if np.isfinite(sizes[-1][quantity].log_size[k])}  # fmt: skip
            rows[_name(row)] = row | medians
    parts = [
        SizedDefects(defect_class=[DefectClass(name) for name in found["defect_class"].to_pylist()], sizes=shared)
        for found, shared in zip(own, share_blur(sizes), strict=True)
    ]
    empty = SizedDefects(defect_class=[], sizes=read_sizes(defects.slice(0, 0), observations.slice(0, 0)))
    return Detections(
        rows=rows, places={key: place for place, key in enumerate(rows)}, sized=concatenate_sized([empty, *parts])
    )
