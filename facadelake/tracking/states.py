"""What became of a defect in each campaign, from its sightings, the looks at its place, and its change of size.

The closed list of states is ``schemas.vocabulary.TrackState``; this module is their definition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum


class TrackState(StrEnum):
    """State of a track in a campaign."""

    NEW = "new"
    FIRST_SEEN = "first_seen"
    SEEN = "seen"
    GROWN = "grown"
    SHRUNK = "shrunk"
    REPAIRED = "repaired"
    NOT_FOUND = "not_found"
    NOT_IMAGED = "not_imaged"
    REOPENED = "reopened"


class Verdict(StrEnum):
    """What a look at a defect's place in another campaign says.

    ``same``: the defect looks as it did. ``gone``: the wall is recognised, and the defect's look is not there any
    more. ``undecided``: imaged, and evidence for neither. ``hidden``: something else is before the wall.
    ``unseen``: no photograph shows the place well enough.
    """

    SAME = "same"
    GONE = "gone"
    UNDECIDED = "undecided"
    HIDDEN = "hidden"
    UNSEEN = "unseen"


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """A defect of a campaign that belongs to the track; ``change``: 1 grown, -1 shrunk, 0 neither, against the sighting
    before."""

    defect_id: str
    change: int = 0


@dataclass(frozen=True, kw_only=True)
class StateInCampaign:
    """State of a track in a campaign; ``by_comparison``: seen by the look of its place, without a detection."""

    campaign_id: str
    state: TrackState
    by_comparison: bool


def decide_states(
    campaigns: Sequence[str], sightings: Mapping[str, Sighting], looks: Mapping[str, Verdict]
) -> list[StateInCampaign]:
    """States of one track in every campaign from the first in which it was there.

    Args:
        campaigns: the building's campaigns in order of capture.
        sightings: sightings of the track by campaign, one at least.
        looks: verdict on its place, against the nearest sighting, in the campaigns without a sighting.

    Returns:
        One state a campaign. Campaigns before the first sighting have one only where the look was the same (the
        detector missed it then).
    """
    first = next(k for k, campaign in enumerate(campaigns) if campaign in sightings)
    begin = first
    # Backwards: a place that looked the same before its first sighting bore the defect already.
    for k in range(first - 1, -1, -1):
        verdict = looks.get(campaigns[k], Verdict.UNSEEN)
        if verdict is Verdict.SAME:
            begin = k
        elif verdict is Verdict.GONE:
            break
    seen_well_before = any(
        looks.get(campaign, Verdict.UNSEEN) is Verdict.GONE for campaign in campaigns[:begin]
    )
    states: list[StateInCampaign] = []
    repaired = False
    for k in range(begin, len(campaigns)):
        campaign = campaigns[k]
        sighting, verdict = sightings.get(campaign), looks.get(campaign, Verdict.UNSEEN)
        there = sighting is not None or verdict is Verdict.SAME
        if k == begin:
            state = TrackState.NEW if seen_well_before else TrackState.FIRST_SEEN
        elif there and repaired:
            state = TrackState.REOPENED
        elif sighting is not None:
            state = {1: TrackState.GROWN, -1: TrackState.SHRUNK, 0: TrackState.SEEN}[sighting.change]
        elif verdict is Verdict.SAME:
            state = TrackState.SEEN
        elif verdict is Verdict.GONE:
            state = TrackState.REPAIRED
        elif verdict is Verdict.UNDECIDED:
            state = TrackState.NOT_FOUND
        else:
            state = TrackState.NOT_IMAGED
        if there:
            repaired = False
        elif state is TrackState.REPAIRED:
            repaired = True
        states.append(StateInCampaign(campaign_id=campaign, state=state, by_comparison=sighting is None and there))
    return states
