"""One track between two campaigns: which detections stand for them, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from facadelake.reporting.history.detections import Detections
from facadelake.reporting.history.findings import (
    COUNTED_ONLY,
    THERE,
    Finding,
    SpanChange,
    TimelineState,
    combine_states,
)
from facadelake.reporting.history.size_changes import TrackSizeChange, list_changes
from facadelake.tracking import SizeDifference, judge_growth
from schemas.vocabulary import StateEvidence, TrackState, TrendQuantity

Row = Mapping[str, Any]
# States that are news of their own, where they lie between the campaigns of a comparison.
_EVENTS = frozenset(TrackState) - {TrackState.SEEN, TrackState.NOT_FOUND, TrackState.NOT_IMAGED}


@dataclass(frozen=True, kw_only=True, eq=False)
class TimelineEntry:
    """A track in one campaign: its state (None before it was known) and its defect (None where not detected)."""

    campaign_id: str
    state: TimelineState | None
    defect: Row | None

    @property
    def is_there(self) -> bool:
        """Whether the campaign shows the defect."""
        return self.state is not None and self.state.state in THERE


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackSpan:
    """A track over the campaigns of a comparison: rows of ``track_states`` by campaign, and entries of all campaigns,
    of which ``first`` and ``last`` are compared."""

    track_id: str
    states: Mapping[str, Row]
    timeline: tuple[TimelineEntry, ...]
    first: int
    last: int

    @property
    def is_known(self) -> bool:
        """Whether the history of the later campaign has the track, and any defect tells its place."""
        return self.timeline[self.last].state is not None and any(one.defect is not None for one in self.timeline)

    @property
    def before(self) -> Row | None:
        """The detection that stands for the earlier campaign: the latest one up to it."""
        return _choose_latest(self.timeline[: self.first + 1])

    @property
    def after(self) -> Row | None:
        """The detection that stands for the later campaign: the latest one since the earlier campaign."""
        return _choose_latest(self.timeline[self.first + 1 : self.last + 1])

    @property
    def place(self) -> Row:
        """The detection that tells the place: the latest up to the later campaign, else the first one after it."""
        found = self.after or self.before or _choose_latest(self.timeline[: self.last : -1])
        assert found is not None
        return found


def _choose_latest(entries: Sequence[TimelineEntry]) -> Row | None:
    return next((entry.defect for entry in reversed(entries) if entry.defect is not None), None)


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedTrack:
    """One track in both campaigns of a comparison.

    ``place``: the defect that tells its place: that of the later campaign, else the latest one before it, else the
    first one after it. ``before``, ``after``: the detections that stand for both campaigns, the latest one up to the
    earlier campaign and the latest one since; None where there is none. ``changes``: from one to the other.
    ``remark``: what else is known.
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
    pair: tuple[str, str]

    @property
    def defect_class(self) -> str:
        """Class of the defect."""
        return str(self.place["defect_class"])

    @property
    def is_listed(self) -> bool:
        """Whether it needs attention."""
        return self.finding not in COUNTED_ONLY

    @property
    def is_there_later(self) -> bool:
        """Whether the later campaign shows the defect."""
        return any(entry.is_there for entry in self.timeline if entry.campaign_id == self.pair[1])

    @property
    def is_there(self) -> bool:
        """Whether one of both campaigns shows the defect."""
        return any(entry.is_there for entry in self.timeline if entry.campaign_id in self.pair)

    def find_detection(self, campaign_id: str) -> Row | None:
        """The defect that a campaign detected; None where it did not."""
        return next((entry.defect for entry in self.timeline if entry.campaign_id == campaign_id), None)


def create_span(
    track_id: str, states: Mapping[str, Row], names: Sequence[str], pair: tuple[str, str], detections: Detections
) -> TrackSpan:
    """A track over the campaigns of a comparison.

    Args:
        track_id: its id.
        states: its rows of ``track_states`` by campaign.
        names: the building's campaigns in order.
        pair: the earlier and the later campaign.
        detections: the defects of the building.
    """
    return TrackSpan(
        track_id=track_id,
        states=states,
        timeline=tuple(_create_entry(name, states.get(name), detections) for name in names),
        first=names.index(pair[0]),
        last=names.index(pair[1]),
    )


