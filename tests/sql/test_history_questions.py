"""The questions about the history have right answers, by the campaigns' times and not by the text of their ids."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from facadelake.core.errors import InputDataError
from facadelake.core.tables import table_from_rows
from facadelake.lake.migrate import open_to_write
from facadelake.lake.questions import answer_question, list_questions
from facadelake.lake.transaction import insert
from facadelake.reporting.history import compare_committed
from schemas.tables import LAKE_TABLES
from tests.sql.small_history import ELEMENT, FIRST, SECOND, THIRD, commit_history
from tests.unit.lake.small_campaign import BUILDING, commit


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, int]]:
    folder = tmp_path_factory.mktemp("lake")
    return folder, commit_history(folder)


def ask(built: tuple[Path, dict[str, int]], question: str, as_of: int | None = None, **given: Any) -> list[dict]:
    rows = answer_question(built[0], question, given, as_of=as_of).to_pylist()
    return [{**row, "track": int(row["track_id"][-4:])} if row.get("track_id") else row for row in rows]


@pytest.mark.parametrize("question", list_questions(), ids=lambda question: question.name)
def test_every_question_has_an_answer(built, question) -> None:
    given = {"building_id": BUILDING}
    if "campaign_id" in question.parameters:
        given["campaign_id"] = THIRD
    answer = ask(built, question.name, **given)
    assert question.grain
    assert {row["building_id"] for row in answer} <= {BUILDING}
    if "campaign_id" in question.parameters:
        assert {row["campaign_id"] for row in answer} <= {THIRD}
    assert (len(answer) == 0) == (question.name == "failed_checks")


def test_new_since_a_campaign_or_a_date(built) -> None:
    def tracks(**given: Any) -> list[tuple]:
        return [(row["track"], row["campaign_id"], row["track_state"]) for row in ask(built, "new_since", **given)]

    in_third = [(5, THIRD, "new"), (6, THIRD, "first_seen")]
    assert tracks() == tracks(since_campaign=SECOND) == in_third  # the latest is that of 2026, not z-2025
    after_first = [(5, THIRD, "new"), (4, SECOND, "new"), (6, THIRD, "first_seen")]
    assert tracks(since_campaign=FIRST) == after_first  # the severe one first
    assert tracks(since_date="2025-04-01") == after_first  # flown on that day: known at its end
    assert len(tracks(since_date="2025-03-31")) == 7
    assert tracks(since_date="2025-10-01") == in_third
    assert tracks(since_date="2026-04-01") == tracks(since_campaign=THIRD) == []
    (row,) = [row for row in ask(built, "new_since", since_campaign=FIRST) if row["track"] == 4]
    assert (row["current_state"], row["crack_width_mm"], row["defect_id"]) == ("grown", 0.5, "defect-0001")


def test_grown_defects_are_ranked_by_their_rate_with_its_sigma(built) -> None:
    width, length = ask(built, "grown_defects")
    # 0.1 mm of 0.4 mm in 182 days, 0.06 m of 0.3 m in 183 days
    assert (width["track"], width["changed_quantity"], width["size_before"], width["size"]) == (
        4, "crack_width_mm", 0.4, 0.5,
    )  # fmt: skip
    assert width["per_year"] == pytest.approx(0.1 * 365.25 / 182, rel=0, abs=1e-4)  # mm
    assert width["per_year_sigma"] == pytest.approx(0.02 * 365.25 / 182, rel=0, abs=1e-4)  # mm
    assert (width["percent_per_year"], width["percent_per_year_sigma"]) == (50.2, 10.0)
    assert (length["track"], length["campaign_id"], length["current_state"]) == (1, SECOND, "seen")
    assert (length["size_before"], length["change"], length["change_sigma"]) == (0.3, 0.06, 0.01)
    assert (length["percent_per_year"], length["percent_per_year_sigma"]) == (39.9, 6.7)
    assert [row["track"] for row in ask(built, "grown_defects", campaign_id=THIRD)] == [4]
    assert [row["track"] for row in ask(built, "grown_defects", quantity="length_m")] == [1]
    assert len(ask(built, "grown_defects", limit=1)) == 1


def test_two_campaigns_of_one_moment_have_no_rate(tmp_path: Path) -> None:
    commit_history(tmp_path)
    with open_to_write(tmp_path, 10.0) as connection:
        connection.execute("UPDATE track_states SET years_since_previous = 0")
    rows = answer_question(tmp_path, "grown_defects", {"building_id": BUILDING}).to_pylist()
    assert [row["change"] for row in rows] == [0.06, 0.1]
    rates = ("per_year", "per_year_sigma", "percent_per_year", "percent_per_year_sigma")
    assert {row[name] for row in rows for name in rates} == {None}


def test_repairs_and_whether_they_held(built) -> None:
    found = {row["track"]: row for row in ask(built, "repaired_defects")}
    assert {track: (row["campaign_id"], row["repair_outcome"]) for track, row in found.items()} == {
        2: (SECOND, "reopened"), 7: (THIRD, "not_checked"), 3: (SECOND, "holds"),
    }  # fmt: skip
    assert list(found) == [2, 7, 3]
    assert (found[7]["there_before"], found[7]["reviewer"], found[3]["confirmed_count"]) == (FIRST, "A. Mason", 1)
    (failed,) = ask(built, "repairs_that_did_not_hold")
    assert (failed["track"], failed["there_before"], failed["repaired_campaign"], failed["reopened_campaign"]) == (
        2, FIRST, SECOND, THIRD,
    )  # fmt: skip
    assert (failed["years_until_reopened"], failed["area_before_m2"], failed["area_reopened_m2"]) == (0.5, 0.08, 0.1)


def test_two_campaigns_side_by_side(built) -> None:
    rows = ask(built, "campaigns_compared")
    assert {(row["from_campaign"], row["to_campaign"]) for row in rows} == {(SECOND, THIRD)}
    assert [(row["track"], row["finding"], row["state_from"], row["state_to"]) for row in rows] == [
        (2, "reopened", "repaired", "reopened"), (4, "grown", "new", "grown"), (5, "new", None, "new"),
        (6, "first seen", None, "first_seen"), (7, "repaired", "not_imaged", "repaired"),
        (1, "unchanged", "grown", "seen"), (3, "still repaired", "repaired", "repaired"),
    ]  # fmt: skip
    again, crack = rows[0], rows[1]
    assert (crack["crack_width_from_mm"], crack["crack_width_to_mm"], crack["crack_width_to_sigma_mm"]) == (
        0.4, 0.5, 0.014,
    )  # fmt: skip
    assert (crack["crack_width_change_mm"], crack["crack_width_change_sigma_mm"]) == (0.1, 0.02)
    # It was not detected in the second campaign: its change is that since the first, and so it is told.
    assert (again["detected_from"], again["area_from_m2"], again["area_to_m2"]) == (FIRST, 0.08, 0.1)
    assert (again["area_change_m2"], again["area_change_sigma_m2"]) == (0.02, 0.015)
    one = ask(built, "campaigns_compared", to_campaign=SECOND)
    assert {row["from_campaign"] for row in one} == {FIRST}


def test_over_several_campaigns_the_later_one_counts_against_the_earlier_one(built) -> None:
    whole = {row["track"]: row for row in ask(built, "campaigns_compared", from_campaign=FIRST, to_campaign=THIRD)}
    assert (whole[2]["finding"], whole[2]["happened_between"]) == ("repaired between", f"repaired in {SECOND}")
    assert (whole[2]["area_change_m2"], whole[2]["area_change_sigma_m2"], whole[2]["area_from_m2"]) == (
        0.02, 0.015, 0.08,
    )  # fmt: skip
    # Of two steps tables do not tell whether the whole of them is significant, so that nothing is claimed.
    assert (whole[1]["finding"], whole[1]["happened_between"]) == ("there in both", f"grown in {SECOND}")
    assert (whole[1]["length_from_m"], whole[1]["length_to_m"], whole[1]["length_change_m"]) == (0.3, 0.36, None)
    assert (whole[4]["finding"], whole[4]["detected_from"], whole[4]["crack_width_change_mm"]) == ("new", None, None)


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three campaigns with what tracking says of their frames, which 'facadelake compare' asks for."""
    folder = tmp_path_factory.mktemp("tracked")
    commit_history(folder)
    rows = [
        {"building_id": BUILDING, "campaign_id": name, "run_id": f"run-{name}", "facade": "", "detail": "by hand",
         "offset_outcome": "first" if name == FIRST else "too_few", "offset_count": 0}
        for name in (FIRST, SECOND, THIRD)
    ]  # fmt: skip
    with open_to_write(folder, 10.0) as connection:
        insert(connection, LAKE_TABLES["frame_offsets"], table_from_rows("frame_offsets", rows))
    return folder


