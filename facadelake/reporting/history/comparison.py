"""Comparison of two campaigns of a building, from the tables of its history; no photograph is read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from facadelake.campaigns import find_capture_time
from facadelake.core.errors import InputDataError
from facadelake.reporting.history.compared_track import ComparedTrack, TrackSpan, compare_track, create_span
from facadelake.reporting.history.detections import OBSERVATION_COLUMNS, Detections, read_detections
from facadelake.reporting.history.findings import Finding
from facadelake.reporting.history.relative_offsets import RelativeOffset, compute_relative_offsets, index_offsets
from facadelake.reporting.severity_order import rank_severity, read_rule_packs
from facadelake.severity import RulePack
from facadelake.tracking import SizeDifference
from schemas.vocabulary import OffsetOutcome, TrendQuantity

Row = Mapping[str, Any]
TABLES = (
    "campaigns", "tracks", "track_states", "track_relations", "looks", "frame_offsets", "defects", "observations",
)  # fmt: skip
READ_COLUMNS = {"observations": OBSERVATION_COLUMNS}
_URGENT = (Finding.REOPENED, Finding.REPAIRED_BETWEEN, Finding.GROWN, Finding.CLASS_CHANGED)
_ORDER = list(Finding)


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
        return tuple(track for track in self.tracks if track.is_listed)

    @property
    def there_count(self) -> int:
        """Number of tracks that one of both campaigns shows; the others were repaired before, or are not seen in it."""
        return sum(track.is_there for track in self.tracks)

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
    detections = read_detections(tables["defects"], tables["observations"])
    relations = _index_relations(tables["track_relations"])
    states: dict[str, dict[str, Row]] = {}
    for row in tables["track_states"].to_pylist():
        states.setdefault(row["track_id"], {})[row["campaign_id"]] = row
    spans = [create_span(track_id, own, names, (earlier, later), detections) for track_id, own in states.items()]
    spans = [span for span in spans if span.is_known]
    changes = _compare_sizes(spans, detections)
    packs = read_rule_packs([row for row in detections.rows.values() if row["severity_rule"] is not None])
    since = names[names.index(earlier) + 1 : names.index(later) + 1]
    tracks = []
    for span in spans:
        told = [describe_relation(row) for name in since for row in relations.get((name, span.track_id), ())]
        tracks.append(compare_track(span, changes.get(span.track_id, {}), told))
    tracks.sort(key=lambda track: _sort_key(track, packs))
    by_id = {row["campaign_id"]: row for row in ordered}
    return BuildingComparison(
        building_id=building_id,
        earlier=earlier,
        later=later,
        earlier_row=by_id[earlier],
        later_row=by_id[later],
        campaigns=tuple(names),
        tracks=tuple(tracks),
        offsets=tuple(compute_relative_offsets(offsets[earlier], offsets[later])),
        looks={(row["campaign_id"], row["track_id"]): row for row in tables["looks"].to_pylist()},
    )


def _compare_sizes(
    spans: Sequence[TrackSpan], detections: Detections
) -> dict[str, dict[TrendQuantity, SizeDifference]]:
    """Changes between the detections of both campaigns by track, significant over all of them."""
    pairs = {span.track_id: (span.before, span.after) for span in spans}
    known = {name: (one, two) for name, (one, two) in pairs.items() if one is not None and two is not None}
    return dict(zip(known, detections.compare(list(known.values())), strict=True))


def _sort_key(track: ComparedTrack, packs: Mapping[str, RulePack]) -> tuple[object, ...]:
    """What has opened or changed first, the most severe at the head; then by severity within each finding, those
    whose grade became worse before the others."""
    group = 0 if track.finding in _URGENT else _ORDER.index(track.finding)
    rank = rank_severity(track.place, packs)
    is_worse = (
        track.finding is Finding.REGRADED and track.before is not None and rank < rank_severity(track.before, packs)
    )
    return group, not is_worse, rank, _ORDER.index(track.finding), -track.place["area_m2"], track.track_id


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
