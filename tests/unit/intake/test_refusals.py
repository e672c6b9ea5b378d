"""What contradicts an upload refuses it, with both values and a remedy, until a person answers."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.intake import Upload, UploadState
from facadelake.intake.source import UploadSource
from facadelake.registry.settings import SiteOriginSetting
from tests.unit.intake.made_uploads import LAT_DEG, LON_DEG, MadePlace, get_upload
from tests.unit.photos.small_photographs import photograph


@pytest.fixture
def place(tmp_path: Path) -> MadePlace:
    """Two buildings 1.5 km apart, whose origins are in the portfolio."""
    return MadePlace(tmp_path, origins=True)


def receive(place: MadePlace, folder: str, building_id: str = "mill") -> Upload:
    """The upload after it was complete."""
    return get_upload(place.run_until_quiet(), folder, building_id)


def answer(place: MadePlace, folder: str, text: str) -> Upload:
    """The upload after a person's answer."""
    place.upload(f"{folder}/campaign.yaml", text.encode())
    place.run_pass()
    return get_upload(place.run_pass(minutes=1), folder)


def test_a_folder_whose_date_the_photographs_contradict(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(3), taken="2025:10:03 10:00:00")
    upload = receive(place, "2026-04")
    assert upload.state is UploadState.REFUSED
    assert upload.reason == (
        "3 of 3 photographs were taken on 2025-10-03, which is not 2026-04 (by more than 31 days): name the folder by "
        "its date (on 2025-10-03), move photographs of another campaign away, or, if 2026-04 is right and the camera's "
        "clock was wrong, write 'accept: [dates]' into campaign.yaml"
    )
    assert not (place.root / "photographs" / "mill" / "2026-04").exists()
    accepted = answer(place, "2026-04", "accept: dates")
    assert (accepted.state, accepted.campaign_id) == (UploadState.RECEIVED, "2026-04"), accepted.reason


def test_a_mixed_folder_is_refused_and_a_stray_is_told(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(19))
    place.upload_photographs("2026-04", range(19, 20), taken="2025:10:03 10:00:00")
    upload = receive(place, "2026-04")
    assert upload.state is UploadState.RECEIVED
    stray = "1 of 20 photographs were taken on 2025-10-03, which is not 2026-04 (by more than 31 days)"
    assert stray in upload.remarks
    place.upload_photographs("DCIM", range(20, 25), taken="2025:10:03 10:00:00")
    place.upload_photographs("DCIM", range(25, 30))
    mixed = receive(place, "DCIM").reason
    assert mixed.startswith(
        "its photographs were taken from 2025-10-03 to 2026-04-14, over more than 92 days, and its folder's name says "
        "no date: put each campaign into a folder of its own, such as 2026-04"
    )


def test_photographs_of_the_future(place: MadePlace) -> None:
    place.upload_photographs("2062", range(2), taken="2062:04:14 10:00:00")
    assert receive(place, "2062").reason == (
        "2 of 2 photographs were taken in the future (on 2062-04-14; today is 2026-04-12): correct the capture times, "
        "which the camera's clock gave, or write 'accept: [dates]' into campaign.yaml"
    )


def test_a_folder_whose_name_holds_no_month(place: MadePlace) -> None:
    place.upload_photographs("2026-13", range(2))
    assert receive(place, "2026-13").reason == (
        "its folder's name '2026-13' holds '2026-13', which is no month of the calendar; rename the folder, such as to "
        "2026-04, or write 'campaign: 2026-04' into a file campaign.yaml in it"
    )
    answered = answer(place, "2026-13", "campaign: 2026-04")
    assert (answered.state, answered.campaign_id) == (UploadState.RECEIVED, "2026-04")


def test_no_date_anywhere(place: MadePlace) -> None:
    place.upload_photographs("DCIM", range(2), taken="1980:01:01 00:00:00")
    assert receive(place, "DCIM").reason == (
        "neither its folder's name 'DCIM' nor its photographs say when they were taken: rename the folder, such as to "
        "2026-04, or write 'campaign: 2026-04' into campaign.yaml"
    )


