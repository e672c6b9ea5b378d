"""The rule of right states, and truth files of both layouts."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.evaluation.history.expected_states import check_stated_states, list_right_states
from facadelake.evaluation.history.truth import read_history_truth
from schemas.vocabulary import DefectClass, TrackState
from tests.unit.evaluation.history.made_history import place


@pytest.mark.parametrize(
    ("days", "size", "detected", "right"),
    [
        (("there", "there", "there"), (1, 1, 1), (1, 1, 1), ("first_seen", "seen", "seen")),
        (("gone", "there", "there"), (1, 1, 1), (0, 1, 1), ("", "new", "seen")),
        # Not imaged before: its age is unknown.
        (("hidden gone", "there", "there"), (1, 1, 1), (0, 1, 1), ("", "first_seen", "seen")),
        (("hidden", "hidden", "there"), (1, 1, 1), (0, 0, 1), ("", "", "first_seen")),
        # What is not imaged is not known, whatever is there.
        (("there", "hidden gone", "gone"), (1, 1, 1), (1, 0, 0), ("first_seen", "not_imaged", "repaired")),
        (("there", "gone", "gone"), (1, 1, 1), (1, 0, 0), ("first_seen", "repaired", "repaired")),
        (("there", "gone", "there"), (1, 1, 1.4), (1, 0, 1), ("first_seen", "repaired", "reopened")),
        (("there", "there", "there"), (1, 1.4, 1.4), (1, 1, 1), ("first_seen", "grown", "seen")),
        (("there", "there", "there"), (1, 1, 0.5), (1, 1, 1), ("first_seen", "seen", "shrunk")),
        # Found only after its repair had failed: nothing is known of the time before the repair.
        (("there", "gone", "there"), (1, 1, 1), (0, 0, 1), ("", "", "new")),
        # Missed at first: a look back can tell that it was there.
        (("there", "there", "there"), (1, 1, 1), (0, 1, 1), ("first_seen", "seen", "seen")),
        # It grew while the detector missed it: the change is that between two detections.
        (("there", "there", "there"), (1, 1.4, 1.4), (1, 0, 1), ("first_seen", "grown|seen", "grown")),
        (("there", "there", "there"), (1, 1.4, 1.4), (0, 1, 1), ("first_seen", "grown|seen", "seen")),
        (("there", "hidden", "there"), (1, 1.4, 1.4), (1, 0, 1), ("first_seen", "not_imaged", "grown")),
    ],
)
def test_right_states(
    days: Sequence[str], size: Sequence[float], detected: Sequence[int], right: Sequence[str]
) -> None:
    found = list_right_states(place("D1", *days, size=size), [bool(one) for one in detected])
    assert ["|".join(states) for states in found] == list(right)


def write(path: Path, header: str, *rows: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(line.split(",") for line in (header, *rows))


DEMO_HEADER = "id,class,state,true_state,width_m,height_m,photographs_of_place,track_state"


def write_demo(folder: Path) -> Path:
    for campaign, rows in {
        "2025": ("D1,crack,present,present,0.3,0.4,5,first_seen", "D2,moisture,absent,absent,0,0,0,"),
        "2026": ("D1,spalling,grown,grown,0.6,0.8,4,grown", "D2,moisture,new,new,0.2,0.2,3,first_seen"),
    }.items():
        truth = folder / "campaigns" / campaign / "truth"
        write(truth / "defects.csv", DEMO_HEADER, *rows)
        write(truth / "detections.csv", "file,annotation_id,checkpoint_id", "b.json,1,D1", "b.json,2,off_target")
    return folder


def test_truth_of_the_demo(tmp_path: Path) -> None:
    truth = read_history_truth(write_demo(tmp_path))
    assert list(truth.defects) == ["2025", "2026"]
    before, after = (truth.defects[campaign][0] for campaign in truth.defects)
    assert (before.defect_class, after.defect_class) == (DefectClass.CRACK, DefectClass.SPALLING)
    assert (before.width_m, after.width_m, after.stated) == (0.3, 0.6, TrackState.GROWN)
    unborn = truth.defects["2025"][1]
    assert (unborn.exists, unborn.imaged, unborn.stated) == (False, False, None)
    assert truth.true_id_of_annotation["2026"] == {("b.json", "1"): "D1", ("b.json", "2"): None}
    for row in range(2):
        check_stated_states([truth.defects[campaign][row] for campaign in truth.defects])


def test_stated_states_that_the_other_columns_contradict(tmp_path: Path) -> None:
    truth = read_history_truth(write_demo(tmp_path))
    history = [truth.defects[campaign][0] for campaign in truth.defects]
    with pytest.raises(InputDataError) as raised:
        check_stated_states([history[0], replace(history[1], stated=TrackState.SEEN)])
    assert str(raised.value) == (
        "truth states 'seen' of D1 in 2026, but by its other columns (exists, imaged, size, in all campaigns until "
        "then) it is grown; correct one of them"
    )


PAIR_HEADER = "id,class,state,width_m,height_m,photographs_2026-04,photographs_2026-10"


def write_pair(folder: Path, *rows: str) -> Path:
    listed = rows or (
        "D1,crack,seen,3,4,2,3",
        "D2,crack,grown,3,4,2,3",
        "D3,crack,repaired,3,4,2,0",
        "D4,crack,new,3,4,0,3",
    )
    write(folder / "truth" / "defects.csv", PAIR_HEADER, *listed)
    write(
        folder / "truth" / "detections.csv", "campaign,file,annotation_id,defect_id",
        "2026-04,b.json,1,D1", "2026-10,b.json,1,false",
    )  # fmt: skip
    return folder


def test_truth_of_a_pair(tmp_path: Path) -> None:
    truth = read_history_truth(write_pair(tmp_path))
    assert list(truth.defects) == ["2026-04", "2026-10"]
    histories = {before.true_id: [before, after] for before, after in zip(*truth.defects.values(), strict=True)}
    right = {name: list_right_states(history, [True, True]) for name, history in histories.items()}
    assert right == {
        "D1": [("first_seen",), ("seen",)],
        "D2": [("first_seen",), ("grown",)],
        "D3": [("first_seen",), ("repaired",)],
        "D4": [(), ("new",)],
    }
    assert (histories["D2"][1].width_m, histories["D3"][1].width_m) == pytest.approx((4.2, 0.0))
    assert truth.true_id_of_annotation["2026-10"] == {("b.json", "1"): None}


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("D1,crack,vanished,3,4,2,3", "line 2, column state: 'vanished' is not one of seen, grown"),
        ("D1,stain,seen,3,4,2,3", "column class: 'stain' is not one of crack"),
        ("D1,crack,seen,wide,4,2,3", "column width_m: 'wide' is not a number"),
    ],
)
def test_invalid_truth_is_told_with_its_line(tmp_path: Path, row: str, message: str) -> None:
    with pytest.raises(InputDataError, match=message):
        read_history_truth(write_pair(tmp_path, row))


def test_a_folder_without_truth_of_a_history(tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        read_history_truth(tmp_path)
    assert str(raised.value) == (
        f"{tmp_path} has no truth of a history: truth of a history is either a folder with "
        "campaigns/CAMPAIGN/truth/defects.csv and detections.csv (as that of the demo), or one with defects.csv and "
        "detections.csv of a pair of campaigns (columns state, photographs_CAMPAIGN; campaign)"
    )


def test_campaigns_must_list_the_same_defects(tmp_path: Path) -> None:
    folder = write_demo(tmp_path)
    write(folder / "campaigns" / "2026" / "truth" / "defects.csv", DEMO_HEADER, "D1,crack,grown,grown,0.6,0.8,4,grown")
    with pytest.raises(InputDataError) as raised:
        read_history_truth(folder)
    files = [folder / "campaigns" / campaign / "truth" / "defects.csv" for campaign in ("2026", "2025")]
    assert str(raised.value) == (
        f"{files[0]} and {files[1]} do not list the same defects in one order (in one alone: D2); list every defect in "
        "every campaign, with its state"
    )
