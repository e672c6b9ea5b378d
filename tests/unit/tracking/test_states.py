"""States of a track: each of the closed list from detections and looks, and what a look tells of earlier campaigns."""

from __future__ import annotations

import pytest

from facadelake.tracking.states import StateInCampaign, TrackEvidence, decide_states
from schemas.vocabulary import LookVerdict, StateEvidence, TrackState

CAMPAIGNS = ["a", "b", "c", "d"]


def decide(
    sightings: dict[str, int], looks: dict[str, LookVerdict] | None = None, **others: object
) -> dict[str, StateInCampaign]:
    known = TrackEvidence(sightings=sightings, looks=looks or {}, **others)  # type: ignore[arg-type]
    return {state.campaign_id: state for state in decide_states(CAMPAIGNS, known)}


def states(sightings: dict[str, int], looks: dict[str, LookVerdict] | None = None, **others: object) -> dict[str, str]:
    return {campaign: state.state for campaign, state in decide(sightings, looks, **others).items()}


def test_seen_grown_shrunk_follow_the_change() -> None:
    assert states({"a": 0, "b": 1, "c": -1, "d": 0}) == {"a": "first_seen", "b": "grown", "c": "shrunk", "d": "seen"}


def test_a_defect_is_new_only_where_its_place_was_seen_without_it() -> None:
    assert states({"c": 0}, {"b": LookVerdict.GONE})["c"] == "new"
    assert states({"c": 0}, {"b": LookVerdict.NOT_IN_VIEW})["c"] == "first_seen"
    assert states({"c": 0}, {"b": LookVerdict.HIDDEN, "a": LookVerdict.GONE})["c"] == "new"
    assert states({"c": 0}, {"b": LookVerdict.UNDECIDED})["c"] == "first_seen"


def test_a_defect_that_the_detector_missed_before_was_there_before() -> None:
    found = decide({"c": 0}, {"b": LookVerdict.SAME, "a": LookVerdict.GONE})
    assert list(found) == ["b", "c", "d"]
    assert (found["b"].state, found["b"].evidence) == (TrackState.NEW, StateEvidence.LOOKS_THE_SAME)
    assert (found["c"].state, found["c"].evidence) == (TrackState.SEEN, StateEvidence.DETECTED)


@pytest.mark.parametrize(
    ("verdict", "state", "evidence"),
    [
        (LookVerdict.SAME, "seen", "looks_the_same"),
        (LookVerdict.GONE, "repaired", "looks_repaired"),
        (LookVerdict.UNDECIDED, "not_found", "look_undecided"),
        (LookVerdict.NO_PHOTOGRAPH, "not_found", "no_photograph"),
        (LookVerdict.HIDDEN, "not_imaged", "hidden"),
        (LookVerdict.NOT_IN_VIEW, "not_imaged", "not_in_view"),
    ],
)
def test_absence_has_a_state_by_its_evidence(verdict: LookVerdict, state: str, evidence: str) -> None:
    found = decide({"a": 0}, {"b": verdict})["b"]
    assert (found.state, found.evidence) == (state, evidence)


def test_a_repair_that_does_not_hold_is_reopened_once() -> None:
    found = states({"a": 0, "c": 0, "d": 0}, {"b": LookVerdict.GONE})
    assert (found["b"], found["c"], found["d"]) == ("repaired", "reopened", "seen")
    hidden_between = states({"a": 0, "d": 0}, {"b": LookVerdict.GONE, "c": LookVerdict.HIDDEN})
    assert (hidden_between["c"], hidden_between["d"]) == ("not_imaged", "reopened")


def test_a_defect_that_another_one_covers_is_there() -> None:
    found = decide({"a": 0}, {"b": LookVerdict.GONE}, parts=frozenset({"b"}))["b"]
    assert (found.state, found.evidence, found.present) == ("seen", "part_of_other", True)


def test_the_word_of_a_person_overrides_and_later_states_follow_it() -> None:
    reviewed = {"b": TrackState.REPAIRED}
    found = decide({"a": 0, "c": 0}, {"b": LookVerdict.UNDECIDED, "d": LookVerdict.SAME}, reviews=reviewed)
    assert (found["b"].state, found["b"].evidence) == ("repaired", "review")
    assert (found["c"].state, found["d"].state) == ("reopened", "seen")
    denied = states({"a": 0, "c": 0}, {"b": LookVerdict.GONE}, reviews={"b": TrackState.NOT_FOUND})
    assert (denied["b"], denied["c"]) == ("not_found", "seen")


def test_a_repaired_defect_that_a_person_sees_is_reopened() -> None:
    looks = {"b": LookVerdict.GONE, "c": LookVerdict.GONE}
    assert states({"a": 0}, looks, reviews={"c": TrackState.SEEN})["c"] == "reopened"


def test_what_a_person_saw_before_the_first_detection_counts() -> None:
    looks = {"a": LookVerdict.NOT_IN_VIEW, "b": LookVerdict.GONE}
    found = states({"c": 0}, looks, reviews={"a": TrackState.SEEN})
    assert (found["a"], found["b"], found["c"]) == ("seen", "repaired", "reopened")
