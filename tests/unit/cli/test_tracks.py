"""The list of tracks in the terminal, the column of tracks in that of defects, and reviews of states."""

from __future__ import annotations

import shutil
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from cli.main import app
from cli.terminal.listings import show_defects
from cli.terminal.tracks import show_tracks
from facadelake.core.errors import InputDataError
from facadelake.lake.read import list_versions, query, read_table
from facadelake.reviews import review_track
from schemas.vocabulary import TrackState
from tests.sql.small_history import FIRST, SECOND, THIRD, commit_history
from tests.unit.lake.small_campaign import BUILDING, commit


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("history") / "lake"
    commit_history(folder)
    return folder


def list_lines(lake: Path, *, states: str | None = None, width: int = 200, as_of: int | None = None) -> list[str]:
    console = Console(file=StringIO(), width=width)
    show_tracks(console, lake, lake, BUILDING, states=states, defect_class=None, limit=40, as_of=as_of)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue().splitlines()


def test_what_matters_comes_first_with_its_change_and_sigma(lake: Path) -> None:
    lines = [line for line in list_lines(lake) if "tower-0" in line]
    assert [line.split()[1][-1] for line in lines] == ["4", "2", "5", "6", "3", "7", "1"]
    assert "width +0.10 ± 0.02 mm in 0.5 a" in lines[0]
    assert "≤ 2025-04-01" in lines[1]  # of unknown age
    assert "≤" not in lines[2]
    assert lines[4].rstrip(" │").endswith("≤ 2025-04-01 │ 2025-04-01")  # repaired: last seen before
    assert list_lines(lake)[0].startswith("7 of 7 tracks of tower, state of 2026-04")


def test_states_are_chosen_and_a_narrow_terminal_cuts_nothing(lake: Path) -> None:
    lines = list_lines(lake, states="new, first_seen", width=100)
    assert [line.split()[1] for line in lines if "tower-0" in line] == ["tower-0005", "tower-0006"]
    assert not any("…" in line for line in lines)


def test_what_is_unknown_is_told(lake: Path, tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"no state 'grwn' \(did you mean 'grown'\?\); there are new, first_seen"):
        list_lines(lake, states="new,grwn")
    with pytest.raises(InputDataError, match=r"at version 8 no tracks of building 'tower'.*'facadelake track tower'"):
        list_lines(lake, as_of=8)  # before the history was written
    commit(tmp_path, defects=1)
    with pytest.raises(InputDataError) as raised:
        list_lines(tmp_path)
    assert str(raised.value) == (
        f"the lake {tmp_path} has no tracks of building 'tower': its campaigns were committed without a history; "
        "'facadelake track tower' makes it"
    )


def test_defects_name_their_track_where_there_is_a_history(lake: Path, tmp_path: Path) -> None:
    commit(tmp_path, defects=1)
    for folder, track in ((lake, "tower-0005"), (tmp_path, None)):
        console = Console(file=StringIO(), width=200)
        show_defects(console, folder, folder, BUILDING, THIRD if track else None, None, 10, None)
        assert isinstance(console.file, StringIO)
        told = console.file.getvalue()
        assert ("┃ track" in told, "tower-0005" in told) == (track is not None, track is not None)


@pytest.fixture
def copied(lake: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(lake, tmp_path / "copied"))


def test_a_review_is_appended_once_and_changes_nothing_else(copied: Path) -> None:
    states = read_table(copied, "track_states")
    done = review_track(copied, "tower-0004", THIRD, "seen", reviewer=" A. Mason ", note="paint")
    assert (done.building_id, done.state_before, done.added.added) == (BUILDING, TrackState.GROWN, 1)
    again = review_track(copied, "tower-0004", THIRD, "seen", reviewer="A. Mason", note="paint")
    assert (again.added.version, again.added.unchanged) == (None, 1)
    review_track(copied, "tower-0004", THIRD, "grown", reviewer="B. Site")
    review_track(copied, "tower-0005", SECOND, "not_imaged", reviewer="B. Site")
    rows = query(copied, "SELECT * FROM track_reviews ORDER BY reviewed_at").to_pylist()
    assert [(row["review_id"], row["track_id"], row["track_state"], row["reviewer"], row["note"]) for row in rows] == [
        (f"tower-{THIRD}-T00001", "tower-0004", "seen", "A. Mason", "paint"),
        (f"tower-{THIRD}-T00002", "tower-0004", "grown", "B. Site", None),
        (f"tower-{SECOND}-T00001", "tower-0005", "not_imaged", "B. Site", None),
    ]  # fmt: skip
    assert {row["run_id"] for row in rows} == {f"run-{THIRD}", f"run-{SECOND}"}
    assert read_table(copied, "track_states").equals(states)
    assert list_versions(copied).to_pylist()[-1]["reviewed_by"] == "B. Site"


@pytest.mark.parametrize(
    ("track", "campaign", "state", "reviewer", "told"),
    [
        (
            "tower-0099", THIRD, "seen", "A",
            "no track 'tower-0099' (did you mean 'tower-0008'?); it has tower-0001, tower-0002",
        ),
        (
            "tower-0004", "2026-05", "seen", "A",
            "no campaign '2026-05' of building 'tower' (did you mean '2026-04'?); it has 2025-10, 2026-04",
        ),
        (
            "tower-0004", THIRD, "vanished", "A",
            "there is no state 'vanished'; there are new, first_seen, seen, grown, shrunk, ",
        ),
        ("tower-0004", THIRD, "seen", " ", "needs the reviewer's name"),
        (
            "tower-0008", THIRD, "seen", "A",
            "track tower-0008 is withdrawn: no campaign in the lake has the defect any more, so that its state cannot "
            "be reviewed; 'facadelake tracks' lists the others",
        ),
        ("4", THIRD, "seen", "A", "has no track '4' (did you mean 'tower-0004'?); it has tower-0001, "),
    ],
)  # fmt: skip
def test_a_review_of_something_unknown_is_refused(
    lake: Path, track: str, campaign: str, state: str, reviewer: str, told: str
) -> None:
    with pytest.raises(InputDataError) as raised:
        review_track(lake, track, campaign, state, reviewer=reviewer)
    assert told in str(raised.value)
    assert len(read_table(lake, "track_reviews")) == 0


def test_the_command_says_what_applies_the_review(copied: Path) -> None:
    review = ["review", "track", "tower-0002", FIRST, "seen", "--reviewer", "A. Mason", "--lake", str(copied)]
    done = CliRunner().invoke(app, review)
    assert "tower-0002 in z-2025: 'seen' in place of 'first_seen', in lake version" in done.stdout
    assert "'facadelake track tower', or the next inspection of the building, applies it" in done.stdout
    assert "nothing new: the latest review of tower-0002" in CliRunner().invoke(app, review).stdout