@pytest.mark.parametrize(("earlier", "later"), [(THIRD, FIRST), (THIRD, THIRD), (THIRD, None), (None, FIRST)])
def test_a_pair_that_cannot_be_compared_is_refused_by_question_and_by_command(tracked, earlier, later) -> None:
    with pytest.raises(InputDataError) as by_command:
        compare_committed(tracked, BUILDING, earlier, later, as_of=None)
    given = {"building_id": BUILDING, "from_campaign": earlier, "to_campaign": later}
    with pytest.raises(InputDataError) as by_question:
        answer_question(tracked, "campaigns_compared", given)
    assert str(by_question.value) == f"the question cannot be answered: {by_command.value}"


def test_a_comparison_that_cannot_be_is_an_error_and_not_an_empty_answer(tmp_path: Path) -> None:
    commit(tmp_path, defects=1)
    with pytest.raises(
        InputDataError, match=r"building 'tower' has one campaign in the lake \(2026-04\), and a comparison"
    ):
        answer_question(tmp_path, "campaigns_compared")
    commit(tmp_path, campaign_id="2026-10", defects=1)
    untracked = (
        "campaign '2026-04' of building 'tower' is not tracked: the lake has no history of it; run 'facadelake track"
    )
    with pytest.raises(InputDataError, match=untracked):
        answer_question(tmp_path, "campaigns_compared")


