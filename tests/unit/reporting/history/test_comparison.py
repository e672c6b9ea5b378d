from __future__ import annotations

from typing import Any

import pyarrow as pa
import pytest

from facadelake.core.errors import InputDataError
from facadelake.reporting.history.comparison import BuildingComparison, compare_campaigns
from facadelake.reporting.history.findings import STYLES, Finding, TimelineState, combine_states
from facadelake.reporting.history.sentences import describe_evidence, describe_look, describe_offsets, describe_span
from facadelake.reporting.history.size_changes import format_changes, format_size
from schemas.vocabulary import StateEvidence, TrackState
from tests.unit.reporting.history.painted_history import History, make_table


def make_state(told: str | None) -> TimelineState | None:
    if told is None:
        return None
    state, evidence = told.split() if " " in told else (told, "detected")
    return TimelineState(state=TrackState(state), evidence=StateEvidence(evidence))


@pytest.mark.parametrize(
    ("before", "after", "finding"),
    [
        (None, ["new"], Finding.NEW),
        (None, ["first_seen"], Finding.FIRST_SEEN),
        (None, ["new", "grown"], Finding.NEW),  # since the first campaign of the span it is new, and no more
        (None, ["new", "repaired looks_repaired"], Finding.REPAIRED),
        ("first_seen", ["seen"], Finding.UNCHANGED),
        ("new", ["seen looks_the_same"], Finding.MISSED),
        ("seen", ["grown"], Finding.GROWN),
        ("seen", ["grown", "seen"], Finding.GROWN),  # the later campaign is still larger than the first one
        ("seen", ["grown", "shrunk"], Finding.UNCHANGED),
        ("seen", ["shrunk", "seen"], Finding.SHRUNK),
        ("seen", ["grown", "seen looks_the_same"], Finding.GROWN),
        ("seen", ["repaired looks_repaired"], Finding.REPAIRED),
        ("repaired looks_repaired", ["repaired looks_repaired"], Finding.STILL_REPAIRED),
        ("repaired looks_repaired", ["reopened", "repaired looks_repaired"], Finding.REPAIRED),
        ("repaired looks_repaired", ["reopened"], Finding.REOPENED),
        ("seen", ["repaired looks_repaired", "reopened", "seen"], Finding.REOPENED),
        ("seen", ["not_imaged hidden"], Finding.NOT_IMAGED),
        ("grown", ["not_found look_undecided"], Finding.NOT_FOUND),
        ("not_imaged not_in_view", ["seen"], Finding.UNCHANGED),
    ],
)
def test_states_of_several_campaigns_give_one_finding(before: str | None, after: list[str], finding: Finding) -> None:
    states = [make_state(told) for told in after]
    assert combine_states(make_state(before), [state for state in states if state is not None]) is finding


def test_findings_differ_in_shape_and_not_in_colour_alone() -> None:
    shapes = [style.shape for style in STYLES.values()]
    assert set(STYLES) == set(Finding)
    assert len(set(shapes)) == len(shapes)


def make_history() -> History:
    """Of each kind one; wall-2 is severe."""
    history = History()
    history.add("wall-0001", {"2024": "first_seen detected", "2025": "seen detected", "2026": "seen detected"})
    history.add("wall-0002", {"2025": "new detected", "2026": "grown detected"}, severity="severe",
                severity_rule="width_and_extent_v1")  # fmt: skip
    repaired = {"2024": "first_seen detected", "2025": "repaired looks_repaired"}
    history.add("wall-0003", repaired | {"2026": "reopened detected"}, severity="minor_or_worse",
                severity_rule="width_and_extent_v1")  # fmt: skip
    history.add("wall-0004", {"2024": "first_seen detected", "2025": "seen detected", "2026": "not_imaged hidden"})
    history.add("wall-0005", {"2026": "new detected"}, defect_class="moisture", storey=None)
    history.add("wall-0006", {"2025": "first_seen detected", "2026": "seen looks_the_same"})
    history.add("wall-0007", repaired | {"2026": "repaired looks_repaired"})
    history.add("wall-0008", {"2024": "first_seen detected"})  # the history of 2025 and 2026 does not know it
    history.change("wall-0002", "2026", previous_campaign="2025", years_since_previous=1.5, length_change_m=0.35,
                   length_change_sigma_m=0.08, area_change_m2=0.0004, area_change_sigma_m2=0.000002,
                   crack_width_change_mm=0.4, crack_width_change_sigma_mm=0.2, changed_quantity="length_m")  # fmt: skip
    history.look("wall-0006", "2026", "2025", "same", look_similarity=0.9)
    return history


def compare(history: History, earlier: str | None = None, later: str | None = None) -> BuildingComparison:
    return compare_campaigns(history.tables, earlier, later)


