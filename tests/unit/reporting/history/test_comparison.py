from __future__ import annotations

import math
from typing import Any

import pyarrow as pa
import pytest

from facadelake.core.errors import InputDataError
from facadelake.reporting.history.comparison import BuildingComparison, compare_campaigns
from facadelake.reporting.history.findings import STYLES, Finding, SpanChange, TimelineState, combine_states
from facadelake.reporting.history.sentences import (
    describe_class,
    describe_count,
    describe_evidence,
    describe_grade,
    describe_look,
    describe_offsets,
    describe_sizes,
    describe_span,
)
from facadelake.reporting.history.size_changes import TrackSizeChange, format_changes, format_size
from schemas.vocabulary import StateEvidence, TrackState, TrendQuantity
from tests.unit.reporting.history.painted_history import History, make_table


def make_state(told: str | None) -> TimelineState | None:
    if told is None:
        return None
    state, evidence = told.split() if " " in told else (told, "detected")
    return TimelineState(state=TrackState(state), evidence=StateEvidence(evidence))


REPAIRED = "repaired looks_repaired"


@pytest.mark.parametrize(
    ("before", "after", "growth", "finding"),
    [
        ([], ["new"], 0, Finding.NEW),
        ([None], ["first_seen"], 0, Finding.FIRST_SEEN),
        ([None], ["new", "grown"], 1, Finding.NEW),  # since the first campaign of the span it is new, and no more
        ([None], ["new", REPAIRED], 0, Finding.REPAIRED),
        ([None], ["new", REPAIRED, "reopened"], 0, Finding.NEW),  # it was not there in the earlier campaign
        (["first_seen"], ["seen"], 0, Finding.UNCHANGED),
        (["new"], ["seen looks_the_same"], 0, Finding.MISSED),
        (["seen"], ["grown"], 1, Finding.GROWN),
        (["seen"], ["grown", "seen"], 1, Finding.GROWN),  # the later campaign is still larger than the first one
        (["seen"], ["grown", "seen"], 0, Finding.UNCHANGED),  # and here it is not
        (["seen"], ["grown", "shrunk"], 0, Finding.UNCHANGED),
        (["seen"], ["seen", "seen"], 1, Finding.GROWN),  # in steps of which none is significant
        (["seen"], ["grown", "shrunk"], -1, Finding.SHRUNK),
        (["seen"], ["grown", "seen looks_the_same"], 1, Finding.GROWN),
        (["seen"], [REPAIRED], 0, Finding.REPAIRED),
        ([REPAIRED], [REPAIRED], 0, Finding.STILL_REPAIRED),
        ([REPAIRED], ["not_imaged hidden", REPAIRED], 0, Finding.STILL_REPAIRED),
        ([REPAIRED], ["reopened", REPAIRED], 0, Finding.REPAIRED),
        ([REPAIRED], ["reopened"], 0, Finding.REOPENED),
        ([REPAIRED], ["reopened", "seen"], 0, Finding.REOPENED),
        ([REPAIRED, "not_imaged hidden"], ["reopened"], 0, Finding.REOPENED),
        (["seen"], [REPAIRED, "reopened", "seen"], 0, Finding.REPAIRED_BETWEEN),  # there in both campaigns
        (["seen"], [REPAIRED, "reopened"], 1, Finding.REPAIRED_BETWEEN),
        (["seen"], ["not_imaged hidden"], 0, Finding.NOT_IMAGED),
        (["grown"], ["not_found look_undecided"], 0, Finding.NOT_FOUND),
        (["not_imaged not_in_view"], ["seen"], 0, Finding.UNCHANGED),
    ],
)
def test_the_later_campaign_counts_against_the_earlier_one(
    before: list[str | None], after: list[str], growth: int, finding: Finding
) -> None:
    states = [make_state(told) for told in after]
    told = [make_state(one) for one in before]
    assert combine_states(told, [one for one in states if one is not None], SpanChange(growth=growth)) is finding


def test_a_change_of_class_counts_before_one_of_severity_and_after_growth() -> None:
    seen, both = make_state("seen"), SpanChange(other_class=True, other_severity=True)
    assert seen is not None
    assert combine_states([seen], [seen], both) is Finding.CLASS_CHANGED
    assert combine_states([seen], [seen], SpanChange(other_severity=True)) is Finding.REGRADED
    assert combine_states([seen], [seen], SpanChange(growth=1, other_severity=True)) is Finding.GROWN
    assert combine_states([None], [seen], both) is Finding.FIRST_SEEN


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
    history.resize("wall-0002", "2026", length_m=0.75)
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
    assert found["wall-0003"] is Finding.REPAIRED_BETWEEN
    assert found["wall-0006"] is Finding.FIRST_SEEN
    assert found["wall-0007"] is Finding.REPAIRED  # no repair yet in 2024


