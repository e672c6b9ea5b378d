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
    SizedDefects,
    SizeDifference,
    compare_sized_pairs,
    concatenate_sized,
    read_sizes,
)
from schemas.vocabulary import DefectClass, TrendQuantity

Row = Mapping[str, Any]
Key = tuple[str, str]
OBSERVATION_COLUMNS = ("campaign_id", "defect_id", "length_m", "area_m2")
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
    parts = []
    for campaign in pc.unique(defects["campaign_id"]).to_pylist():
        own, seen = (table.filter(pc.equal(table["campaign_id"], campaign)) for table in (defects, observations))
        sizes = read_sizes(own, seen)
        parts.append(
            SizedDefects(defect_class=[DefectClass(name) for name in own["defect_class"].to_pylist()], sizes=sizes)
        )
        for k, row in enumerate(own.to_pylist()):
            medians = {str(quantity): exp(sizes[quantity].log_size[k]) for quantity in _OF_SIGHTINGS
                       if np.isfinite(sizes[quantity].log_size[k])}  # fmt: skip
            rows[_name(row)] = row | medians
    empty = SizedDefects(defect_class=[], sizes=read_sizes(defects.slice(0, 0), observations.slice(0, 0)))
    return Detections(
        rows=rows, places={key: place for place, key in enumerate(rows)}, sized=concatenate_sized([empty, *parts])
    )