def test_the_two_latest_campaigns_by_capture_are_compared_and_what_is_urgent_comes_first() -> None:
    history = make_history()
    history.rows["campaigns"].reverse()  # the order of rows says nothing
    comparison = compare(history)
    assert (comparison.earlier, comparison.later) == ("2025", "2026")
    assert [track.track_id for track in comparison.listed] == [
        "wall-0002", "wall-0003", "wall-0005", "wall-0004", "wall-0006",
    ]  # fmt: skip
    assert comparison.count_findings() == {
        Finding.REOPENED: 1, Finding.GROWN: 1, Finding.NEW: 1, Finding.NOT_IMAGED: 1, Finding.MISSED: 1,
        Finding.UNCHANGED: 1, Finding.STILL_REPAIRED: 1,
    }  # fmt: skip
    assert comparison.count_by_place() == {
        ("S", "Ground <floor>"): {
            Finding.REOPENED: 1, Finding.GROWN: 1, Finding.NOT_IMAGED: 1, Finding.MISSED: 1, Finding.UNCHANGED: 1,
            Finding.STILL_REPAIRED: 1,
        },
        ("S", "no storey"): {Finding.NEW: 1},
    }  # fmt: skip
    assert describe_span(comparison).endswith("1.5 years between")


def test_a_campaign_without_capture_times_stands_at_the_date_of_its_id() -> None:
    history = make_history()
    history.rows["campaigns"][1]["captured_from"] = None  # 2025
    comparison = compare(history)
    assert comparison.campaigns == ("2024", "2025", "2026")
    assert "2025 photographed at an unknown date" in describe_span(comparison)


def test_a_span_of_several_campaigns_is_compared_as_a_whole() -> None:
    comparison = compare(make_history(), "2024", "2026")
    found = {track.track_id: track.finding for track in comparison.tracks}
    assert found["wall-0002"] is Finding.NEW  # it was not known in 2024
    assert found["wall-0003"] is Finding.REOPENED
    assert found["wall-0006"] is Finding.FIRST_SEEN
    assert found["wall-0007"] is Finding.REPAIRED  # no repair yet in 2024


def test_changes_over_several_campaigns_are_summed_with_their_variances() -> None:
    history = History()
    history.add("wall-0001", {"2024": "first_seen detected", "2025": "grown detected", "2026": "grown detected"})
    for campaign, previous, change in (("2025", "2024", 0.10), ("2026", "2025", 0.20)):
        history.change("wall-0001", campaign, previous_campaign=previous, length_change_m=change,
                       length_change_sigma_m=0.03, changed_quantity="length_m")  # fmt: skip
    one, both = compare(history).tracks[0], compare(history, "2024", "2026").tracks[0]
    assert format_changes(one.changes, "crack", "2025") == "length +20 ± 3 cm"
    assert format_changes(both.changes, "crack", "2024") == "length +30 ± 4 cm"  # sqrt(2) * 3 cm
    assert both.changes[0].since == "2024"
    assert both.finding is Finding.GROWN


def test_a_change_since_a_campaign_before_the_earlier_one_names_it() -> None:
    history = History()
    history.add(
        "wall-0001", {"2024": "first_seen detected", "2025": "not_found look_undecided", "2026": "grown detected"}
    )
    history.change("wall-0001", "2026", previous_campaign="2024", area_change_m2=0.01, area_change_sigma_m2=0.002,
                   changed_quantity="area_m2")  # fmt: skip
    track = compare(history).tracks[0]
    assert format_changes(track.changes, "crack", "2025") == "area +100 ± 20 cm² (since 2024)"
    assert "not found in 2025, detected last in 2024" in describe_evidence(track)
    assert track.before is None
    assert track.after is not None


def test_a_small_sigma_is_not_told_as_zero() -> None:
    grown = next(track for track in compare(make_history()).tracks if track.track_id == "wall-0002")
    assert format_changes(grown.changes, "crack", "2025") == "length +35 ± 8 cm, width +0.4 ± 0.2 mm"
    area = next(change for change in grown.changes if change.quantity == "area_m2")
    assert str(area) == "area +4.00 ± 0.02 cm²"


@pytest.mark.parametrize(
    ("defect", "text"),
    [
        ({"defect_class": "moisture"}, "40 × 20 cm"),
        ({"length_m": 1.2}, "120 cm"),
        ({"length_m": 1.2, "crack_width_mm": 0.84, "crack_width_outcome": "measured"}, "120 cm, 0.8 mm wide"),
        ({"length_m": 1.2, "crack_width_limit_mm": 0.5, "crack_width_outcome": "below_limit"}, "120 cm, < 0.5 mm wide"),
        ({"length_m": None}, "40 × 20 cm"),
    ],
)
def test_sizes_in_words(defect: dict[str, Any], text: str) -> None:
    history = History(("2024",))
    history.add("wall-0001", {"2024": "first_seen detected"}, **defect)
    assert format_size(make_table("defects", history.rows["defects"]).to_pylist()[0]) == text


