"""Why a track is what it is: per campaign its state, the candidates, the looks at its place, relations and reviews."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa

from facadelake.core.errors import InputDataError
from facadelake.lake import has_lake, read_tables, require_known_values
from facadelake.reporting.history.comparison import READ_COLUMNS, TABLES, describe_relation, order_campaigns
from facadelake.reporting.history.detections import read_detections
from facadelake.reporting.history.findings import MEANINGS, Finding, TimelineState
from facadelake.reporting.history.relative_offsets import compute_relative_offsets, index_offsets
from facadelake.reporting.history.sentences import EVIDENCE
from facadelake.reporting.history.size_changes import format_size, read_changes, select_main_changes
from facadelake.severity import describe_severity
from schemas.vocabulary import LookVerdict, OffsetOutcome, StateEvidence, TrackState

Row = Mapping[str, Any]
EXPLAINED_TABLES = (*TABLES, "track_candidates", "track_reviews")
_VERDICTS = {
    LookVerdict.SAME: "its place looks as it did: the defect is there",
    LookVerdict.GONE: "the wall is recognised, and the defect's look is not there",
    LookVerdict.UNDECIDED: "its place is imaged, and the pictures decide neither way",
    LookVerdict.HIDDEN: "something else is before the wall",
    LookVerdict.NOT_IN_VIEW: "no photograph shows its place well enough",
    LookVerdict.NO_PHOTOGRAPH: "the files of the photographs are not there",
}
_UNITS = {"length_m": "m", "area_m2": "m²", "crack_width_mm": "mm"}
_ODDS_MAX = 1e6


@dataclass(frozen=True, kw_only=True)
class CampaignExplanation:
    """What is known of a track in one campaign: ``finding`` (None before it was known) and sentences."""

    campaign_id: str
    finding: Finding | None
    word: str
    lines: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class TrackExplanation:
    """A track explained: sentences on the whole of it, and on each campaign in order."""

    track_id: str
    building_id: str
    lines: tuple[str, ...]
    campaigns: tuple[CampaignExplanation, ...]


def explain_track(lake: Path, track_id: str, *, as_of: int | None) -> TrackExplanation:
    """Explain a track from the lake.

    Args:
        lake: folder of the lake.
        track_id: id of the track, such as castle-0042.
        as_of: an earlier version of the lake; None: the newest.

    Raises:
        InputDataError: the lake has no such track; the message names a similar one.
    """
    return explain_rows(read_track_tables(lake, track_id, as_of=as_of), track_id)


def read_track_tables(
    lake: Path, track_id: str, names: Sequence[str] = EXPLAINED_TABLES, *, as_of: int | None
) -> dict[str, pa.Table]:
    """The tables ``names`` of the building of a track; those of tracks have its rows alone.

    Args:
        lake: folder of the lake.
        track_id: the track.
        names: tables.
        as_of: an earlier version of the lake; None: the newest.

    Raises:
        InputDataError: the lake has no such track.
    """
    if not has_lake(lake):
        raise InputDataError(f"there is no lake in {lake}; inspect a campaign first, or name another with --lake")
    building_id = track_id.rpartition("-")[0]
    tables = read_tables(lake, list(names), building_id=building_id, as_of=as_of, columns=READ_COLUMNS)
    known = tables["tracks"].column("track_id").to_pylist()
    if track_id not in known:
        if len(tables["campaigns"]) and not known and not len(tables["frame_offsets"]):
            raise InputDataError(
                f"building '{building_id}' is not tracked: the lake has no history of it; run 'facadelake track "
                f"{building_id}'"
            )
        require_known_values(lake, {"track_id": track_id}, {"track_id": "tracks.track_id"}, as_of=as_of)
    return {
        name: table
        if "track_id" not in table.column_names
        else table.filter(pa.array([one == track_id for one in table.column("track_id").to_pylist()], pa.bool_()))
        for name, table in tables.items()
    }


def explain_rows(tables: Mapping[str, pa.Table], track_id: str) -> TrackExplanation:
    """Explain a track from the tables of ``read_track_tables``."""
    track = tables["tracks"].to_pylist()[0]
    ordered = order_campaigns(tables["campaigns"])
    offsets, before = index_offsets(tables["frame_offsets"]), None
    defects = read_detections(tables["defects"], tables["observations"]).rows
    states = {row["campaign_id"]: row for row in tables["track_states"].to_pylist()}
    explained = []
    for row in ordered:
        name = row["campaign_id"]
        state = states.get(name)
        finding = None if state is None else _get_state(state).finding
        lines = [f"photographed {_format_day(row['captured_from'])}"]
        if state is not None:
            lines += _explain_state(state, defects, states)
        if name in offsets:
            lines.append(_explain_offset(offsets, before, name, track["facade"] or ""))
            before = before if offsets[name][""]["offset_outcome"] == OffsetOutcome.REFUSED else name
        lines += _explain_candidates(tables["track_candidates"], name, defects, track, states)
        lines += [_explain_look(look) for look in _select(tables["looks"], name)]
        lines += [f"relation: {describe_relation(one)}" for one in _select(tables["track_relations"], name)]
        lines += [_explain_review(one) for one in _select(tables["track_reviews"], name)]
        word = "not known yet" if finding is None else "seen" if finding is Finding.UNCHANGED else str(finding)
        explained.append(CampaignExplanation(campaign_id=name, finding=finding, word=word, lines=tuple(lines)))
    return TrackExplanation(
        track_id=track_id,
        building_id=track["building_id"],
        lines=tuple(_explain_track(track)),
        campaigns=tuple(explained),
    )


def _select(table: pa.Table, campaign_id: str) -> list[Row]:
    return [row for row in table.to_pylist() if row["campaign_id"] == campaign_id]


def _get_state(row: Row) -> TimelineState:
    return TimelineState(state=TrackState(row["track_state"]), evidence=StateEvidence(row["state_evidence"]))


def _format_day(time: datetime | None) -> str:
    return "at an unknown date" if time is None else f"{time:%Y-%m-%d}"


def _explain_track(track: Row) -> list[str]:
    place = ", ".join(str(part) for part in (track["facade"], track["storey"], track["element_name"]) if part)
    lines = [f"{track['defect_class']} on {place}; severity {track['severity']} by {track['severity_rule']}"]
    if track["withdrawn"]:
        lines.append("withdrawn: no campaign in the lake has this defect any more, since one was inspected anew")
    if track["first_campaign"] is not None:
        lines.append(
            f"first there in {track['first_campaign']} ({_format_day(track['first_seen_at'])}), last in "
            f"{track['last_campaign']} ({_format_day(track['last_seen_at'])}); detected in {track['detected_count']} "
            f"campaign{'' if track['detected_count'] == 1 else 's'}"
        )
    if track["trend_per_year"] is not None:
        lines.append(_explain_trend(track))
    if track["trend_remark"]:
        lines.append(f"trend: {track['trend_remark']}")
    return lines


def _explain_trend(track: Row) -> str:
    unit = _UNITS.get(track["trend_quantity"], "")
    name = str(track["trend_quantity"]).rpartition("_")[0].replace("_", " ")
    text = f"trend of the {name} over {track['trend_count']} campaigns: {track['trend_per_year']:+.3g} {unit} a year"
    if track["trend_low_per_year"] is not None:
        text += f" (with 95 % probability {track['trend_low_per_year']:+.3g} to {track['trend_high_per_year']:+.3g})"
    if track["next_limit"] is not None and track["next_limit_at"] is not None:
        latest = track["next_limit_to"]
        text += (
            f"; it becomes '{track['next_severity']}' at {track['next_limit']:.3g} {unit}, most likely "
            f"{_format_day(track['next_limit_at'])} (not before {_format_day(track['next_limit_from'])}, "
            f"{'perhaps never' if latest is None else f'not after {_format_day(latest)}'})"
        )
    return text


def _explain_state(state: Row, defects: Mapping[tuple[str, str], Row], states: Mapping[str, Row]) -> list[str]:
    finding = _get_state(state).finding
    defect = defects.get((state["campaign_id"], state["defect_id"] or ""))
    since = state["previous_campaign"]
    before = defects.get((since, states[since]["defect_id"] or "")) if since in states else None
    meaning = MEANINGS[finding]
    if finding is Finding.UNCHANGED and defect is not None and before is not None:
        kinds = before["defect_class"], defect["defect_class"]
        if kinds[0] != kinds[1]:
            meaning = f"detected again, as {kinds[1]} and no longer as {kinds[0]}; their sizes are not compared"
    lines = [f"{meaning} (evidence: {EVIDENCE[StateEvidence(state['state_evidence'])]})"]
    if state["state_remark"]:
        lines.append(state["state_remark"])
    if defect is not None:
        lines.append(
            f"it is defect {defect['defect_id']}: {defect['defect_class']}, {format_size(defect)}, "
            f"{describe_severity(defect)}, in {defect['photo_count']} photographs (best: {defect['best_photo_id']})"
        )
    if state["match_probability"] is not None:
        lines.append(
            f"probability that {state['defect_id']} is this track, among all candidates: "
            f"{_format_probability(state['match_probability'])}"
        )
    changes = select_main_changes(read_changes(state), state["defect_class"])
    if changes:
        years = state["years_since_previous"]
        after = f" in {years:.1f} years" if years is not None else ""
        size = f" ({format_size(before)})" if before is not None else ""
        told = ", ".join(f"{change}{' (significant)' if change.decisive else ''}" for change in changes)
        lines.append(f"change since {since}{size}{after}, with one standard error: {told}")
    return lines


def _explain_offset(offsets: Mapping[str, Mapping[str, Row]], before: str | None, name: str, facade: str) -> str:
    """The offset of a campaign's positions from those of the tracked one before it.

    Args:
        offsets: rows of ``frame_offsets`` by campaign and facade.
        before: the tracked campaign before; None: there is none.
        name: the campaign.
        facade: the facade of the track; the offset of the whole building where it has none of its own.
    """
    own = offsets[name]
    if own[""]["offset_outcome"] == OffsetOutcome.REFUSED:
        return f"not tracked: {own['']['detail']}"
    if before is None:
        return "the first campaign: later ones are compared in its frame"
    found = {one.facade: one for one in compute_relative_offsets(offsets[before], own)}
    offset = found.get(facade, found[""])
    where = f"facade {offset.facade}" if offset.facade else "whole building"
    if offset.xyz_m is None or offset.sigma_m is None:
        return f"offset of the frames ({where}) not estimated: {offset.remark}"
    values = ", ".join(
        f"{100 * value:+.1f} ± {100 * sigma:.1f} cm {axis}"
        for value, sigma, axis in zip(offset.xyz_m, offset.sigma_m, ("east", "north", "up"), strict=True)
    )
    return (
        f"the campaign's positions are offset from those of {before}, the campaign before, by {values} ({where}, from "
        f"{offset.counts[1]} defects); candidates are compared without it"
    )


def _explain_candidates(
    candidates: pa.Table,
    campaign_id: str,
    defects: Mapping[tuple[str, str], Row],
    track: Row,
    states: Mapping[str, Row],
) -> list[str]:
    """Sentences on the candidates of a campaign, the taken one first.

    Args:
        candidates: rows of ``track_candidates`` of the track.
        campaign_id: the campaign.
        defects: rows of ``defects`` by campaign and defect.
        track: the track's row.
        states: its states by campaign.
    """
    rows = sorted(_select(candidates, campaign_id), key=lambda row: (not row["matched"], -row["match_probability"]))
    known_before = track["first_campaign"] is not None and track["first_campaign"] != campaign_id
    if not rows:
        if known_before and campaign_id in states:
            return ["no defect of this campaign lies near enough to be the same one"]
        return []
    return [_explain_candidate(row, defects.get((campaign_id, row["defect_id"]))) for row in rows]


def _explain_candidate(row: Row, defect: Row | None) -> str:
    what = f" ({defect['defect_class']}, {format_size(defect)})" if defect is not None else ""
    return (
        f"candidate {row['defect_id']}{what}: {100 * row['displacement_m']:.1f} cm from the expected place, which is "
        f"{row['mahalanobis_distance']:.1f} times its uncertainty (Mahalanobis distance); by place, class and size the "
        f"odds are {_format_odds(row['log_odds'])}; probability {_format_probability(row['match_probability'])}: "
        f"{'taken' if row['matched'] else 'not taken'}"
    )


def _format_odds(log_odds: float) -> str:
    """The odds in words of ``log_odds``, which is told beside them."""
    odds = math.exp(min(abs(log_odds), 700.0))
    number = f"more than {_ODDS_MAX:,.0f}" if odds > _ODDS_MAX else f"{odds:,.0f}" if odds >= 10 else f"{odds:.1f}"
    side = f"{number} to 1 for" if log_odds >= 0 else f"{number} to 1 against"
    return f"{side} its being the same defect (log odds {log_odds:+.1f})"


def _format_probability(value: float) -> str:
    return "above 0.999" if value > 0.999 else "below 0.001" if value < 0.001 else f"{value:.3f}"


def _explain_look(look: Row) -> str:
    other = look["compared_campaign"]
    text = (
        f"look at the place, compared with {other}, which detected {look['defect_id']}: "
        f"{_VERDICTS[LookVerdict(look['look_verdict'])]} ({look['look_count']} photographs here, "
        f"{look['compared_count']} there"
    )
    if look["look_photo_id"] and look["compared_photo_id"]:
        text += f"; best {look['look_photo_id']} and {look['compared_photo_id']}"
    text += ")"
    figures = []
    if look["fading_extent"] is not None:
        faded = f"largest part that faded into the wall: {100 * look['fading_extent']:.0f} % of the defect's diagonal"
        if look["fading_sigmas"] is not None:
            faded += f", {look['fading_sigmas']:.1f} times what differs around the defect"
        figures.append(faded)
    if look["darkening_extent"] is not None:
        figures.append(f"largest part that departed from the wall: {100 * look['darkening_extent']:.0f} %")
    if look["look_similarity"] is not None:
        figures.append(
            f"similarity of all within the defect's extents {look['look_similarity']:.2f} (1: the same, 0: nothing in "
            "common; a thin crack weighs little in it)"
        )
    if look["surroundings_similarity"] is not None:
        figures.append(f"of the wall around it {look['surroundings_similarity']:.2f}")
    if look["contrast_difference"] is not None:
        figures.append(f"largest differences: {look['contrast_difference']:.1f} times the defect's contrast")
    if look["contrast_left"] is not None:
        figures.append(f"contrast left within the extents: {100 * look['contrast_left']:.0f} %")
    if look["look_cell_mm"] is not None:
        figures.append(f"compared in cells of {look['look_cell_mm']:.1f} mm")
    return f"{text}; {', '.join(figures)}" if figures else text


def _explain_review(row: Row) -> str:
    note = f": {row['note']}" if row["note"] else ""
    return f"review of {row['reviewed_at']:%Y-%m-%d} by {row['reviewer']}: {row['track_state'].replace('_', ' ')}{note}"
