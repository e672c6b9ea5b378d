"""Offset between the frames of two campaigns, from table ``frame_offsets``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from schemas.vocabulary import OffsetOutcome

Row = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class RelativeOffset:
    """Offset of a later campaign's positions from an earlier one's on a facade ('' for the whole building), m, with one
    sigma each.

    ``xyz_m`` is None where it was not estimated; ``remark`` says why. ``counts``: defects of the earlier and of the
    later campaign, known from campaigns before, at which it was estimated.
    """

    facade: str
    xyz_m: tuple[float, float, float] | None
    sigma_m: tuple[float, float, float] | None
    counts: tuple[int, int]
    remark: str


def index_offsets(offsets: pa.Table) -> dict[str, dict[str, Row]]:
    """Rows of ``frame_offsets`` by campaign and facade."""
    found: dict[str, dict[str, Row]] = {}
    for row in offsets.to_pylist():
        found.setdefault(row["campaign_id"], {})[row["facade"]] = row
    return found


def compute_relative_offsets(earlier: Mapping[str, Row], later: Mapping[str, Row]) -> list[RelativeOffset]:
    """Offset of the later campaign from the earlier one, of the building and of each facade that has its own."""
    facades = sorted({*earlier, *later} - {""})
    return [_subtract_offsets(name, earlier.get(name) or earlier.get(""), later.get(name) or later.get(""))
            for name in ("", *facades)]  # fmt: skip


_AXES = ("east", "north", "up")


def _subtract_offsets(facade: str, earlier: Row | None, later: Row | None) -> RelativeOffset:
    if earlier is None or later is None or not (_is_known(earlier) and _is_known(later)):
        unknown = [row["detail"] for row in (earlier, later) if row is not None and not _is_known(row)]
        told = "; ".join(dict.fromkeys(detail for detail in unknown if detail)) or "not estimated"
        return RelativeOffset(facade=facade, xyz_m=None, sigma_m=None, counts=(0, 0), remark=told)
    xyz = tuple((later[f"offset_{axis}_m"] or 0.0) - (earlier[f"offset_{axis}_m"] or 0.0) for axis in _AXES)
    sigma = tuple(
        math.hypot(later[f"offset_sigma_{axis}_m"] or 0.0, earlier[f"offset_sigma_{axis}_m"] or 0.0) for axis in _AXES
    )
    return RelativeOffset(
        facade=facade, xyz_m=(xyz[0], xyz[1], xyz[2]), sigma_m=(sigma[0], sigma[1], sigma[2]),
        counts=(earlier["offset_count"], later["offset_count"]), remark="",
    )  # fmt: skip


def _is_known(row: Row) -> bool:
    """Whether the campaign's offset from the first campaign is known; that of the first one is zero."""
    return bool(row["offset_outcome"] in (OffsetOutcome.FIRST, OffsetOutcome.ESTIMATED))
