"""Uploads are received once, as a whole, after they are complete, whatever their files are called."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from facadelake.intake import (
    IntakeBusyError,
    UploadState,
    list_uploads,
    observe_campaign,
    receive_complete_uploads,
)
from facadelake.intake.ledger import open_ledger
from tests.unit.intake.made_uploads import MadePlace, get_upload
from tests.unit.photos.small_photographs import photograph


@pytest.fixture
def place(tmp_path: Path) -> MadePlace:
    return MadePlace(tmp_path)


@pytest.fixture
def marked(tmp_path: Path) -> MadePlace:
    """A place whose uploads have a marker."""
    return MadePlace(tmp_path, marker="COMPLETE")


def test_an_upload_in_pieces_is_received_once_after_the_quiet_time(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(3))
    first = get_upload(place.run_pass(), "2026-04")
    assert (first.state, first.reason) == (UploadState.GROWING, "nothing has changed for 0 of 30 minutes")
    place.clock.advance(minutes=20)
    place.upload_photographs("2026-04", range(3, 6))
    assert get_upload(place.run_pass(), "2026-04").state is UploadState.GROWING
    assert get_upload(place.run_pass(minutes=29), "2026-04").state is UploadState.GROWING
    assert list((place.root / "photographs").iterdir()) == []
    report = place.run_pass(minutes=1)
    upload = get_upload(report, "2026-04")
    assert (upload.state, upload.campaign_id, upload.photographs) == (UploadState.RECEIVED, "2026-04", 6)
    assert place.list_received("2026-04") == [f"DJI_{seed:04d}.JPG" for seed in range(6)]
    assert [one.folder for one in report.news] == ["2026-04"]
    assert place.get_building().list_campaigns() == ("2026-04",)
    assert not list((place.root / "photographs" / "mill").glob(".*"))
    assert place.run_pass().news == ()
    assert list_uploads(place.settings)[0] == place.run_pass().uploads


def test_old_times_of_files_are_no_evidence_that_an_upload_is_complete(place: MadePlace) -> None:
    for seed in range(4):
        file = place.upload(f"2026-04/{seed}.JPG", photograph(48.9405, 8.4078, seed=seed))
        os.utime(file, (1_700_000_000, 1_700_000_000))
        assert get_upload(place.run_pass(minutes=25), "2026-04").state is UploadState.GROWING


def test_a_marker_completes_an_upload_once_two_passes_a_minute_apart_see_the_same(marked: MadePlace) -> None:
    marked.upload_photographs("2026-04", range(2))
    waiting = get_upload(marked.run_until_quiet(), "2026-04")
    assert waiting.reason == "its marker 'COMPLETE' is not there"
    marked.upload("2026-04/COMPLETE", b"done")
    assert get_upload(marked.run_pass(), "2026-04").state is UploadState.GROWING
    assert get_upload(marked.run_pass(minutes=0.5), "2026-04").state is UploadState.GROWING
    assert get_upload(marked.run_pass(minutes=0.5), "2026-04").state is UploadState.RECEIVED
    assert marked.list_received("2026-04") == ["DJI_0000.JPG", "DJI_0001.JPG"]


def test_a_marker_that_arrives_before_the_photographs_does_not_complete_them(marked: MadePlace) -> None:
    marked.upload("2026-04/COMPLETE", b"")
    for seed in range(3):
        marked.upload_photographs("2026-04", range(seed, seed + 1))
        assert get_upload(marked.run_pass(), "2026-04").state is UploadState.GROWING
    assert get_upload(marked.run_pass(), "2026-04").state is UploadState.RECEIVED


def test_a_marker_with_a_suffix_that_the_system_hides_is_asked_for(marked: MadePlace) -> None:
    marked.upload_photographs("2026-04", range(2))
    marked.upload("2026-04/COMPLETE.txt", b"")
    reason = get_upload(marked.run_until_quiet(), "2026-04").reason
    assert reason == "its marker 'COMPLETE' is not there (is it 'COMPLETE.txt'? then rename it)"


def test_a_number_of_photographs_is_waited_for(marked: MadePlace) -> None:
    marked.upload_photographs("2026-04", range(2))
    marked.upload("2026-04/COMPLETE", b"photographs: 3")
    reason = get_upload(marked.run_until_quiet(), "2026-04").reason
    assert reason == "2 of the 3 photographs that its COMPLETE says are there"
    marked.upload_photographs("2026-04", range(2, 3))
    assert get_upload(marked.run_until_quiet(), "2026-04").state is UploadState.RECEIVED


def test_folders_are_kept_and_what_is_no_photograph_is_counted(place: MadePlace) -> None:
    for name in ("DCIM/100MEDIA/1.JPG", "DCIM/101MEDIA/1.JPG", "DCIM/101MEDIA/masks/1.png"):
        place.upload(f"2026-04/{name}", photograph(48.9405, 8.4078, seed=len(name)))
    for junk in (".DS_Store", "Thumbs.db", "desktop.ini", "DCIM/._1.JPG", "__MACOSX/1.JPG"):
        place.upload(f"2026-04/{junk}", b"junk")
    for left_out in ("DCIM/flight.MP4", "DCIM/other.mp4", "report.pdf"):
        place.upload(f"2026-04/{left_out}", b"x")
    for unfinished in ("2.JPG.part", ".3.JPG.a1B2c3"):
        place.upload(f"2026-04/{unfinished}", b"x")
    place.upload("2026-04/gcp_list.txt", b"EPSG:25832")
    upload = get_upload(place.run_until_quiet(), "2026-04")
    assert upload.state is UploadState.RECEIVED, upload.reason
    assert place.list_received("2026-04") == [
        "DCIM/100MEDIA/1.JPG", "DCIM/101MEDIA/1.JPG", "DCIM/101MEDIA/masks/1.png", "gcp_list.txt"
    ]  # fmt: skip
    assert "left out, as they are no photographs: 2 .mp4, 1 .pdf" in upload.remarks
    assert "left out, as their transfer has not ended: .3.JPG.a1B2c3, 2.JPG.part; transfer them again" in upload.remarks


@pytest.mark.parametrize("folder", ["DCIM", "100MEDIA", "New folder (2)", "Neuer Ordner"])
def test_a_folder_without_a_date_is_named_by_the_capture_dates(place: MadePlace, folder: str) -> None:
    place.upload_photographs(folder, range(3), taken="2026:04:10 09:00:00")
    upload = get_upload(place.run_until_quiet(), folder)
    assert (upload.state, upload.campaign_id) == (UploadState.RECEIVED, "2026-04")
    assert f"campaign 2026-04 by its capture dates, as the folder's name '{folder}' has no date" in upload.remarks


def test_links_are_not_followed(place: MadePlace, tmp_path: Path) -> None:
    place.upload_photographs("2026-04", range(2))
    (tmp_path / "secret.JPG").write_bytes(photograph(48.9405, 8.4078, seed=9))
    folder = tmp_path / "uploads" / "mill" / "2026-04"
    (folder / "link.JPG").symlink_to(tmp_path / "secret.JPG")
    (folder / "circle").symlink_to(folder)
    place.run_until_quiet()
    assert place.list_received("2026-04") == ["DJI_0000.JPG", "DJI_0001.JPG"]


def test_late_photographs_are_added_to_their_campaign(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(2))
    place.run_until_quiet()
    place.upload_photographs("2026-04", range(2, 4))
    assert get_upload(place.run_pass(), "2026-04").state is UploadState.GROWING
    report = place.run_pass(minutes=30)
    upload = get_upload(report, "2026-04")
    assert upload.state is UploadState.RECEIVED and [one.folder for one in report.news] == ["2026-04"]
    assert "2 files were added to campaign 2026-04" in upload.remarks
    assert place.list_received("2026-04") == [f"DJI_{seed:04d}.JPG" for seed in range(4)]


def test_a_photograph_that_goes_from_the_source_stays_in_its_campaign(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(3))
    place.run_until_quiet()
    (place.root / "uploads/mill/2026-04/DJI_0001.JPG").unlink()
    upload = get_upload(place.run_until_quiet(), "2026-04")
    assert upload.state is UploadState.RECEIVED
    assert "1 file went from the source; what was received stays" in upload.remarks
    assert len(place.list_received("2026-04")) == 3
    shutil.rmtree(place.root / "uploads/mill/2026-04")
    gone = get_upload(place.run_pass(), "2026-04")
    assert (gone.state, gone.in_source) == (UploadState.RECEIVED, False)
    assert len(place.list_received("2026-04")) == 3


def test_a_photograph_received_in_part_is_completed(place: MadePlace) -> None:
    whole = photograph(48.9405, 8.4078, seed=1)
    place.upload_photographs("2026-04", range(1))
    place.upload("2026-04/DJI_0001.JPG", whole[: len(whole) // 2])
    upload = get_upload(place.run_until_quiet(), "2026-04")
    assert any(
        line.startswith("1 photographs cannot be read: DJI_0001.JPG (the photograph cannot be decoded completely")
        for line in upload.remarks
    )
    place.upload("2026-04/DJI_0001.JPG", whole)
    upload = get_upload(place.run_until_quiet(), "2026-04")
    assert "completed, as they had been received in part: DJI_0001.JPG" in upload.remarks
    assert (place.root / "photographs/mill/2026-04/DJI_0001.JPG").read_bytes() == whole


def test_a_received_folder_that_is_renamed_is_the_same_campaign(place: MadePlace) -> None:
    place.upload_photographs("DCIM", range(3))
    place.run_until_quiet()
    source = place.root / "uploads" / "mill"
    (source / "DCIM").rename(source / "2026-04")
    report = place.run_until_quiet()
    renamed = get_upload(report, "2026-04")
    assert (renamed.state, renamed.campaign_id) == (UploadState.RECEIVED, "2026-04"), renamed.reason
    assert not get_upload(report, "DCIM").in_source
    assert len(place.list_received("2026-04")) == 3


def test_without_its_ledger_the_intake_receives_nothing_twice(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(3))
    place.run_until_quiet()
    before = {path: path.stat().st_ino for path in (place.root / "photographs").rglob("*.JPG")}
    (place.root / "lake" / "intake.sqlite").unlink()
    upload = get_upload(place.run_until_quiet(), "2026-04")
    assert (upload.state, upload.campaign_id) == (UploadState.RECEIVED, "2026-04")
    assert {path: path.stat().st_ino for path in (place.root / "photographs").rglob("*.JPG")} == before


def test_one_process_receives_at_a_time(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(2))
    place.run_pass()
    message = "another process receives uploads at the moment; they are received once, by that one"
    with open_ledger(place.settings).hold(), pytest.raises(IntakeBusyError, match=message):
        place.run_pass(minutes=30)
    assert get_upload(place.run_pass(), "2026-04").state is UploadState.RECEIVED


def test_an_upload_that_goes_before_it_is_complete_is_told(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(2))
    place.run_pass()
    shutil.rmtree(place.root / "uploads/mill/2026-04")
    report = place.run_pass()
    assert get_upload(report, "2026-04").state is UploadState.REMOVED
    assert len(report.news) == 1 and place.run_pass().news == ()


def test_a_received_campaign_is_settled_at_once_unless_more_photographs_arrive(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(2))
    place.run_until_quiet()
    assert observe_campaign(place.get_building(), "2026-04", place.settings, place.clock()).is_settled
    place.upload_photographs("2026-04", range(2, 4))
    place.run_pass()
    arriving = observe_campaign(place.get_building(), "2026-04", place.settings, place.clock())
    assert not arriving.is_settled
    assert arriving.explanation == "more photographs of it are arriving (upload '2026-04')"
    place.run_pass(minutes=30)
    assert observe_campaign(place.get_building(), "2026-04", place.settings, place.clock()).is_settled


def test_a_pass_observes_the_campaigns_of_buildings_without_an_intake(place: MadePlace) -> None:
    building = place.get_building().model_copy(update={"intake": None})
    folder = building.place_photographs("2026-04")
    folder.mkdir(parents=True)
    (folder / "1.JPG").write_bytes(photograph(48.9405, 8.4078))
    for _ in range(2):
        receive_complete_uploads([building], place.settings, place.clock)
        place.clock.advance(minutes=30)
    assert observe_campaign(building, "2026-04", place.settings, place.clock()).quiet_s == 3600


@pytest.mark.parametrize(
    "photographs", ["{campaign}", "{campaign}/images", "mill_{campaign}/raw/images", "all/flight-{campaign}-mill"]
)
def test_a_campaign_appears_as_a_whole_whatever_the_path_of_its_photographs(place: MadePlace, photographs: str) -> None:
    place.upload_photographs("2026-04", range(3))
    template = str(place.root / "photographs" / photographs)
    building = place.get_building().model_copy(update={"photographs": template})
    for _ in range(2):
        receive_complete_uploads([building], place.settings, place.clock)
        place.clock.advance(minutes=30)
    assert building.list_campaigns() == ("2026-04",)
    assert len(list(building.locate_photographs("2026-04").iterdir())) == 3
    assert not list((place.root / "photographs").rglob(".*"))


def test_names_that_are_not_utf_8_are_told_and_stop_nothing(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(2))
    folder = os.fsencode(str(place.root / "uploads" / "mill"))
    Path(os.fsdecode(folder + b"/2026-04/\xe4.JPG")).write_bytes(photograph(48.9405, 8.4078, seed=7))
    Path(os.fsdecode(folder + b"/H\xe4user")).mkdir()
    report = place.run_until_quiet()
    upload = get_upload(report, "2026-04")
    assert upload.state is UploadState.RECEIVED
    assert "left out, as their names are not UTF-8: \ufffd.JPG; rename them" in upload.remarks
    assert get_upload(report, "H\ufffduser").reason == "the name of its folder 'H\ufffduser' is not UTF-8; rename it"


def test_names_with_odd_characters_are_kept(place: MadePlace) -> None:
    names = sorted(["new\nline.JPG", "[bold]x[/bold].JPG", "\u00fc" * 120 + ".JPG", "it's (1).JPG"])
    for seed, name in enumerate(names):
        place.upload(f"2026-04/{name}", photograph(48.9405, 8.4078, seed=seed))
    os.mkfifo(place.root / "uploads" / "mill" / "2026-04" / "pipe.JPG")
    assert get_upload(place.run_until_quiet(), "2026-04").state is UploadState.RECEIVED
    assert place.list_received("2026-04") == names
