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
    REPAIRED_BETWEEN = "repaired between"
    GROWN = "grown"
    CLASS_CHANGED = "class changed"
    NEW = "new"
    FIRST_SEEN = "first seen"
    REGRADED = "regraded"
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
    Finding.REPAIRED_BETWEEN: "there in both campaigns, but repaired between them: the repair did not hold",
    Finding.GROWN: "larger, beyond the errors of both campaigns",
    Finding.CLASS_CHANGED: "of another class now, such as a crack that spalled; sizes of two classes are not compared",
    Finding.NEW: "its place was imaged well enough before, and did not show it",
    Finding.FIRST_SEEN: "its place was never imaged well enough before: its age is unknown",
    Finding.REGRADED: "of another severity now, although no change of its size is beyond the errors",
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
_STAR = "M0-9.5 2.6-3.4 9-2.9 4.1 1.4 5.6 7.8 0 4.4-5.6 7.8-4.1 1.4-9-2.9-2.6-3.4Z"
_SHAPES = {
    "star": f'<path d="{_STAR}"/>',
    "star_open": f'<path d="{_STAR}" class="open"/>',
    "hourglass": '<path d="M-7-8H7L-7 8H7Z"/>',
    "chevrons": '<path d="M-7 8 0 1 7 8M-7-1 0-8 7-1" class="line"/>',
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
    Finding.REPAIRED_BETWEEN: Style(colour="#d55e00", shape=_SHAPES["star_open"]),
    Finding.GROWN: Style(colour="#d55e00", shape=_SHAPES["up"]),
    Finding.CLASS_CHANGED: Style(colour="#d55e00", shape=_SHAPES["hourglass"]),
    Finding.NEW: Style(colour="#cc79a7", shape=_SHAPES["diamond"]),
    Finding.FIRST_SEEN: Style(colour="#cc79a7", shape=_SHAPES["diamond_open"]),
    Finding.REGRADED: Style(colour="#e69f00", shape=_SHAPES["chevrons"]),
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


@dataclass(frozen=True, kw_only=True)
class SpanChange:
    """How the detections differ that stand for both campaigns: ``growth`` 1 grown, -1 shrunk, 0 neither beyond the
    errors; whether the class, and whether the severity is another one."""

    growth: int = 0
    other_class: bool = False
    other_severity: bool = False


def combine_states(
    before: Sequence[TimelineState | None], after: Sequence[TimelineState], change: SpanChange
) -> Finding:
    """What became of a defect over a span of campaigns: the later campaign counts against the earlier one.

    What was taken back between them (growth, a change of class) is none; a repair between them that did not hold is a
    finding of its own.

    Args:
        before: its states up to the earlier campaign in order of time; None: it was not known then.
        after: its states in the later campaigns of the span, at least one, in order of time.
        change: what differs between the detections of both campaigns.

    Returns:
        The finding.
    """
    last = after[-1]
    states = {one.state for one in after}
    was_repaired = _was_repaired(before)
    if last.state not in THERE:
        unopened = last.state is TrackState.REPAIRED and was_repaired and not states & THERE
        return Finding.STILL_REPAIRED if unopened else last.finding
    if was_repaired:
        return Finding.REOPENED
    if not before or before[-1] is None:
        return Finding.NEW if TrackState.NEW in states else Finding.FIRST_SEEN
    if states & {TrackState.REPAIRED, TrackState.REOPENED}:
        return Finding.REPAIRED_BETWEEN
    if change.growth:
        return Finding.GROWN if change.growth > 0 else Finding.SHRUNK
    if change.other_class:
        return Finding.CLASS_CHANGED
    if change.other_severity:
        return Finding.REGRADED
    return last.finding if last.state is TrackState.SEEN else Finding.UNCHANGED


def _was_repaired(before: Sequence[TimelineState | None]) -> bool:
    """Whether the defect was repaired, as far as that was known last."""
    known = (one.state for one in reversed(before) if one is not None)
    return next((state is TrackState.REPAIRED for state in known if state in THERE | {TrackState.REPAIRED}), False)