def test_a_campaign_and_a_date_are_not_both_taken(built) -> None:
    with pytest.raises(InputDataError, match="since_campaign and since_date are both given; give one of them"):
        ask(built, "new_since", since_campaign=FIRST, since_date="2025-04-01")


def test_everything_on_an_element_and_on_a_track(built) -> None:
    rows = ask(built, "element_history", element_guid=ELEMENT)
    assert len(rows) == 16  # 11 detected, 5 looks
    assert [(row["campaign_id"], row["track_state"]) for row in rows if row["track"] == 2] == [
        (FIRST, "first_seen"), (SECOND, "repaired"), (THIRD, "reopened"),
    ]  # fmt: skip
    first, gone, again = ask(built, "track_history", track_id="tower-0002")
    assert (first["campaign_id"], first["photo_id"]) == (FIRST, "closerange/p0.jpg")
    assert (gone["look_verdict"], gone["look_similarity"], gone["photo_id"]) == ("gone", 0.12, "closerange/p1.jpg")
    assert (again["area_m2"], again["area_change_m2"], again["area_change_sigma_m2"]) == (0.1, 0.02, 0.015)
    assert ask(built, "track_history", track_id="2") == [first, gone, again]
    assert ask(built, "track_history", track_id="4")[0]["relations"] == "split_from tower-0001"


def test_the_portfolio_is_ranked_by_growth(built) -> None:
    (row,) = ask(built, "growth_by_building")
    assert (row["tracks"], row["compared"], row["grown"], row["grown_share"]) == (7, 3, 2, 0.667)
    assert row["grown_share_sigma"] == pytest.approx(0.272, rel=0, abs=0.001)
    watched = (183 + 182 + 365 + 182) / 365.25  # years: track 1 twice, 2, 4
    assert row["growths_per_defect_year"] == pytest.approx(2 / watched, rel=0, abs=1e-4)
    assert row["growths_per_defect_year_sigma"] == pytest.approx(2**0.5 / watched, rel=0, abs=1e-4)
    assert (row["new"], row["new_per_year"], row["reopened"], row["reopened_per_year"]) == (2, 2.0, 1, 1.0)


def test_what_was_known_when_and_by_which_model_and_code(built) -> None:
    first, second, third = ask(built, "provenance")
    assert [row["campaign_id"] for row in (first, second, third)] == [FIRST, SECOND, THIRD]
    assert (third["code_sha256"], third["detector_sha256"], third["detectors"]) == (
        "c" * 64, "d" * 64, "coco:boxes.json",
    )  # fmt: skip
    assert (third["tracks"], third["appeared"], third["grown"], third["repaired"]) == (7, 2, 1, 2)
    assert third["history_version"] == first["history_version"] == built[1]["history"]
    assert second["version"] == built[1][SECOND]
    (then,) = ask(built, "provenance", as_of=built[1][FIRST])
    assert (then["campaign_id"], then["defects_total"], then["history_version"]) == (FIRST, 4, None)


def test_states_by_campaign_in_order_of_time(built) -> None:
    rows = ask(built, "states_by_campaign")
    assert [(row["campaign_id"], row["tracks"], row["repaired"], row["reviewed"]) for row in rows] == [
        (FIRST, 4, 0, 0), (SECOND, 5, 2, 0), (THIRD, 7, 2, 1),
    ]  # fmt: skip
    assert [row["campaign_id"] for row in ask(built, "campaigns")] == [FIRST, SECOND, THIRD]