def _create_entry(campaign_id: str, row: Row | None, detections: Detections) -> TimelineEntry:
    if row is None:
        return TimelineEntry(campaign_id=campaign_id, state=None, defect=None)
    state = TimelineState(state=TrackState(row["track_state"]), evidence=StateEvidence(row["state_evidence"]))
    return TimelineEntry(campaign_id=campaign_id, state=state, defect=detections.find(campaign_id, row["defect_id"]))


def compare_track(
    span: TrackSpan, changes: Mapping[TrendQuantity, SizeDifference], relations: Sequence[str]
) -> ComparedTrack:
    """What became of a track.

    Args:
        span: the track.
        changes: between the detections of both campaigns; empty where there is none.
        relations: its relations in the later campaigns of the span, in words.
    """
    timeline, before, after = span.timeline, span.before, span.after
    later = timeline[span.last].state
    assert later is not None
    if later.state not in THERE:  # what was detected between says nothing of the later campaign
        changes = {}
    both = before is not None and after is not None
    change = SpanChange(
        growth=_judge_growth(span, later, changes),
        other_class=both and before["defect_class"] != after["defect_class"],  # type: ignore[index]
        other_severity=both and before["severity"] != after["severity"],  # type: ignore[index]
    )
    after_states = [entry.state for entry in timeline[span.first + 1 : span.last + 1] if entry.state is not None]
    return ComparedTrack(
        track_id=span.track_id,
        finding=combine_states([entry.state for entry in timeline[: span.first + 1]], after_states, change),
        evidence=later.evidence,
        place=span.place,
        before=before,
        after=after,
        changes=list_changes(changes, before["campaign_id"], after["campaign_id"]) if before and after else (),
        remark="; ".join(dict.fromkeys(text for text in [*_list_remarks(span), *relations] if text)),
        timeline=timeline,
        pair=(timeline[span.first].campaign_id, timeline[span.last].campaign_id),
    )


def _judge_growth(span: TrackSpan, later: TimelineState, changes: Mapping[TrendQuantity, SizeDifference]) -> int:
    """1 grown, -1 shrunk, 0 neither; of the change since the detection before, a person's word counts."""
    if later.evidence is StateEvidence.REVIEW:
        told = {TrackState.GROWN: 1, TrackState.SHRUNK: -1}.get(later.state, 0)
        names = [entry.campaign_id for entry in span.timeline[: span.first + 1]]
        previous = span.states[span.timeline[span.last].campaign_id]["previous_campaign"]
        if told or previous in names:
            return told
    return judge_growth(changes)[0]


def _list_remarks(span: TrackSpan) -> list[str]:
    """What else is known: of the campaigns between and of the earlier one, of grades and by whom."""
    timeline = span.timeline
    later = timeline[span.first + 1 : span.last + 1]
    told = [span.states[entry.campaign_id]["state_remark"] for entry in later if entry.state is not None]
    reviewer = span.states[timeline[span.last].campaign_id]["reviewer"]
    told += [f"by {reviewer}"] if reviewer else []
    told += _tell_what_was_before(timeline, span.first)
    states = [(entry.state.state, entry.campaign_id) for entry in timeline if entry.state is not None]
    repairs = {name for (one, _), (state, name) in pairwise(states) if one is state is TrackState.REPAIRED}
    between = {entry.campaign_id for entry in timeline[span.first + 1 : span.last]} - repairs  # told once
    events = [f"{state.replace('_', ' ')} in {name}" for state, name in states if state in _EVENTS and name in between]
    told += [f"between: {', '.join(events)}"] if events else []
    before, after = span.before, span.after
    if before is not None and after is not None and before["severity_rule"] != after["severity_rule"]:
        told.append(
            f"graded by {before['severity_rule']} in {before['campaign_id']}, by {after['severity_rule']} in "
            f"{after['campaign_id']}: the words do not compare"
        )
    return [text for text in told if text]


def _tell_what_was_before(timeline: Sequence[TimelineEntry], first: int) -> list[str]:
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
