"""A campaign in place is settled after nothing in its folder has changed for the quiet time, as observed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.intake import observe_campaign
from facadelake.registry import Building
from tests.unit.intake.made_uploads import START_S, MadePlace


@pytest.fixture
def place(tmp_path: Path) -> MadePlace:
    folder = tmp_path / "photographs" / "mill" / "2026-04"
    folder.mkdir(parents=True)
    for number in range(3):
        (folder / f"{number}.JPG").write_bytes(b"x" * (10 + number))
        os.utime(folder / f"{number}.JPG", (0, 0))  # as rsync -a leaves them
    return MadePlace(tmp_path)


@pytest.fixture
def building(place: MadePlace) -> Building:
    return place.get_building().model_copy(update={"intake": None})


def test_it_is_settled_after_the_quiet_time_as_observed_whatever_the_files_times(
    place: MadePlace, building: Building
) -> None:
    first = observe_campaign(building, "2026-04", place.settings, place.clock())
    assert not first.is_settled
    assert first.explanation == "its folder has been without a change for 0 of 30 minutes as observed (3 files)"
    place.clock.advance(minutes=29)
    assert not observe_campaign(building, "2026-04", place.settings, place.clock()).is_settled
    place.clock.advance(minutes=1)
    later = observe_campaign(building, "2026-04", place.settings, place.clock())
    assert later.is_settled and later.explanation == ""
    assert (later.files, later.bytes, later.quiet_s) == (3, 33, 1800)


def test_a_change_begins_the_quiet_time_anew(place: MadePlace, building: Building) -> None:
    observe_campaign(building, "2026-04", place.settings, place.clock())
    place.clock.advance(minutes=40)
    grown = building.locate_photographs("2026-04") / "0.JPG"
    grown.write_bytes(b"x" * 100)
    os.utime(grown, (0, 0))
    assert observe_campaign(building, "2026-04", place.settings, place.clock()).quiet_s == 0


def test_a_clock_that_is_set_back_or_forward_changes_no_observed_time(place: MadePlace, building: Building) -> None:
    observe_campaign(building, "2026-04", place.settings, place.clock())
    place.clock.advance(minutes=10)
    place.clock.unix_s = START_S - 86400
    assert observe_campaign(building, "2026-04", place.settings, place.clock()).quiet_s == 600
    place.clock.advance(minutes=10)
    place.clock.unix_s = START_S + 86400
    assert observe_campaign(building, "2026-04", place.settings, place.clock()).quiet_s == 1200


def test_across_a_restart_the_calendar_counts_and_never_backwards(place: MadePlace, building: Building) -> None:
    observe_campaign(building, "2026-04", place.settings, place.clock())
    place.clock.advance(minutes=20)
    place.clock.restart()
    assert observe_campaign(building, "2026-04", place.settings, place.clock()).quiet_s == 1200
    place.clock.restart()
    place.clock.unix_s -= 7200
    assert observe_campaign(building, "2026-04", place.settings, place.clock()).quiet_s == 1200


def test_an_empty_folder_and_one_that_is_not_there(place: MadePlace, building: Building, tmp_path: Path) -> None:
    (tmp_path / "photographs" / "mill" / "2026-10").mkdir()
    empty = observe_campaign(building, "2026-10", place.settings, place.clock())
    assert not empty.is_settled and empty.explanation == "its folder is empty"
    with pytest.raises(InputDataError, match="does not exist"):
        observe_campaign(building, "2027-04", place.settings, place.clock())