def test_photographs_of_another_building(place: MadePlace) -> None:
    for seed in range(5):
        place.upload(f"2026-04/{seed}.JPG", photograph(LAT_DEG + 0.0135, LON_DEG, seed=seed))
    upload = receive(place, "2026-04")
    assert upload.state is UploadState.REFUSED
    assert upload.reason == (
        "5 of 5 photographs with a position were taken 1,501 m from building 'mill' (median; place by the origin in "
        "the portfolio; limit 500 m, or nearer to another building), 5 of them near building 'tower' (0 m): move them "
        "to the source of 'tower', or, if they do show 'mill', write 'accept: [position]' into campaign.yaml"
    )
    assert answer(place, "2026-04", "accept: [position]").state is UploadState.RECEIVED


def test_a_building_next_door_is_told_apart(tmp_path: Path) -> None:
    place = MadePlace(tmp_path, origins=True, apart_deg=0.001)  # 111 m
    for seed in range(5):
        place.upload(f"2026-04/{seed}.JPG", photograph(LAT_DEG + 0.0009, LON_DEG, seed=seed))
    assert "5 of them near building 'tower' (11 m)" in receive(place, "2026-04").reason


def test_positions_that_nothing_is_known_to_compare_with_are_told(tmp_path: Path) -> None:
    place = MadePlace(tmp_path)
    place.upload_photographs("2026-04", range(2))
    for seed in range(2, 4):
        place.upload(f"2026-05/{seed}.JPG", photograph(seed=seed))
    report = place.run_until_quiet()
    unknown = "the place of the building is not known yet: positions are not compared"
    assert unknown in get_upload(report, "2026-04").remarks
    none = "no photograph has a position: not compared with the place of the building"
    assert none in get_upload(report, "2026-05").remarks


def test_the_same_photographs_under_another_name_and_at_another_building(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(10))
    place.run_until_quiet()
    place.upload_photographs("2026-04-copy", range(10))
    upload = receive(place, "2026-04-copy")
    assert upload.state is UploadState.REFUSED
    assert upload.reason == (
        "10 of 10 photographs are those of upload '2026-04' of building 'mill', received as campaign 2026-04: remove "
        "this upload, or, if they are to be inspected again as a campaign of their own, write 'accept: [duplicate]' "
        "into campaign.yaml"
    )
    place.upload_photographs("2026-05", range(2), building_id="mill")
    place.upload_photographs("2026-05", range(10, 20))
    shared = receive(place, "2026-05")
    assert shared.state is UploadState.RECEIVED
    assert (
        "2 of 12 photographs are those of upload '2026-04' of building 'mill', received as campaign 2026-04"
        in shared.remarks
    )


def test_two_copies_that_are_complete_in_the_same_pass_are_received_once(place: MadePlace) -> None:
    place.upload_photographs("DCIM", range(4))
    place.upload_photographs("2026-04", range(4))
    report = place.run_until_quiet()
    states = sorted(one.state for one in report.uploads)
    assert states == [UploadState.RECEIVED, UploadState.REFUSED]


def test_a_campaign_that_is_there_already_with_other_photographs(place: MadePlace) -> None:
    place.upload_photographs("2026-04 east", range(4))
    place.run_until_quiet()
    place.upload_photographs("2026-04 west", range(4, 8))
    upload = receive(place, "2026-04 west")
    assert upload.reason == (
        "campaign 2026-04 is there already, with 4 photographs, 0 of which are among the 4 of this upload: rename the "
        "folder, such as to 2026-04-2, or, if it belongs to that campaign, write 'accept: [addition]' into "
        "campaign.yaml"
    )
    added = answer(place, "2026-04 west", "accept: [addition]")
    assert added.state is UploadState.RECEIVED
    assert place.list_received("2026-04")[:2] == ["2026-04 west/DJI_0004.JPG", "2026-04 west/DJI_0005.JPG"]
    place.upload_photographs("2026-04 west", range(8, 9))
    assert receive(place, "2026-04 west").state is UploadState.RECEIVED
    assert "2026-04 west/DJI_0008.JPG" in place.list_received("2026-04")