def test_the_offset_between_two_campaigns_is_the_difference_of_both() -> None:
    history = make_history()
    latest = compare(history).offsets[0]
    assert latest.xyz_m == pytest.approx((0.01, 0.0, 0.0), abs=1e-12)  # m: 0.02 of 2026 less 0.01 of 2025
    assert latest.sigma_m == pytest.approx((0.002 * 2**0.5,) * 3, abs=1e-12)
    from_first = compare(history, "2024", "2026")
    assert from_first.offsets[0].xyz_m == pytest.approx((0.02, 0.0, 0.0), abs=1e-12)
    assert "+2.0 ± 0.2 cm east" in describe_offsets(from_first)


def test_an_offset_that_was_not_estimated_is_told_with_its_reason() -> None:
    history = make_history()
    for row in history.rows["frame_offsets"]:
        if row["campaign_id"] == "2026":
            row.update(dict.fromkeys(History.make_offset(0.0, 0.0)), offset_outcome="too_few", detail="2 defects agree")
    comparison = compare(history)
    assert comparison.offsets[0].xyz_m is None
    assert describe_offsets(comparison) == (
        "The offset between the frames of both campaigns is not known: nine defects agree; 2 defects agree."
    )


def empty(table: pa.Table) -> pa.Table:
    return table.slice(0, 0)


@pytest.mark.parametrize(
    ("earlier", "later", "message"),
    [
        (
            "2026", "2025",
            "campaign '2026' was not photographed before '2025'; name the earlier one first (in order: 2024, 2025, "
            "2026)",
        ),
        (
            "2025", "2025",
            "campaign '2025' was not photographed before '2025'; name the earlier one first (in order: 2024, 2025, "
            "2026)",
        ),
        ("2023", "2025", "the lake has no campaign '2023' of building 'wall'; it has 2024, 2025, 2026"),
        (None, "2024", "campaign '2024' is the first of 'wall'; there is none before it"),
    ],
)  # fmt: skip
def test_campaigns_that_cannot_be_compared_are_refused(earlier: str | None, later: str, message: str) -> None:
    with pytest.raises(InputDataError) as raised:
        compare(make_history(), earlier, later)
    assert str(raised.value) == message


def test_one_campaign_is_no_comparison() -> None:
    history = History(("2024",))
    with pytest.raises(InputDataError) as raised:
        compare(history)
    assert str(raised.value) == (
        "building 'wall' has one campaign in the lake (2024), and a comparison needs two; inspect the next one first"
    )


def test_campaigns_without_tracks_say_what_to_run() -> None:
    tables = make_history().tables
    tables |= {name: empty(tables[name]) for name in ("tracks", "track_states", "frame_offsets")}
    with pytest.raises(InputDataError) as raised:
        compare_campaigns(tables, None, None)
    assert str(raised.value) == (
        "campaign '2025' of building 'wall' is not tracked: the lake has no history of it; run 'facadelake track wall'"
    )


def test_a_campaign_whose_frame_was_refused_is_not_compared() -> None:
    history = make_history()
    history.rows["frame_offsets"][2] |= {"offset_outcome": "refused", "detail": "its frame lies 0.52 m beside"}
    with pytest.raises(InputDataError) as raised:
        compare(history)
    assert str(raised.value) == "campaign '2026' of building 'wall' is not tracked: its frame lies 0.52 m beside"


def test_relations_and_remarks_are_told() -> None:
    history = make_history()
    history.rows["track_relations"] = [
        {"building_id": "wall", "campaign_id": "2026", "run_id": "2026", "track_id": "wall-0005",
         "track_relation": "split_from", "other_track_id": "wall-0001", "detail": "two parts"}
    ]  # fmt: skip
    history.change("wall-0005", "2026", state_remark="beside a scaffold")
    history.change("wall-0004", "2026", state_evidence="review", reviewer="Ms Wall")
    comparison = compare(history)
    new = next(track for track in comparison.tracks if track.track_id == "wall-0005")
    assert describe_evidence(new) == "beside a scaffold; split from wall-0001: two parts"
    reviewed = next(track for track in comparison.tracks if track.track_id == "wall-0004")
    assert describe_evidence(reviewed) == "stated by a person; by Ms Wall"
    missed = next(track for track in comparison.tracks if track.track_id == "wall-0006")
    assert "similarity within the defect's extents 0.90, of the wall around it 0.83" in describe_look(
        missed, comparison
    )