def make_sized(*lengths_m: float) -> History:
    """A crack of a length in each of three campaigns."""
    history = History()
    history.add("wall-0001", {"2024": "first_seen detected", "2025": "seen detected", "2026": "seen detected"})
    for campaign, length_m in zip(history.campaigns, lengths_m, strict=True):
        history.resize("wall-0001", campaign, length_m=length_m)
    return history


def test_a_change_over_several_campaigns_is_that_between_both_with_their_errors_alone() -> None:
    history = make_sized(0.4, 0.5, 0.7)
    one, both = compare(history).tracks[0], compare(history, "2024", "2026").tracks[0]
    # One standard error is that of both detections: 1 deg of the wall's slope, seen at 45 deg, is 1.7 % of a length.
    assert both.changes[0].sigma == pytest.approx(math.radians(1) * math.hypot(0.4, 0.7), rel=0.02)  # m
    assert format_changes(one.changes, "crack", one.pair) == "length +20 ± 2 cm"
    assert format_changes(both.changes, "crack", both.pair) == "length +30 ± 1 cm"
    assert both.finding is Finding.GROWN


def test_growth_that_was_taken_back_is_none_and_growth_in_small_steps_is_one() -> None:
    """demo-0015: grown in 2025-10, and as it was before in 2026-04."""
    back = make_sized(0.4, 0.6, 0.41)
    assert compare(back, "2024", "2025").tracks[0].finding is Finding.GROWN
    assert compare(back, "2024", "2026").tracks[0].finding is Finding.UNCHANGED
    steps = make_sized(0.4, 0.425, 0.451)  # steps of 2.1 standard errors, 4.2 in all
    found = [compare(steps, *pair).tracks[0].finding for pair in (("2024", "2025"), ("2025", "2026"), ("2024", "2026"))]
    assert found == [Finding.UNCHANGED, Finding.UNCHANGED, Finding.GROWN]


def test_a_finding_tells_what_happened_between() -> None:
    history = History()
    history.add("wall-0001", {"2024": "first_seen detected", "2025": "repaired looks_repaired",
                              "2026": "reopened detected"})  # fmt: skip
    history.add("wall-0002", {"2025": "new detected", "2026": "seen detected"})
    found = {track.track_id: track for track in compare(history, "2024", "2026").listed}
    assert found["wall-0001"].finding is Finding.REPAIRED_BETWEEN
    assert describe_evidence(found["wall-0001"]) == "between: repaired in 2025"
    assert describe_evidence(found["wall-0002"]) == "between: new in 2025"


def test_sizes_beside_a_change_are_those_whose_difference_it_is() -> None:
    """demo-0019: merged defects of 83 and 118 cm stood beside a change of +38 cm."""
    history = make_sized(0.4, 0.83, 1.18)
    history.resize("wall-0001", "2025", merged=False, length_m=0.91)
    history.resize("wall-0001", "2026", merged=False, length_m=1.29)
    history.add("wall-0002", {"2025": "first_seen detected", "2026": "grown detected"}, defect_class="moisture")
    history.resize("wall-0002", "2026", merged=False, area_m2=0.12)
    found = {track.track_id: track for track in compare(history).tracks}
    assert describe_sizes(found["wall-0001"]) == ("91 cm", "129 cm")
    assert format_changes(found["wall-0001"].changes, "crack", ("2025", "2026")) == "length +38 ± 3 cm"
    assert describe_sizes(found["wall-0002"]) == ("800 cm²", "1200 cm²")  # not the extents of the box
    assert format_changes(found["wall-0002"].changes, "moisture", ("2025", "2026")) == "area +400 ± 27 cm²"
    assert [format_size(entry.defect) for entry in found["wall-0001"].timeline] == ["40 cm", "91 cm", "129 cm"]


def test_a_person_who_saw_no_growth_is_believed_of_the_step_and_not_of_the_span() -> None:
    history = make_sized(0.4, 0.5, 0.7)
    history.change("wall-0001", "2026", state_evidence="review", reviewer="Ms Wall", previous_campaign="2025")
    assert compare(history, "2025", "2026").tracks[0].finding is Finding.UNCHANGED
    assert compare(history, "2024", "2026").tracks[0].finding is Finding.GROWN
    history.change("wall-0001", "2026", track_state="shrunk")
    assert compare(history, "2024", "2026").tracks[0].finding is Finding.SHRUNK