def test_a_late_photograph_of_an_equal_name_does_not_replace_the_first(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(3))
    place.run_until_quiet()
    first = (place.root / "photographs/mill/2026-04/DJI_0001.JPG").read_bytes()
    place.upload("2026-04/DJI_0001.JPG", photograph(LAT_DEG, LON_DEG, seed=77))
    upload = receive(place, "2026-04")
    assert upload.state is UploadState.RECEIVED
    assert upload.remarks[-1] == (
        "received before with another content, and left as they were: DJI_0001.JPG; other photographs belong into a "
        "folder of their own, newer ones of the same replace them with 'accept: [changed]' in campaign.yaml"
    )
    assert (place.root / "photographs/mill/2026-04/DJI_0001.JPG").read_bytes() == first
    replaced = answer(place, "2026-04", "accept: changed")
    assert "received before with another content, and replaced: DJI_0001.JPG" in replaced.remarks
    assert (place.root / "photographs/mill/2026-04/DJI_0001.JPG").read_bytes() != first


def test_late_photographs_of_another_building_are_refused_and_the_campaign_stays(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(3))
    place.run_until_quiet()
    for seed in range(10, 13):
        place.upload(f"2026-04/{seed}.JPG", photograph(LAT_DEG + 0.0135, LON_DEG, seed=seed))
    upload = receive(place, "2026-04")
    assert upload.state is UploadState.REFUSED and "near building 'tower'" in upload.reason
    assert len(place.list_received("2026-04")) == 3
    for seed in range(10, 13):
        (place.root / f"uploads/mill/2026-04/{seed}.JPG").write_bytes(b"\xff\xd8\xff")
    unreadable = receive(place, "2026-04")
    assert unreadable.state is UploadState.REFUSED and unreadable.campaign_id == "2026-04"


def test_no_photographs_and_none_that_can_be_read(place: MadePlace) -> None:
    place.upload("2026-04/notes.txt", b"windy")
    place.upload("2026-05/1.JPG", b"\xff\xd8\xff")
    report = place.run_until_quiet()
    assert get_upload(report, "2026-04").reason == "it has no photographs; put them into this folder"
    unreadable = get_upload(report, "2026-05").reason
    assert unreadable.startswith("none of its 1 photographs can be read (the file has no known image format")


def test_an_answer_with_mistakes(place: MadePlace) -> None:
    place.upload_photographs("2026-04", range(2))
    place.upload("2026-04/campaign.yaml", b"accept: [everything]\ncampain: 2026-04")
    reason = receive(place, "2026-04").reason
    assert reason.startswith("its campaign.yaml has mistakes (accept.0: Input should be 'dates', 'position'")
    assert reason.endswith(
        "); allowed are 'campaign: 2026-04', 'accept: [dates, position, duplicate, addition, changed]' and "
        "'photographs: 412'"
    )
    assert "is not readable as YAML" in answer(place, "2026-04", "campaign: [").reason
    assert answer(place, "2026-04", "campaign: 2026-04-14").campaign_id == "2026-04-14"


def test_all_that_is_wrong_is_told_at_once(place: MadePlace) -> None:
    for seed in range(3):
        picture = photograph(LAT_DEG + 0.0135, LON_DEG, seed=seed, taken="2025:10:03 10:00:00")
        place.upload(f"2026-04/{seed}.JPG", picture)
    reason = receive(place, "2026-04").reason
    assert "which is not 2026-04" in reason and "near building 'tower'" in reason


def test_a_refused_upload_is_judged_again_without_being_read(place: MadePlace, monkeypatch: pytest.MonkeyPatch) -> None:
    place.upload_photographs("2026-04", range(3), taken="2025:10:03 10:00:00")
    report = place.run_until_quiet()
    assert [one.state for one in report.news] == [UploadState.REFUSED]

    def refuse(*_: object) -> None:
        raise AssertionError("read again")

    monkeypatch.setattr(UploadSource, "open_file", refuse)
    for minutes in (5, 56, 5):
        report = place.run_pass(minutes=minutes)
        assert get_upload(report, "2026-04").state is UploadState.REFUSED and report.news == ()


def test_the_place_of_a_building_is_that_of_its_model_in_the_portfolio() -> None:
    origin = SiteOriginSetting(lon_deg=LON_DEG, lat_deg=LAT_DEG, height_ellipsoidal_m=180.0)
    assert MadePlace(Path("/nowhere"), origins=True).get_building("mill").crs.origin == origin
