"""Rows of table ``frame_offsets``: the offsets between the frames of campaigns, in numbers and words."""

from __future__ import annotations

import numpy as np

from facadelake.core.tables import Row
from facadelake.tracking.frame_offsets import FrameOffset
from facadelake.tracking.linked import LinkedHistory
from schemas.vocabulary import OffsetOutcome


def build_offset_rows(building_id: str, history: LinkedHistory) -> list[Row]:
    """The rows of table ``frame_offsets``."""
    run_ids = {records.campaign_id: records.run_id for records in history.refused}
    run_ids |= {records.campaign_id: records.run_id for records in history.campaigns}
    return [
        {
            "building_id": building_id,
            "campaign_id": link.campaign_id,
            "run_id": run_ids[link.campaign_id],
            "facade": offset.facade,
            "offset_outcome": offset.outcome,
            **_describe_offset(offset),
            "offset_count": offset.pairs,
            "found_again_share": None if np.isnan(link.found_again) else link.found_again,
            "detail": _explain_offset(offset, link.campaign_id, history.time_remarks.get(link.campaign_id)),
        }
        for link in history.links
        for offset in link.offsets
    ]


def _describe_offset(offset: FrameOffset) -> Row:
    if offset.outcome not in (OffsetOutcome.ESTIMATED, OffsetOutcome.REFUSED):
        return {}
    sigma = np.sqrt(np.diag(offset.covariance_m2))
    names = ("east", "north", "up")
    return {
        **{f"offset_{name}_m": float(value) for name, value in zip(names, offset.xyz_m, strict=True)},
        **{f"offset_sigma_{name}_m": float(value) for name, value in zip(names, sigma, strict=True)},
    }


def _explain_offset(offset: FrameOffset, campaign_id: str, time_remark: str | None) -> str:
    words = {
        OffsetOutcome.FIRST: "the first campaign: the others are compared with its frame",
        OffsetOutcome.TOO_FEW: "too few defects agree on an offset; none is taken off",
        OffsetOutcome.ESTIMATED: f"{offset.pairs} defects agree on it; it is taken off before defects are matched",
        OffsetOutcome.REFUSED: (
            f"{offset.pairs} defects agree that the positions of {campaign_id} are "
            f"{np.linalg.norm(offset.xyz_m):.2f} m off those of the campaigns before; the georeferencing of both "
            f"admits {offset.limit_m or 0:.2f} m. Its defects are not matched: inspect that campaign, or the one "
            "before, with other control"
        ),
    }[offset.outcome]
    return f"{words}; {time_remark}" if time_remark else words
