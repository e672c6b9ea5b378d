"""What became of a defect in each campaign, from its sightings, the looks at its place, and its change of size.

The closed list of states is ``schemas.vocabulary.TrackState``; this module is their definition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from schemas.vocabulary import LookVerdict, StateEvidence, TrackState

# What a state given by a person says of the defect's presence; the others say nothing of it.
_ABSENT = frozenset({TrackState.REPAIRED})
_UNKNOWN = frozenset({TrackState.NOT_FOUND, TrackState.NOT_IMAGED})
_EVIDENCE = {
    LookVerdict.SAME: StateEvidence.LOOKS_THE_SAME,
    LookVerdict.GONE: StateEvidence.LOOKS_REPAIRED,
    LookVerdict.UNDECIDED: StateEvidence.LOOK_UNDECIDED,
    LookVerdict.HIDDEN: StateEvidence.HIDDEN,
    LookVerdict.NOT_IN_VIEW: StateEvidence.NOT_IN_VIEW,
    LookVerdict.NO_PHOTOGRAPH: StateEvidence.NO_PHOTOGRAPH,
}
_NOT_SEEN = {
    LookVerdict.GONE: TrackState.REPAIRED,
    LookVerdict.UNDECIDED: TrackState.NOT_FOUND,
    LookVerdict.NO_PHOTOGRAPH: TrackState.NOT_FOUND,
    LookVerdict.HIDDEN: TrackState.NOT_IMAGED,
    LookVerdict.NOT_IN_VIEW: TrackState.NOT_IMAGED,
}


@dataclass(frozen=True, kw_only=True)
class TrackEvidence:
    """What is known of one track, by campaign.

    ``sightings``: campaigns that detected it, with its change against the detection before: 1 grown, -1 shrunk, 0
    neither. ``parts``: campaigns in which a defect of another track covers its place. ``looks``: verdicts in the other
    campaigns. ``reviews``: states given by persons.
    """

    sightings: Mapping[str, int]
    looks: Mapping[str, LookVerdict]
    parts: frozenset[str] = frozenset()
    reviews: Mapping[str, TrackState] | None = None


@dataclass(frozen=True, kw_only=True)
class StateInCampaign:
    """State of a track in a campaign; ``present``: whether it was there, None where that is not known."""

    campaign_id: str
    state: TrackState
    evidence: StateEvidence
    present: bool | None


def decide_states(campaigns: Sequence[str], known: TrackEvidence) -> list[StateInCampaign]:
    """States of one track in every campaign from the first in which it was there.

    A place that looked the same before its first detection bore the defect already: the track begins there. It is
    ``new`` where a campaign before that imaged the place well and did not show it.

    Args:
        campaigns: the building's campaigns in order of capture.
        known: what is known of the track; it has one detection at least.

    Returns:
        One state a campaign.
    """
    presence = [_judge_presence(campaign, known) for campaign in campaigns]
    first = next(k for k, campaign in enumerate(campaigns) if campaign in known.sightings)
    begin = first
    for k in range(first - 1, -1, -1):
        if presence[k] is True:
            begin = k
        elif presence[k] is False:
            break
    reviews = known.reviews or {}
    # What a person has seen before that counts, too: the place was then repaired in between.
    begin = min([begin, *(k for k in range(first) if campaigns[k] in reviews and presence[k])])
    states: list[StateInCampaign] = []
    repaired = False
    for k in range(begin, len(campaigns)):
        campaign = campaigns[k]
        if k == begin:
            state = TrackState.NEW if False in presence[:begin] else TrackState.FIRST_SEEN
        elif presence[k] and repaired:
            state = TrackState.REOPENED
        elif presence[k]:
            state = {1: TrackState.GROWN, -1: TrackState.SHRUNK}.get(known.sightings.get(campaign, 0), TrackState.SEEN)
        else:
            state = _NOT_SEEN.get(_get_verdict(campaign, known), TrackState.NOT_FOUND)
        repaired = presence[k] is False or (repaired and presence[k] is None)
        states.append(
            StateInCampaign(
                campaign_id=campaign,
                # Who calls a defect seen, that was repaired before, says that the repair did not hold.
                state=state if state is TrackState.REOPENED and presence[k] else reviews.get(campaign, state),
                evidence=_name_evidence(campaign, known),
                present=presence[k],
            )
        )
    return states


def _get_verdict(campaign: str, known: TrackEvidence) -> LookVerdict:
    return known.looks.get(campaign, LookVerdict.NOT_IN_VIEW)


def _judge_presence(campaign: str, known: TrackEvidence) -> bool | None:
    """Whether the defect was there: a person's word counts, then a detection, then the look."""
    review = (known.reviews or {}).get(campaign)
    if review is not None:
        return None if review in _UNKNOWN else review not in _ABSENT
    if campaign in known.sightings or campaign in known.parts:
        return True
    return {LookVerdict.SAME: True, LookVerdict.GONE: False}.get(_get_verdict(campaign, known))


def _name_evidence(campaign: str, known: TrackEvidence) -> StateEvidence:
    if campaign in (known.reviews or {}):
        return StateEvidence.REVIEW
    if campaign in known.sightings:
        return StateEvidence.DETECTED
    if campaign in known.parts:
        return StateEvidence.PART_OF_OTHER
    return _EVIDENCE[_get_verdict(campaign, known)]
