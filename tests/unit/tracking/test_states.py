"""States of a track: each of the closed list from sightings and looks, and what a look tells about earlier campaigns."""

from __future__ import annotations

import pytest

from facadelake.tracking.states import Sighting, TrackState, Verdict, decide_states

CAMPAIGNS = ["a", "b", "c", "d"]


def states(sightings: dict[str, int], looks: dict[str, Verdict]) -> dict[str, TrackState]:
    found = {campaign: Sighting(defect_id=campaign, change=change) for campaign, change in sightings.items()}
    return {state.campaign_id: state.state for state in decide_states(CAMPAIGNS, found, looks)}


def test_seen_grown_shrunk_follow_the_change() -> None:
    assert states({"a": 0, "b": 1, "c": -1, "d": 0}, {}) == {
        "a": TrackState.FIRST_SEEN, "b": TrackState.GROWN, "c": TrackState.SHRUNK, "d": TrackState.SEEN,
    }  # fmt: skip


def test_a_defect_is_new_only_where_its_place_was_seen_without_it() -> None:
    assert states({"c": 0}, {"b": Verdict.GONE})["c"] is TrackState.NEW
    assert states({"c": 0}, {"b": Verdict.UNSEEN})["c"] is TrackState.FIRST_SEEN
    assert states({"c": 0}, {"b": Verdict.HIDDEN, "a": Verdict.GONE})["c"] is TrackState.NEW
    assert states({"c": 0}, {"b": Verdict.UNDECIDED})["c"] is TrackState.FIRST_SEEN


def test_a_defect_that_the_detector_missed_before_was_there_before() -> None:
    found = decide_states(CAMPAIGNS, {"c": Sighting(defect_id="c")}, {"b": Verdict.SAME, "a": Verdict.GONE})
    assert [(s.campaign_id, s.state, s.by_comparison) for s in found[:2]] == [
        ("b", TrackState.NEW, True), ("c", TrackState.SEEN, False),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("verdict", "state"),
    [
        (Verdict.SAME, TrackState.SEEN),
        (Verdict.GONE, TrackState.REPAIRED),
        (Verdict.UNDECIDED, TrackState.NOT_FOUND),
        (Verdict.HIDDEN, TrackState.NOT_IMAGED),
        (Verdict.UNSEEN, TrackState.NOT_IMAGED),
    ],
)
def test_absence_has_a_state_by_its_evidence(verdict: Verdict, state: TrackState) -> None:
    assert states({"a": 0}, {"b": verdict})["b"] is state


def test_a_repair_that_does_not_hold_is_reopened_once() -> None:
    found = states({"a": 0, "c": 0, "d": 0}, {"b": Verdict.GONE})
    assert (found["b"], found["c"], found["d"]) == (TrackState.REPAIRED, TrackState.REOPENED, TrackState.SEEN)
    hidden_between = states({"a": 0, "d": 0}, {"b": Verdict.GONE, "c": Verdict.HIDDEN})
    assert (hidden_between["c"], hidden_between["d"]) == (TrackState.NOT_IMAGED, TrackState.REOPENED)
