"""Figures of hand-made histories: a perfect one has perfect figures, and each fault costs what it should."""

from __future__ import annotations

from dataclasses import replace

import pytest

from schemas.vocabulary import StateEvidence, TrackState, TrendQuantity
from tests.unit.evaluation.history.made_history import CAMPAIGNS, called, change, compare, detect, figures, measured


def test_a_perfect_history_has_perfect_figures() -> None:
    found = figures()
    # 9 detections of 4 defects: D1 3, D2 2, D3 2, D4 2.
    assert (found.identity.objects, found.identity.idf1, found.identity.switches) == (9, 1.0, 0)
    assert (found.identity_of_all.objects, found.identity_of_all.idf1) == (9, 1.0)
    assert (found.states.right, found.states.total, found.states.right_share) == (11, 11, 1.0)
    assert (found.states.repaired, found.states.false_repaired_share) == (1, 0.0)
    assert (found.states.missed, found.states.recovered_share) == (0, None)
    # D1 twice and D3 and D4 over the gap are unchanged; D2 grew.
    assert (found.changes.unchanged, found.changes.false_share) == (4, 0.0)
    assert (found.changes.changed, found.changes.found_share) == (1, 1.0)
    assert found.never_detected == ()
    assert all(true == state for true, state in found.states.confusion)


def test_a_swap_of_two_tracks_costs_identity_and_states() -> None:
    swapped = [
        replace(row, track_id={"T1": "T4", "T4": "T1"}.get(row.track_id, row.track_id))
        if row.campaign_id == "2026"
        else row
        for row in called()
    ]
    found = figures(swapped)
    # Of 9 detections D1 keeps two of three, D4 one of two: 7 are right. IDF1 = 2 * 7 / (9 + 9).
    assert found.identity.idf1 == pytest.approx(7 / 9)
    assert found.identity.switches == 2
    # Both are "seen" in 2026, so that their states remain right; changes to the size of another defect are not judged.
    assert found.states.right_share == 1.0
    assert found.changes.unchanged == 2


def test_a_second_track_of_a_defect_costs_its_detections() -> None:
    rows = change(called(), "T1", "2026", track_id="T9", state=TrackState.NEW, previous_campaign=None, changes={})
    found = figures(rows)
    assert found.identity.idf1 == pytest.approx(8 / 9)
    # T1 has no row in 2026: one of 11 states is missing; the row of T9 is a track of its own.
    assert (found.states.right, found.states.total) == (10, 11)
    assert found.states.confusion["seen", "no state"] == 1
    assert found.states.confusion["no defect", "new"] == 1


def test_a_false_detection_is_an_object_of_its_own() -> None:
    alone = [*called(), replace(called()[0], track_id="T9", campaign_id="2025", defect_id="F")]
    defects = measured() | {("2025", "F"): detect("2025", None)}
    found = figures(alone, defects)
    assert (found.identity.objects, found.identity.idf1) == (10, 1.0)
    assert found.identity_of_all.idf1 == pytest.approx(2 * 9 / (9 + 10))
    assert found.states.right_share == 1.0
    # Joined with D4's track, whose place was not imaged in 2025, it is a fault of identity.
    joined = change(called(), "T4", "2025", defect_id="F", state=TrackState.SEEN)
    assert figures(joined, defects).identity.idf1 == pytest.approx(9 / 10)


def test_a_false_repair_is_counted_of_those_called_so() -> None:
    rows = change(called(), "T1", "2025", state=TrackState.REPAIRED)
    found = figures(rows).states
    assert (found.repaired, found.false_repaired, found.false_repaired_share) == (2, 1, 0.5)
    assert found.confusion["seen", "repaired"] == 1
    # Of a track of a false detection, too.
    false = [*called(), replace(called()[0], track_id="T9", defect_id=None, state=TrackState.REPAIRED)]
    assert figures(false).states.false_repaired == 1


@pytest.mark.parametrize(
    ("state", "recovered"), [("seen", 1), ("grown", 1), ("not_found", 0), ("repaired", 0), ("not_imaged", 0)]
)
def test_what_the_look_recovers_of_the_detectors_misses(state: str, recovered: int) -> None:
    defects = {key: one for key, one in measured().items() if key != ("2025", "D1")}
    rows = change(
        called(), "T1", "2025", state=TrackState(state), defect_id=None, previous_campaign=None, changes={},
        evidence=StateEvidence.LOOKS_THE_SAME,
    )  # fmt: skip
    rows = change(rows, "T1", "2026", previous_campaign="2024")
    found = figures(rows, defects)
    assert (found.states.missed, found.states.recovered) == (1, recovered)
    assert found.identity.idf1 == 1.0  # of the detected
    assert (found.identity_of_all.idf1 == 1.0) == bool(recovered)
    assert found.states.total - found.states.right == (state != "seen")


def test_a_defect_that_no_campaign_detects_has_no_track() -> None:
    defects = {key: one for key, one in measured().items() if one.true_id != "D1"}
    found = figures([row for row in called() if row.track_id != "T1"], defects)
    assert found.never_detected == ("D1",)
    assert (found.states.right_share, found.identity.idf1) == (1.0, 1.0)
    assert found.identity_of_all.idf1 == pytest.approx(2 * 6 / (9 + 6))


def test_growth_that_is_none_and_growth_that_is_missed() -> None:
    rows = change(called(), "T1", "2025", state=TrackState.GROWN)
    rows = change(rows, "T2", "2026", state=TrackState.SHRUNK)
    found = figures(rows).changes
    assert (found.unchanged, found.false_changes, found.false_share) == (4, 1, 0.25)
    assert (found.changed, found.found_changes) == (1, 0)


def test_errors_of_changes_beside_their_sigmas() -> None:
    found = figures().changes.by_quantity[TrendQuantity.LENGTH]
    # 5.5 m became 7.7 m: the true factor of 1.4 is a change of 2.2 m; the others are called 0.1 m with sigma 0.2 m.
    assert (found.count, found.inside) == (5, 5)
    rows = change(called(), "T2", "2026", changes={TrendQuantity.LENGTH: (2.2 + 0.41, 0.2)})
    assert figures(rows).changes.by_quantity[TrendQuantity.LENGTH].inside == 4
    assert figures(rows).changes.inside_share == 0.8


def test_the_offset_is_of_unchanged_defects() -> None:
    by_pair = {(one.before, one.campaign_id): one for one in figures().changes.offsets}
    assert by_pair["2024", "2025"].count == 1  # D1 alone
    assert by_pair["2024", "2026"].count == 2  # D3 and D4, over the gap
    assert by_pair["2024", "2026"].offset_m == pytest.approx(0.02)
    assert by_pair["2025", "2026"].count == 1  # D1; D2 grew
    assert (by_pair["2025", "2026"].east_m, by_pair["2025", "2026"].distance_m) == pytest.approx((0.01, 0.01))


def test_every_row_is_judged_once() -> None:
    compared = compare()
    rows = [(one.true_id, one.campaign_id) for one in compared.judged]
    assert len(rows) == len(set(rows)) == len(called())
    assert set(compared.track_of.items()) == {(f"D{i}", f"T{i}") for i in range(1, 5)}
    assert compared.campaigns == CAMPAIGNS


def test_the_figures_are_json_and_rows() -> None:
    found = figures()
    document = found.convert_to_json()
    assert set(document) == {"campaigns", "identity", "identity_of_all", "states", "changes", "never_detected"}
    assert all(len(row) == len(found.COLUMNS) for row in found.format_rows())
