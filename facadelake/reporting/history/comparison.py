"""Comparison of two campaigns of a building, from the tables of its history; no photograph is read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from facadelake.campaigns import find_capture_time
from facadelake.core.errors import InputDataError
from facadelake.reporting.history.findings import COUNTED_ONLY, Finding, TimelineState, combine_states
from facadelake.reporting.history.relative_offsets import RelativeOffset, compute_relative_offsets, index_offsets
from facadelake.reporting.history.size_changes import TrackSizeChange, sum_changes
from facadelake.reporting.severity_order import rank_severity, read_rule_packs
from schemas.vocabulary import OffsetOutcome, StateEvidence, TrackState

Row = Mapping[str, Any]
TABLES = ("campaigns", "tracks", "track_states", "track_relations", "looks", "frame_offsets", "defects")
_URGENT = (Finding.REOPENED, Finding.GROWN)
_ORDER = list(Finding)


@dataclass(frozen=True, kw_only=True, eq=False)
class TimelineEntry:
    """A track in one campaign: its state (None before it was known) and its defect (None where not detected)."""

    campaign_id: str
    state: TimelineState | None
    defect: Row | None


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedTrack:
    """One track in both campaigns of a comparison.

    ``place``: the defect (row of ``defects``) that tells its place: that of the later campaign, else the latest one
    before it, else the first one after it. ``before``, ``after``: the defects of both campaigns, None where not
    detected. ``changes``: since the detection in the earlier campaign, or before it. ``remark``: what else is known.
    """

    track_id: str
    finding: Finding
    evidence: StateEvidence
    place: Row
    before: Row | None
    after: Row | None
    changes: tuple[TrackSizeChange, ...]
    remark: str
    timeline: tuple[TimelineEntry, ...]

    @property
    def defect_class(self) -> str:
        """Class of the defect."""
        return str(self.place["defect_class"])


@dataclass(frozen=True, kw_only=True, eq=False)
class BuildingComparison:
    """Two campaigns of a building compared. ``tracks``: all of them, what matters most first."""

    building_id: str
    earlier: str
    later: str
    earlier_row: Row
    later_row: Row
    campaigns: tuple[str, ...]
    tracks: tuple[ComparedTrack, ...]
    offsets: tuple[RelativeOffset, ...]
    looks: Mapping[tuple[str, str], Row]

    @property
    def listed(self) -> tuple[ComparedTrack, ...]:
        """The tracks that need attention: all but the unchanged ones."""
        return tuple(track for track in self.tracks if track.finding not in COUNTED_ONLY)

    def count_findings(self) -> dict[Finding, int]:
        """Number of tracks by finding, in the order of what matters; only those that occur."""
        counts = Counter(track.finding for track in self.tracks)
        return {finding: counts[finding] for finding in Finding if counts[finding]}

    def count_by_place(self) -> dict[tuple[str, str], dict[Finding, int]]:
        """The same by facade and storey, sorted by their names."""
        counts: dict[tuple[str, str], Counter[Finding]] = {}
        for track in self.tracks:
            place = (track.place["facade"] or "no facade", track.place["storey"] or "no storey")
            counts.setdefault(place, Counter())[track.finding] += 1
        return {place: {f: counts[place][f] for f in Finding if counts[place][f]} for place in sorted(counts)}


def order_campaigns(campaigns: pa.Table) -> list[Row]:
    """Rows of table ``campaigns`` of one building in order of capture, then of id, as tracking orders them."""
    rows: list[Row] = campaigns.to_pylist()
    times = [find_capture_time(row["campaign_id"], campaigns.slice(k, 1))[0] for k, row in enumerate(rows)]
    order = sorted(range(len(rows)), key=lambda k: (times[k], rows[k]["campaign_id"]))
    return [rows[k] for k in order]


def choose_campaigns(ordered: Sequence[Row], earlier: str | None, later: str | None) -> tuple[str, str]:
    """The two campaigns to compare: those named, else the two latest; raises InputDataError where that cannot be."""
    known = [row["campaign_id"] for row in ordered]
    building = ordered[0]["building_id"] if ordered else "?"
    for name in (earlier, later):
        if name is not None and name not in known:
            raise InputDataError(
                f"the lake has no campaign '{name}' of building '{building}'; it has {', '.join(known)}"
            )
    if len(known) < 2:
        raise InputDataError(
            f"building '{building}' has one campaign in the lake ({', '.join(known)}), and a comparison needs two; "
            "inspect the next one first"
        )
    later = later if later is not None else known[-1]
    if earlier is None:
        if later == known[0]:
            raise InputDataError(f"campaign '{later}' is the first of '{building}'; there is none before it")
        earlier = known[known.index(later) - 1]
    if known.index(earlier) >= known.index(later):
        raise InputDataError(
            f"campaign '{earlier}' was not photographed before '{later}'; name the earlier one first (in order: "
            f"{', '.join(known)})"
        )
    return earlier, later


def compare_campaigns(tables: Mapping[str, pa.Table], earlier: str | None, later: str | None) -> BuildingComparison:
    """Compare two campaigns of a building.

    Args:
        tables: tables ``TABLES`` of the building.
        earlier: id of the earlier campaign; None: the one before ``later``.
        later: id of the later campaign; None: the latest.

    Returns:
        The comparison.

    Raises:
        InputDataError: a campaign is unknown, the order is wrong, or the campaigns are not tracked.
    """
    ordered = order_campaigns(tables["campaigns"])
    earlier, later = choose_campaigns(ordered, earlier, later)
    names = [row["campaign_id"] for row in ordered]
    building_id = str(ordered[0]["building_id"])
    offsets = index_offsets(tables["frame_offsets"])
    _require_tracked(building_id, (earlier, later), offsets)
    defects = {(row["campaign_id"], row["defect_id"]): row for row in tables["defects"].to_pylist()}
    relations = _index_relations(tables["track_relations"])
    states: dict[str, dict[str, Row]] = {}
    for row in tables["track_states"].to_pylist():
        states.setdefault(row["track_id"], {})[row["campaign_id"]] = row
    packs = read_rule_packs([row for row in defects.values() if row["severity_rule"] is not None])
    tracks = []
    for track_id, own in states.items():
        track = _compare_track(track_id, own, names, (earlier, later), defects, relations)
        if track is not None:
            tracks.append((rank_severity(track.place, packs), track))
    tracks.sort(key=lambda pair: _sort_key(*pair))
    by_id = {row["campaign_id"]: row for row in ordered}
    return BuildingComparison(
        building_id=building_id,
        earlier=earlier,
        later=later,
        earlier_row=by_id[earlier],
        later_row=by_id[later],
        campaigns=tuple(names),
        tracks=tuple(track for _, track in tracks),
        offsets=tuple(compute_relative_offsets(offsets[earlier], offsets[later])),
        looks={(row["campaign_id"], row["track_id"]): row for row in tables["looks"].to_pylist()},
    )


def _sort_key(rank: float, track: ComparedTrack) -> tuple[object, ...]:
    """Reopened and grown ones first, the most severe at the head; then by severity within each finding."""
    group = 0 if track.finding in _URGENT else _ORDER.index(track.finding)
    return group, rank, _ORDER.index(track.finding), -track.place["area_m2"], track.track_id


def _compare_track(
    track_id: str,
    states: Mapping[str, Row],
    names: Sequence[str],
    pair: tuple[str, str],
    defects: Mapping[tuple[str, str], Row],
    relations: Mapping[tuple[str, str], Sequence[Row]],
) -> ComparedTrack | None:
    """One track; None where it was not known in either campaign.

    Args:
        track_id: its id.
        states: its rows of ``track_states`` by campaign.
        names: the building's campaigns in order.
        pair: the earlier and the later campaign.
        defects: rows of ``defects`` by campaign and defect.
        relations: rows of ``track_relations`` by campaign and track.
    """
    timeline = tuple(_create_entry(name, states.get(name), defects) for name in names)
    first, last = (names.index(name) for name in pair)
    span = [entry.state for entry in timeline[first + 1 : last + 1] if entry.state is not None]
    if timeline[last].state is None or not span:
        return None
    place = _choose_place(timeline, last)
    if place is None:
        return None
    told = [states[name]["state_remark"] for name in names[first + 1 : last + 1] if name in states]
    told += [
        describe_relation(row) for name in names[first + 1 : last + 1] for row in relations.get((name, track_id), ())
    ]
    reviewer = states[pair[1]]["reviewer"]
    told += [f"by {reviewer}"] if reviewer else []
    told += _tell_what_was_before(timeline, first, last)
    return ComparedTrack(
        track_id=track_id,
        finding=combine_states(timeline[first].state, span),
        evidence=span[-1].evidence,
        place=place,
        before=timeline[first].defect,
        after=timeline[last].defect,
        changes=sum_changes(states, names, pair),
        remark="; ".join(dict.fromkeys(text for text in told if text)),
        timeline=timeline,
    )


def _create_entry(campaign_id: str, row: Row | None, defects: Mapping[tuple[str, str], Row]) -> TimelineEntry:
    if row is None:
        return TimelineEntry(campaign_id=campaign_id, state=None, defect=None)
    state = TimelineState(state=TrackState(row["track_state"]), evidence=StateEvidence(row["state_evidence"]))
    return TimelineEntry(
        campaign_id=campaign_id, state=state, defect=defects.get((campaign_id, row["defect_id"] or ""))
    )


def _choose_place(timeline: Sequence[TimelineEntry], last: int) -> Row | None:
    """The defect of the campaign ``last``, else the latest before it, else the first after it."""
    nearest = [*reversed(timeline[: last + 1]), *timeline[last + 1 :]]
    return next((entry.defect for entry in nearest if entry.defect is not None), None)


def _tell_what_was_before(timeline: Sequence[TimelineEntry], first: int, last: int) -> list[str]:
    """Where the earlier campaign did not detect it although it was known, when it was detected last."""
    state = timeline[first].state
    if state is None or timeline[first].defect is not None:
        return []
    if state.evidence is StateEvidence.LOOKS_THE_SAME:
        return [f"in {timeline[first].campaign_id} it was seen by comparison alone"]
    earlier = [entry.campaign_id for entry in timeline[:first] if entry.defect is not None]
    word = str(state.finding)
    seen = f", detected last in {earlier[-1]}" if earlier else ""
    return [f"{word} in {timeline[first].campaign_id}{seen}"]


def describe_relation(row: Row) -> str:
    """A row of ``track_relations`` in words."""
    other = f" {row['other_track_id']}" if row["other_track_id"] else ""
    text = f"{row['track_relation'].replace('_', ' ')}{other}"
    return f"{text}: {row['detail']}" if row["detail"] else text


def _index_relations(relations: pa.Table) -> dict[tuple[str, str], list[Row]]:
    found: dict[tuple[str, str], list[Row]] = {}
    for row in relations.to_pylist():
        found.setdefault((row["campaign_id"], row["track_id"]), []).append(row)
    return found


def _require_tracked(building_id: str, names: Sequence[str], offsets: Mapping[str, Mapping[str, Row]]) -> None:
    for name in names:
        if name not in offsets:
            raise InputDataError(
                f"campaign '{name}' of building '{building_id}' is not tracked: the lake has no history of it; run "
                f"'facadelake track {building_id}'"
            )
        whole = offsets[name].get("")
        if whole is not None and whole["offset_outcome"] == OffsetOutcome.REFUSED:
            raise InputDataError(f"campaign '{name}' of building '{building_id}' is not tracked: {whole['detail']}")