def test_a_crack_that_spalled_and_a_new_severity_are_listed() -> None:
    """demo-0006 and demo-0008: a change of class stood among the unchanged."""
    history = History()
    seen = {"2025": "first_seen detected", "2026": "seen detected"}
    graded = {"severity_rule": "width_and_extent_v1", "severity_low": "minor", "severity_high": "severe"}
    for number, (before, after) in enumerate(
        [("severe", "severe"), ("severe", "minor"), ("minor", "severe"), ("moderate", "moderate")]
    ):
        name = f"wall-000{number}"
        history.add(name, seen, **graded)
        history.resize(name, "2025", severity=before)
        history.resize(name, "2026", severity=after)
    history.resize("wall-0000", "2026", defect_class="spalling", area_m2=0.2)
    found = compare(history).listed
    # A grade that became worse stands before one that became better.
    assert [(track.track_id, str(track.finding)) for track in found] == [
        ("wall-0000", "class changed"), ("wall-0002", "regraded"), ("wall-0001", "regraded"),
    ]  # fmt: skip
    assert describe_class(found[0]) == "crack → spalling"
    assert describe_sizes(found[0]) == ("40 cm", "2000 cm²")
    assert found[0].changes == ()  # a crack has no area to compare with a spall's
    assert describe_grade(found[1]) == "minor (minor to severe) → severe (minor to severe)"
    assert describe_class(found[1]) == "crack"


def test_grades_of_two_rule_packs_are_told_as_such() -> None:
    history = History()
    history.add("wall-0001", {"2025": "first_seen detected", "2026": "seen detected"}, severity_rule="extent_v1")
    history.resize("wall-0001", "2026", severity="slight", severity_rule="bre251_v1")
    track = compare(history).listed[0]
    assert track.finding is Finding.REGRADED
    assert "graded by extent_v1 in 2025, by bre251_v1 in 2026: the words do not compare" in describe_evidence(track)


def test_defects_repaired_before_are_not_counted_as_there() -> None:
    history = History()
    seen = {"2024": "first_seen detected"}
    history.add("wall-0001", seen | {"2025": "seen detected", "2026": "seen detected"})
    history.add("wall-0002", seen | {"2025": "repaired looks_repaired", "2026": "repaired looks_repaired"})
    history.add("wall-0003", seen | {"2025": "seen detected", "2026": "repaired looks_repaired"})
    history.add("wall-0004", seen | {"2025": "not_imaged hidden", "2026": "not_imaged hidden"})
    assert describe_count(compare(history)) == "2 defects in 2025 or 2026, 2 more known from other campaigns"
    assert describe_count(compare(history, "2024", "2025")) == "4 defects in 2024 or 2025"


def test_a_change_since_a_campaign_before_the_earlier_one_names_it() -> None:
    history = History()
    history.add(
        "wall-0001",
        {"2024": "first_seen detected", "2025": "not_found look_undecided", "2026": "grown detected"},
        defect_class="spalling",
    )
    history.resize("wall-0001", "2026", area_m2=0.10)
    track = compare(history).tracks[0]
    assert format_changes(track.changes, "spalling", track.pair) == "area +200 ± 24 cm² (since 2024)"
    assert describe_sizes(track) == ("800 cm² in 2024", "1000 cm²")
    assert "not found in 2025, detected last in 2024" in describe_evidence(track)
    assert track.find_detection("2025") is None
    assert track.find_detection("2026") is not None


def test_a_change_up_to_a_campaign_before_the_later_one_names_it() -> None:
    """The detector missed it in the later campaign, where it looks as it did between."""
    history = make_sized(0.4, 0.6, 0.6)
    history.rows["defects"] = [row for row in history.rows["defects"] if row["campaign_id"] != "2026"]
    history.change("wall-0001", "2026", state_evidence="looks_the_same", defect_id=None)
    track = compare(history, "2024", "2026").tracks[0]
    assert track.finding is Finding.GROWN
    assert format_changes(track.changes, "crack", track.pair) == "length +20 ± 1 cm (until 2025)"
    assert describe_sizes(track) == ("40 cm", "60 cm in 2025")


def test_a_small_sigma_is_not_told_as_zero() -> None:
    grown = next(track for track in compare(make_history()).tracks if track.track_id == "wall-0002")
    assert format_changes(grown.changes, "crack", grown.pair) == "length +35 ± 1 cm"
    area = TrackSizeChange(
        quantity=TrendQuantity.AREA, value=0.0004, sigma=0.000002, since="2025", until="2026", decisive=False
    )
    assert str(area) == "area +4.00 ± 0.02 cm²"


@pytest.mark.parametrize(
    ("defect", "text"),
    [
        ({"defect_class": "moisture"}, "800 cm²"),
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
        "The offset between the frames of both campaigns is not known: 2 defects agree."
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
