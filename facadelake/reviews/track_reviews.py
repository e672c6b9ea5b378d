"""What a person says became of a defect in a campaign: it overrides what tracking finds, and later runs keep it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa

from facadelake.core.errors import InputDataError, suggest_name
from facadelake.core.tables import Row, list_rows
from facadelake.lake import AppendResult, append_reviews, query, read_tables, require_known_values
from schemas.tables import LAKE_TABLES
from schemas.vocabulary import TrackState

_BEGINNINGS = frozenset({TrackState.NEW, TrackState.FIRST_SEEN})
# What cannot be said of a track where its history begins.
_LATER = frozenset({TrackState.GROWN, TrackState.SHRUNK, TrackState.REPAIRED, TrackState.REOPENED})


@dataclass(frozen=True, kw_only=True)
class TrackReviewResult:
    """A review of a track: its building, the state that tracking had given it there (None: none), what was added."""

    building_id: str
    state_before: TrackState | None
    added: AppendResult


def review_track(
    lake: Path, track_id: str, campaign_id: str, state: str, *, reviewer: str, note: str | None = None
) -> TrackReviewResult:
    """Add a person's review of the state of a track in a campaign.

    Args:
        lake: Folder of the lake.
        track_id: The track, such as castle-0042.
        campaign_id: A committed campaign of its building.
        state: The state, a word of ``TrackState``.
        reviewer: The reviewer's name.
        note: What else there is to say; None: nothing.

    Returns:
        The review.

    Raises:
        InputDataError: The track, the campaign or the state is unknown, the track is withdrawn, the name is empty, or
            the track cannot have the state in that campaign.
        StoreError: The lake cannot be read or written.
    """
    if not reviewer.strip():
        raise InputDataError("a review needs the reviewer's name; give --reviewer")
    if state not in set(TrackState):
        raise InputDataError(
            f"there is no state '{state}'{suggest_name(state, TrackState)}; there are {', '.join(TrackState)} "
            "(docs/history.md)"
        )
    building_id = _find_building(lake, track_id)
    require_known_values(
        lake,
        {"building_id": building_id, "campaign_id": campaign_id},
        {"campaign_id": "campaigns.campaign_id"},
    )
    tables = read_tables(lake, ["runs", "track_states"], building_id=building_id, campaign_id=campaign_id)
    before = [row["track_state"] for row in list_rows(tables["track_states"]) if row["track_id"] == track_id]
    _require_possible(track_id, campaign_id, TrackState(state), TrackState(before[0]) if before else None)
    row: Row = {
        "building_id": building_id,
        "campaign_id": campaign_id,
        "run_id": tables["runs"].column("run_id")[0].as_py(),
        "review_id": "",
        "track_id": track_id,
        "track_state": state,
        "reviewer": reviewer.strip(),
        "reviewed_at": datetime.now(UTC),
        "note": note,
    }
    table = pa.Table.from_pylist([row], schema=LAKE_TABLES["track_reviews"].arrow)
    added = append_reviews(lake, table, building_id=building_id, campaign_id=campaign_id, name="track_reviews")
    return TrackReviewResult(
        building_id=building_id, state_before=TrackState(before[0]) if before else None, added=added
    )


def _require_possible(track_id: str, campaign_id: str, state: TrackState, before: TrackState | None) -> None:
    """Require that a track can have a state in a campaign: a history begins once, and what is gone was there before."""
    begins = before is None or before in _BEGINNINGS
    possible = set(TrackState) - (_LATER if begins else _BEGINNINGS)
    if state not in possible:
        place = "the first campaign" if before is not None else "a campaign before the first"
        raise InputDataError(
            f"track {track_id} cannot be {state} in {campaign_id}, "
            f"{f'{place} of its history' if begins else 'which is not the first campaign of its history'}; possible "
            f"are {', '.join(one for one in TrackState if one in possible)}. A wrong detection is rejected by a review "
            "of the campaign's detections ('facadelake review')"
        )


def _find_building(lake: Path, track_id: str) -> str:
    """The building of a track that the lake has, and that is not withdrawn."""
    require_known_values(lake, {"track_id": track_id}, {"track_id": "tracks.track_id"})
    sql = "SELECT building_id, withdrawn FROM tracks WHERE track_id = $track_id"
    found = list_rows(query(lake, sql, {"track_id": track_id}))
    if len(found) != 1:
        buildings = ", ".join(row["building_id"] for row in found)
        raise InputDataError(
            f"'{track_id}' names {f'tracks of several buildings ({buildings})' if found else 'no track'}; give the "
            "whole id, such as castle-0042, as 'facadelake tracks' lists it"
        )
    if found[0]["withdrawn"]:
        raise InputDataError(
            f"track {track_id} is withdrawn: no campaign in the lake has the defect any more, so that its state cannot "
            "be reviewed; 'facadelake tracks' lists the others"
        )
    return str(found[0]["building_id"])
