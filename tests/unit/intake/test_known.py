"""What the lake knows: where buildings are, and which photographs were inspected before."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from facadelake.intake import UploadState
from facadelake.intake.known import find_campaign_photographs, find_inspected, find_places
from facadelake.lake import read_table
from tests.unit.intake.made_uploads import MadePlace, get_upload
from tests.unit.lake.small_campaign import CAMPAIGN, LAT, LON, commit
from tests.unit.photos.small_photographs import photograph


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake with one campaign of the building ``tower``."""
    folder = tmp_path_factory.mktemp("known")
    commit(folder)
    return folder


def test_a_building_is_where_its_photographs_were_taken(lake: Path) -> None:
    place = find_places([], lake)["tower"]
    assert place.evidence in ("the photographs of its campaigns", "the origin of its model")
    assert (place.lon_deg, place.lat_deg) == pytest.approx((LON, LAT), abs=1e-3)


def test_photographs_are_found_in_the_lake_by_their_content(lake: Path) -> None:
    held = {row["sha256"] for row in read_table(lake, "photos").to_pylist()}
    assert find_campaign_photographs("tower", CAMPAIGN, lake) == held
    assert find_campaign_photographs("mill", CAMPAIGN, lake) == frozenset()
    hashes = {one for one in held if len(one) == 64}
    found = find_inspected(hashes, lake)
    assert found == ({("tower", CAMPAIGN): frozenset(hashes)} if hashes else {})


def test_without_a_lake_nothing_is_known(tmp_path: Path) -> None:
    assert find_places([], tmp_path / "none") == {} and find_inspected({"a" * 64}, tmp_path / "none") == {}


def test_an_upload_at_another_buildings_place_and_one_of_a_campaign_that_the_lake_has(
    tmp_path: Path, lake: Path
) -> None:
    place = MadePlace(tmp_path)
    shutil.copytree(lake, tmp_path / "lake")
    for seed in range(3):
        picture = photograph(LAT, LON, seed=seed)
        place.upload(f"2026-05/{seed}.JPG", picture)
        place.upload(f"{CAMPAIGN}/{seed}.JPG", photograph(LAT, LON, seed=seed + 10), building_id="tower")
    report = place.run_until_quiet()
    (remark,) = [line for line in get_upload(report, "2026-05").remarks if "not known yet" in line]
    assert remark.startswith(
        "the place of the building is not known yet: positions are not compared with it; building 'tower' is "
    )
    upload = get_upload(report, CAMPAIGN, "tower")
    assert upload.state is UploadState.REFUSED
    assert upload.reason.startswith(f"campaign {CAMPAIGN} is there already, with ")


def test_a_source_that_leaves_the_portfolio_is_listed_no_more(tmp_path: Path) -> None:
    place = MadePlace(tmp_path)
    place.upload_photographs("2026-04", range(2))
    place.run_until_quiet()
    (tmp_path / "uploads" / "mill").rename(tmp_path / "elsewhere")
    assert place.run_pass().problems
    moved = MadePlace(tmp_path, sources="other", clock=place.clock)
    (tmp_path / "other" / "mill").mkdir(parents=True)
    (tmp_path / "other" / "tower").mkdir(parents=True)
    report = moved.run_pass()
    assert report.problems == () and not get_upload(report, "2026-04").in_source
