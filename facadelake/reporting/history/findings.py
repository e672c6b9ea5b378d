"""What a comparison of two campaigns says of a defect: a closed list, with colour and shape of each.

The states of ``track_states`` are of one campaign against those before it; a comparison may span several campaigns, and
tells apart what a reader acts on differently: a detector that missed a defect, and a repair that is no news.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from schemas.vocabulary import StateEvidence, TrackState

THERE = frozenset(
    {TrackState.NEW, TrackState.FIRST_SEEN, TrackState.SEEN, TrackState.GROWN, TrackState.SHRUNK, TrackState.REOPENED}
)


class Finding(StrEnum):
    """What became of a defect between two campaigns; in the order of what matters."""

    REOPENED = "reopened"
    GROWN = "grown"
    NEW = "new"
    FIRST_SEEN = "first seen"
    NOT_IMAGED = "not imaged"
    NOT_FOUND = "not found"
    MISSED = "missed by the detector"
    SHRUNK = "shrunk"
    REPAIRED = "repaired"
    UNCHANGED = "unchanged"
    STILL_REPAIRED = "still repaired"


# Findings that need no attention are counted, not listed.
COUNTED_ONLY = frozenset({Finding.UNCHANGED, Finding.STILL_REPAIRED})
MEANINGS: dict[Finding, str] = {
    Finding.REOPENED: "there again after it was repaired",
    Finding.GROWN: "larger, beyond the errors of both campaigns",
    Finding.NEW: "its place was imaged well enough before, and did not show it",
    Finding.FIRST_SEEN: "its place was never imaged well enough before: its age is unknown",
    Finding.NOT_IMAGED: "its place is in no photograph, or hidden: nothing is known of it now",
    Finding.NOT_FOUND: "its place was imaged, it was not detected, and the photographs decide neither way",
    Finding.MISSED: "still there: its place looks as it did, but the detector did not report it",
    Finding.SHRUNK: "smaller, beyond the errors of both campaigns",
    Finding.REPAIRED: "its place was imaged, it is gone, and the look of its place changed",
    Finding.UNCHANGED: "detected again; no change beyond the errors",
    Finding.STILL_REPAIRED: "repaired before, and still so",
}


@dataclass(frozen=True, kw_only=True)
class Style:
    """Colour (Okabe and Ito 2008) and shape of a finding or a state; ``shape``: SVG in a square of -10 to 10.

    Shapes differ in outline, so that they are told apart without colours and in print.
    """

    colour: str
    shape: str


_CIRCLE = '<circle r="7"/>'
_SHAPES = {
    "star": '<path d="M0-9.5 2.6-3.4 9-2.9 4.1 1.4 5.6 7.8 0 4.4-5.6 7.8-4.1 1.4-9-2.9-2.6-3.4Z"/>',
    "up": '<path d="M0-8.5 8.5 6.5-8.5 6.5Z"/>',
    "down": '<path d="M0 8.5 8.5-6.5-8.5-6.5Z"/>',
    "diamond": '<path d="M0-9 9 0 0 9-9 0Z"/>',
    "diamond_open": '<path d="M0-8 8 0 0 8-8 0Z" class="open"/>',
    "square_open": '<path d="M-6.5-6.5H6.5V6.5H-6.5Z" class="open"/>',
    "cross": '<path d="M-6.5-6.5 6.5 6.5M6.5-6.5-6.5 6.5" class="line"/>',
    "circle_open": '<circle r="6.5" class="open"/>',
    "circle": '<circle r="5"/>',
    "tick": '<path d="M-7 0-2 6 8-6" class="line"/>',
    "square": '<path d="M-6-6H6V6H-6Z"/>',
}
STYLES: dict[Finding, Style] = {
    Finding.REOPENED: Style(colour="#d55e00", shape=_SHAPES["star"]),
    Finding.GROWN: Style(colour="#d55e00", shape=_SHAPES["up"]),
    Finding.NEW: Style(colour="#cc79a7", shape=_SHAPES["diamond"]),
    Finding.FIRST_SEEN: Style(colour="#cc79a7", shape=_SHAPES["diamond_open"]),
    Finding.NOT_IMAGED: Style(colour="#000000", shape=_SHAPES["square_open"]),
    Finding.NOT_FOUND: Style(colour="#e69f00", shape=_SHAPES["cross"]),
    Finding.MISSED: Style(colour="#0072b2", shape=_SHAPES["circle_open"]),
    Finding.SHRUNK: Style(colour="#56b4e9", shape=_SHAPES["down"]),
    Finding.REPAIRED: Style(colour="#009e73", shape=_SHAPES["tick"]),
    Finding.UNCHANGED: Style(colour="#0072b2", shape=_SHAPES["circle"]),
    Finding.STILL_REPAIRED: Style(colour="#009e73", shape=_SHAPES["square"]),
}


@dataclass(frozen=True, kw_only=True)
class TimelineState:
    """State of a track in one campaign with its evidence, as in ``track_states``."""

    state: TrackState
    evidence: StateEvidence

    @property
    def finding(self) -> Finding:
        """The finding that stands for the state in a timeline."""
        if self.state is TrackState.SEEN:
            return Finding.MISSED if self.evidence is StateEvidence.LOOKS_THE_SAME else Finding.UNCHANGED
        return _OF_STATE[self.state]


_OF_STATE = {
    TrackState.NEW: Finding.NEW,
    TrackState.FIRST_SEEN: Finding.FIRST_SEEN,
    TrackState.GROWN: Finding.GROWN,
    TrackState.SHRUNK: Finding.SHRUNK,
    TrackState.REPAIRED: Finding.REPAIRED,
    TrackState.NOT_FOUND: Finding.NOT_FOUND,
    TrackState.NOT_IMAGED: Finding.NOT_IMAGED,
    TrackState.REOPENED: Finding.REOPENED,
}


def combine_states(before: TimelineState | None, after: Sequence[TimelineState]) -> Finding:
    """What became of a defect over a span of campaigns.

    Args:
        before: its state in the first campaign of the span; None: it was not known there.
        after: its states in the later campaigns of the span, at least one, in order of time.

    Returns:
        The finding. A change of size that was taken back within the span is none.
    """
    last = after[-1]
    states = [one.state for one in after]
    if last.state not in THERE:
        if last.state is TrackState.REPAIRED and before is not None and before.state is TrackState.REPAIRED:
            return Finding.STILL_REPAIRED if set(states) <= {TrackState.REPAIRED} else Finding.REPAIRED
        return last.finding
    if TrackState.REOPENED in states:
        return Finding.REOPENED
    if before is None:
        return Finding.NEW if TrackState.NEW in states else Finding.FIRST_SEEN
    steps = states.count(TrackState.GROWN) - states.count(TrackState.SHRUNK)
    if steps:
        return Finding.GROWN if steps > 0 else Finding.SHRUNK
    return last.finding if last.state is TrackState.SEEN else Finding.UNCHANGED
