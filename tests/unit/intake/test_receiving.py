"""Uploads are received once, as a whole, after they are complete; and what contradicts them is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.intake import Upload, UploadState, receive_complete_uploads
from facadelake.intake.intake_pass import IntakeReport
from tests.unit.intake.made_uploads import MadePlace


@pytest.fixture
def place(tmp_path: Path) -> MadePlace:
    return MadePlace(tmp_path)


def run_pass(place: MadePlace, minutes: float = 5) -> IntakeReport:
    """A pass some time after the one before."""
    place.clock.advance(minutes=minutes)
    return receive_complete_uploads(place.buildings, place.settings, place.clock)


def run_until_quiet(place: MadePlace) -> IntakeReport:
    """Passes until an upload that does not change is complete."""
    run_pass(place)
    return run_pass(place, minutes=30)


def get_single(report: IntakeReport) -> Upload:
    (upload,) = report.uploads
    return upload


def test_an_upload_in_pieces_is_received_once_after_the_quiet_time(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(3))
    report = run_pass(place)
    assert get_single(report).state is UploadState.GROWING
    assert get_single(report).reason == "nothing has changed for 0 of 30 minutes"
    place.clock.advance(minutes=20)
    place.upload_photographs("2026-04", range(3, 6))
    assert get_single(run_pass(place)).state is UploadState.GROWING
    assert get_single(run_pass(place, minutes=29)).state is UploadState.GROWING
    assert not (place.root / "photographs").exists()
    report = run_pass(place, minutes=1)
    upload = get_single(report)
    assert (upload.state, upload.campaign_id, upload.photographs) == (UploadState.RECEIVED, "2026-04", 6), upload
    assert place.list_received("2026-04") == [f"DJI_{seed:04d}.JPG" for seed in range(6)]
    assert [one.folder for one in report.news] == ["2026-04"]
    assert place.get_building().list_campaigns() == ("2026-04",)
    assert not list((place.root / "photographs" / "mill").glob(".*"))
    assert run_pass(place).news == ()