def test_lists_of_defects_name_the_track(built) -> None:
    rows = ask(built, "worst_defects", campaign_id=THIRD)
    assert {row["defect_id"]: (row["track"], row["track_state"]) for row in rows} == {
        "defect-0000": (1, "seen"), "defect-0001": (2, "reopened"), "defect-0002": (4, "grown"),
        "defect-0003": (5, "new"), "defect-0004": (6, "first_seen"),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("question", "given", "told"),
    [
        (
            "new_since",
            {"since_campaign": "2025-11"},
            "the lake {lake} has no campaign '2025-11' (did you mean '2025-10'?); it has 2025-10, 2026-04, z-2025",
        ),
        (
            "tracks",
            {"building_id": "towr"},
            "the lake {lake} has no building 'towr' (did you mean 'tower'?); it has tower",
        ),
        (
            "campaigns_compared",
            {"building_id": "tower", "to_campaign": "x"},
            "the lake {lake} has no campaign 'x' of building 'tower'; it has 2025-10, 2026-04, z-2025",
        ),
        (
            "track_history",
            {"track_id": "TOWER-7"},
            "the lake {lake} has no track 'TOWER-7' (did you mean 'tower-0007'?); it",
        ),
        ("track_history", {"track_id": "99"}, "the lake {lake} has no track '99'; it has tower-0001, tower-0002, "),
        (
            "element_history",
            {"element_guid": "3vB2"},
            "the lake {lake} has no element '3vB2'; it has 3vB2YO$MX4xv5uCqZZG05x",
        ),
        (
            "grown_defects",
            {"quantity": "crack_width"},
            "quantity=crack_width: there is no changed quantity 'crack_width' (did you mean 'crack_width_mm'?); there "
            "are length_m, area_m2, crack_width_mm",
        ),
        (
            "tracks",
            {"states": "new, grwn"},
            "states=new, grwn: there is no track state 'grwn' (did you mean 'grown'?); there ",
        ),
        (
            "tracks",
            {"defect_class": "cracks"},
            "defect_class=cracks: there is no defect class 'cracks' (did you mean 'crack'?)",
        ),
        (
            "models_of_defects",
            {"campaign_id": FIRST, "defect_id": "defect-0004"},  # that of another campaign
            "the lake {lake} has no defect 'defect-0004' of campaign 'z-2025' (did you mean 'defect-0003'?); it has ",
        ),
    ],
)
def test_an_unknown_value_is_told_and_not_answered_with_no_rows(
    built, question: str, given: dict[str, str], told: str
) -> None:
    """No rows would read as 'nothing is new'."""
    with pytest.raises(InputDataError) as raised:
        answer_question(built[0], question, given)
    assert str(raised.value).startswith(told.format(lake=built[0]))


def test_known_values_are_accepted(built) -> None:
    assert len(ask(built, "track_history", building_id=BUILDING, track_id="2")) == 3
    assert len(ask(built, "tracks", building_id=None, states="new, first_seen", defect_class="spalling")) == 1
    assert len(ask(built, "merges_of_defect", campaign_id=THIRD, defect_id="1")) == 0
    with pytest.raises(InputDataError, match=rf"at version {built[1][SECOND]} no campaign '{THIRD}'"):
        ask(built, "worst_defects", campaign_id=THIRD, as_of=built[1][SECOND])


def test_of_many_values_the_nearest_are_told_and_what_lists_all(tmp_path: Path) -> None:
    commit(tmp_path, defects=30)
    with pytest.raises(InputDataError) as raised:
        answer_question(tmp_path, "models_of_defects", {"defect_id": "defekt-13"})
    assert str(raised.value) == (
        f"the lake {tmp_path} has no defect 'defekt-13' (did you mean 'defect-0013', 'defect-0003' or 'defect-0001'?); "
        'it has 30, see facadelake sql "SELECT DISTINCT defect_id FROM defects ORDER BY ALL"'
    )


@pytest.mark.parametrize("question", list_questions(), ids=lambda question: question.name)
def test_every_parameter_declares_what_it_may_be(question) -> None:
    for name, declared in question.parameters.items():
        assert declared, name
        table, dot, column = declared.removesuffix(", ...").removesuffix(" or number").partition(".")
        if dot:
            assert column in LAKE_TABLES[table].arrow.names
        else:
            assert declared in ("number", "date") or " | " in declared, name


def test_a_building_without_a_history_is_listed_without_numbers(tmp_path: Path) -> None:
    commit(tmp_path, defects=1)
    (row,) = answer_question(tmp_path, "growth_by_building").to_pylist()
    assert (row["building_id"], row["campaigns"], row["tracks"]) == (BUILDING, 1, None)
    assert len(answer_question(tmp_path, "worst_defects")) == 1
