"""Campaigns are in order of their photographs' times, and it is told where those are not known."""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa
import pytest
from typer.testing import CliRunner

from cli.main import app
from facadelake.campaigns import find_earlier_campaigns, order_by_capture, resolve_campaign
from facadelake.campaigns.preflight import LATEST
from facadelake.core.errors import InputDataError
from facadelake.registry import Building
from tests.unit.lake.small_campaign import BUILDING, commit
from tests.unit.photos.small_photographs import photograph


def build(folder: Path, times: dict[str, str | None]) -> Building:
    """A building with one photograph and a damaged one in each campaign; None: without a time."""
    for name, taken in times.items():
        (folder / name).mkdir(parents=True)
        (folder / name / "a.jpg").write_bytes(photograph(taken=taken or "0000:00:00 00:00:00"))
        (folder / name / "b.jpg").write_bytes(b"\xff\xd8\xff")
    return Building(id=BUILDING, name="Tower", model="tower.ifc", photographs=f"{folder}/{{campaign}}")


def test_the_latest_campaign_is_the_one_that_was_flown_last_and_not_that_of_the_last_id(tmp_path: Path) -> None:
    times = {"autumn": "2025:10:01 10:00:00", "spring": "2025:04:01 10:00:00", "c10": "2026:10:01 10:00:00"}
    building = build(tmp_path, {**times, "c9": "2026:04:01 10:00:00"})
    assert order_by_capture(building).campaigns == ("spring", "autumn", "c9", "c10")
    assert order_by_capture(building).remarks == ()
    assert resolve_campaign(building, LATEST) == "c10"  # "spring" is last by its text
    assert resolve_campaign(building, "autumn") == "autumn"


def test_a_campaign_without_times_is_placed_by_the_date_of_its_id_and_that_is_told(tmp_path: Path) -> None:
    building = build(tmp_path, {"a-late": "2026:04:01 10:00:00", "2025-10": None, "2025-04": "2000:01:01 00:00:09"})
    order = order_by_capture(building)
    assert order.campaigns == ("2025-04", "2025-10", "a-late")  # a clock of 2000 was not set
    assert order.remarks[1] == (
        "campaign 2025-10: no photograph has a capture time: 2025-10-01 is taken from the id 2025-10"
    )


def test_where_nothing_tells_the_time_the_order_of_the_ids_is_taken_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    building = build(tmp_path, {"b-first": "2026:04:01 10:00:00", "a-second": None})
    with caplog.at_level(logging.WARNING):
        assert resolve_campaign(building, LATEST) == "b-first"
    assert caplog.messages == [
        "no photograph of campaign a-second of 'tower' has a capture time, and its id is no date: the campaigns are "
        "taken in the order of their ids (a-second, b-first), so that the latest is b-first; name the campaign that "
        "you mean"
    ]


def build_photos(taken_at: datetime | None) -> pa.Table:
    """Columns of table ``photos``; a rejected photograph has no say."""
    return pa.table(
        {
            "photo_outcome": ["accepted", "thermal", "accepted"],
            "taken_at": pa.array([taken_at, datetime(2024, 1, 1, tzinfo=UTC), None], pa.timestamp("us", tz="UTC")),
        }
    )


def test_a_campaign_is_placed_by_those_that_were_flown_before_it(tmp_path: Path) -> None:
    photos = build_photos(datetime(2026, 4, 1, tzinfo=UTC))
    assert find_earlier_campaigns(tmp_path, BUILDING, "2026-04", photos) == ()  # no lake yet
    for name, year in (("z-first", 2024), ("b", 2025), ("2026-04", 2026), ("a-last", 2027)):
        commit(tmp_path, campaign_id=name, start=datetime(year, 4, 1, tzinfo=UTC), defects=1)
    assert find_earlier_campaigns(tmp_path, BUILDING, "2026-04", photos) == ("z-first", "b")
    assert find_earlier_campaigns(tmp_path, BUILDING, "2024-10", build_photos(None)) == ("z-first",)
    with pytest.raises(InputDataError, match="no photograph of campaign repeat has a capture time"):
        find_earlier_campaigns(tmp_path, BUILDING, "repeat", build_photos(None))


def test_evaluate_takes_the_latest_campaign_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    build(tmp_path / "photos", {"autumn": "2025:10:01 10:00:00", "spring": "2025:04:01 10:00:00"})
    (tmp_path / "tower.ifc").touch()
    portfolio = tmp_path / "portfolio.yaml"
    portfolio.write_text(
        "buildings: [{id: tower, name: Tower, model: tower.ifc, photographs: 'photos/{campaign}'}]", encoding="utf-8"
    )
    commit(tmp_path / "lake", defects=1)
    chosen: list[str] = []
    monkeypatch.setattr(
        "facadelake.evaluation.campaigns.compare_campaign", lambda building, campaign, **_: chosen.append(campaign)
    )
    given = ["--truth", str(tmp_path), "--portfolio", str(portfolio), "--lake", str(tmp_path / "lake")]
    CliRunner().invoke(app, ["evaluate", "tower", "latest", *given])
    assert chosen == ["autumn"]
