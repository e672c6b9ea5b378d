"""Sources, disks and object stores that fail: a clear state of that upload, the others go on, nothing is half there."""

from __future__ import annotations

import errno
import shutil
from collections import namedtuple
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import fsspec
import pytest
from pyarrow import fs

from facadelake.core.errors import StoreError
from facadelake.intake import IntakeReport, Upload, UploadState, describe_upload, receive_complete_uploads
from facadelake.intake import receive as receive_module
from facadelake.intake.ledger import LEDGER, open_ledger
from facadelake.intake.listing import ListedFile
from facadelake.intake.source import OpenedFile, UploadSource, open_source
from facadelake.intake.staging import StagedCopy
from tests.unit.intake.made_uploads import LAT_DEG, LON_DEG, MadePlace, get_upload
from tests.unit.photos.small_photographs import photograph


@pytest.fixture
def place(tmp_path: Path) -> MadePlace:
    made = MadePlace(tmp_path)
    made.upload_photographs("2026-04", range(4))
    made.upload_photographs("2026-04", range(10, 12), building_id="tower")
    return made


def receive(place: MadePlace) -> Upload:
    """The upload of the mill after it was complete; that of the tower is received, whatever becomes of this one."""
    report = place.run_until_quiet()
    assert get_upload(report, "2026-04", "tower").state is UploadState.RECEIVED
    return get_upload(report, "2026-04")


def patch_reading(monkeypatch: pytest.MonkeyPatch, before_reading: Callable[[UploadSource], None]) -> None:
    """Call something whenever a file of the mill is read; what it raises, reading raises."""
    read = OpenedFile.read

    def read_after(self: OpenedFile, size: int) -> bytes:
        if self.source.root.endswith("mill"):
            with self.source.explain_errors():
                before_reading(self.source)
        return read(self, size)

    monkeypatch.setattr(OpenedFile, "read", read_after)


def test_an_upload_that_changes_while_it_is_copied_is_waited_for_again(
    place: MadePlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patch_reading(patched, lambda _: place.upload_photographs("2026-04", range(4, 5)))
        upload = receive(place)
    assert upload.state is UploadState.GROWING
    assert upload.reason == "it changed while it was copied (DJI_0004.JPG); it is waited for again"
    assert place.get_building().list_campaigns() == ()
    assert get_upload(place.run_until_quiet(), "2026-04").state is UploadState.RECEIVED
    assert len(place.list_received("2026-04")) == 5


def test_an_object_that_is_replaced_by_one_of_equal_size_and_time_is_told_by_its_etag(
    place: MadePlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    tags = iter(range(1000))
    with monkeypatch.context() as patched:
        patched.setattr(OpenedFile, "etag", property(lambda _: f"etag-{next(tags)}"))
        report = place.run_until_quiet()
    reason = get_upload(report, "2026-04").reason
    assert reason.startswith("it changed while it was copied (DJI_0000.JPG, DJI_0001.JPG, DJI_0002.JPG and 1 more)")


def test_a_source_that_answers_in_part(place: MadePlace, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        listed = UploadSource.list_uploads

        def list_larger(self: UploadSource) -> Any:
            found = listed(self)
            if not self.root.endswith("mill"):
                return found
            longer = {
                name: tuple(
                    ListedFile(path=one.path, bytes=one.bytes + 7, modified_ns=one.modified_ns) for one in files
                )
                for name, files in found.uploads.items()
            }
            return replace(found, uploads=longer)

        patched.setattr(UploadSource, "list_uploads", list_larger)
        upload = receive(place)
    assert upload.state is UploadState.FAILED
    assert "were read: it changed, or the source answers in part" in upload.reason
    assert place.list_received("2026-04") == []


def test_a_disk_that_is_full(place: MadePlace, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    with monkeypatch.context() as patched:
        patched.setattr(
            shutil, "disk_usage", lambda path: usage(10**12, 10**12, 5_000_000 if "mill" in str(path) else 10**12)
        )
        upload = receive(place)
    assert upload.state is UploadState.FAILED
    assert (
        "has 0.01 GB free, the upload needs 0.00 GB and 0.1 GB to spare; free space: it is tried again" in upload.reason
    )
    assert describe_upload(upload).startswith("mill: upload '2026-04' is failed (4 photographs, 0.0 MB): the disk of ")
    again = get_upload(place.run_pass(minutes=5), "2026-04")
    assert again.state is UploadState.RECEIVED


def test_a_copy_that_the_disk_changed_is_made_anew(place: MadePlace, monkeypatch: pytest.MonkeyPatch) -> None:
    def spoil(source: UploadSource, folder: str, staged: StagedCopy, _: object) -> list[str]:
        if source.root.endswith("mill"):
            (staged.folder / "DJI_0002.JPG").write_bytes(b"zeros")
        return []

    with monkeypatch.context() as patched:
        patched.setattr(receive_module, "find_changed", spoil)
        upload = receive(place)
    assert upload.state is UploadState.FAILED
    assert "was read from the source; check the disk: it is copied again" in upload.reason
    assert get_upload(place.run_pass(minutes=5), "2026-04").state is UploadState.RECEIVED
    whole = (place.root / "uploads/mill/2026-04/DJI_0002.JPG").read_bytes()
    assert (place.root / "photographs/mill/2026-04/DJI_0002.JPG").read_bytes() == whole


def test_an_unforeseen_error_of_one_upload_stops_no_other(place: MadePlace, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: UploadSource) -> None:
        raise ZeroDivisionError("division by zero")

    with monkeypatch.context() as patched:
        patch_reading(patched, fail)
        upload = receive(place)
    assert upload.state is UploadState.FAILED
    assert upload.reason == (
        "unexpected ZeroDivisionError: division by zero; please report this, with the service's log"
    )
    assert get_upload(place.run_pass(minutes=5), "2026-04").state is UploadState.RECEIVED


def test_a_disk_that_is_not_mounted_is_not_replaced_by_a_folder(place: MadePlace) -> None:
    (place.root / "photographs").rmdir()
    reason = get_upload(place.run_until_quiet(), "2026-04").reason
    assert reason == (
        f"the photographs' folder {place.root / 'photographs' / 'mill'} cannot be made, as "
        f"{place.root / 'photographs'} does not exist; create that, or mount its disk: it is tried again"
    )
    (place.root / "photographs").mkdir()
    assert get_upload(place.run_pass(minutes=5), "2026-04").state is UploadState.RECEIVED


def test_a_disk_that_fills_while_it_is_written_leaves_nothing_behind(
    place: MadePlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        opened = Path.open

        def open_full(self: Path, mode: str = "r", *rest: Any, **named: Any) -> Any:
            if "w" in mode and "mill" in str(self) and "0002" in self.name:
                raise OSError(errno.ENOSPC, "No space left on device")
            return opened(self, mode, *rest, **named)

        patched.setattr(Path, "open", open_full)
        upload = receive(place)
    assert upload.state is UploadState.FAILED
    assert upload.reason == (
        f"the upload cannot be copied to {place.root / 'photographs' / 'mill'} (No space left on device); check the "
        "space on its disk, and that the service may write there: it is tried again"
    )
    assert list((place.root / "photographs" / "mill").iterdir()) == []
    assert get_upload(place.run_pass(minutes=5), "2026-04").state is UploadState.RECEIVED


def test_what_was_copied_before_a_failure_is_not_copied_again(
    place: MadePlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads = {"count": 0, "limit": 5}  # a file is read twice: its content, and its end

    def fail_later(_: UploadSource) -> None:
        reads["count"] += 1
        if reads["count"] > reads["limit"]:
            raise OSError("AWS Error NETWORK_CONNECTION during GetObject operation: curlCode: 28, Timeout was reached")

    patch_reading(monkeypatch, fail_later)
    failed = receive(place)
    assert failed.state is UploadState.FAILED and "Timeout was reached" in failed.reason
    assert place.get_building().list_campaigns() == ()
    reads |= {"count": 0, "limit": 4}
    assert get_upload(place.run_pass(minutes=5), "2026-04").state is UploadState.RECEIVED
    assert len(place.list_received("2026-04")) == 4


def test_an_upload_that_fails_is_tried_again_after_longer_and_longer_times(
    place: MadePlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[float] = []

    def fail(_: UploadSource) -> None:
        tried.append(place.clock.boot_s / 60)
        raise OSError(errno.EIO, "Input/output error")

    patch_reading(monkeypatch, fail)
    place.run_until_quiet()
    news = [place.run_pass().news for _ in range(20)]
    minutes = [round(later - before) for before, later in pairwise(tried)]
    assert minutes == [5, 10, 20, 40]
    assert not any(news)  # it is told once


def test_a_source_that_is_not_there_stops_no_other(place: MadePlace) -> None:
    place.run_until_quiet()
    (place.root / "uploads" / "mill").rename(place.root / "unmounted")
    report = place.run_pass()
    (problem,) = report.problems
    assert report.new_problems == report.problems and place.run_pass().new_problems == ()
    assert problem.problem.startswith(
        f"the source {place.root / 'uploads' / 'mill'} cannot be read: create it, or correct 'intake: source' in the "
        "portfolio; is its disk or share mounted?"
    )
    assert get_upload(report, "2026-04").state is UploadState.RECEIVED and get_upload(report, "2026-04").in_source
    (place.root / "unmounted").rename(place.root / "uploads" / "mill")
    assert place.run_pass().problems == ()


def test_a_folder_that_may_not_be_listed_stops_no_other_of_its_source(
    place: MadePlace, monkeypatch: pytest.MonkeyPatch
) -> None:
    place.upload_photographs("2026-05", range(20, 22))
    listed = UploadSource.list_upload

    def refuse(self: UploadSource, folder: str) -> tuple[ListedFile, ...]:
        with self.explain_errors():
            if folder == "2026-05":
                raise PermissionError(errno.EACCES, "Permission denied")
        return listed(self, folder)

    with monkeypatch.context() as patched:
        patched.setattr(UploadSource, "list_upload", refuse)
        report = place.run_until_quiet()
    assert get_upload(report, "2026-04").state is UploadState.RECEIVED
    denied = get_upload(report, "2026-05")
    assert denied.state is UploadState.FAILED
    assert denied.reason.endswith("Permission denied; check the disk, and that the service may read the folder")
    assert get_upload(place.run_until_quiet(), "2026-05").state is UploadState.RECEIVED


def test_copies_of_an_upload_that_goes_are_removed(place: MadePlace, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: UploadSource) -> None:
        raise OSError(errno.EIO, "Input/output error")

    patch_reading(monkeypatch, fail)
    receive(place)
    campaigns = place.root / "photographs" / "mill"
    assert [path.name.startswith(".receiving-") for path in campaigns.iterdir()] == [True]
    shutil.rmtree(place.root / "uploads" / "mill" / "2026-04")
    place.run_pass()
    assert list(campaigns.iterdir()) == []


def test_photographs_outside_folders_are_told(place: MadePlace) -> None:
    place.upload("DJI_0099.JPG", photograph(LAT_DEG, LON_DEG, seed=99))
    (problem,) = place.run_pass().problems
    assert problem.problem == (
        f"photographs are in the source {place.root / 'uploads' / 'mill'} itself (1, such as DJI_0099.JPG); put them "
        "into a folder, one for each campaign"
    )


def test_an_upload_without_its_marker_for_days_is_told_once(tmp_path: Path) -> None:
    place = MadePlace(tmp_path, marker="COMPLETE")
    place.upload_photographs("2026-04", range(2))
    place.run_pass()
    report = place.run_pass(minutes=3 * 1440)
    assert get_upload(report, "2026-04").state is UploadState.STALLED
    assert get_upload(report, "2026-04").reason == (
        "its marker 'COMPLETE' is not there, and nothing has changed for 3 days: put a file 'COMPLETE' into it once it "
        "is whole"
    )
    assert len(report.news) == 1 and place.run_pass(minutes=1440).news == ()


def test_an_upload_that_never_stops_changing_is_told(place: MadePlace) -> None:
    states = []
    for hours in range(74):
        place.upload("2026-04/flight.log", b"x" * hours)
        states.append(get_upload(place.run_pass(minutes=60), "2026-04").state)
    assert states[70] is UploadState.GROWING and states[73] is UploadState.STALLED
    upload = get_upload(place.run_pass(minutes=1), "2026-04")
    assert upload.reason == (
        "it has not been without a change for 30 minutes in 3 days: a program goes on writing into it; stop that, or "
        "move the photographs into a new folder"
    )


def test_a_campaign_whose_folder_is_gone_does_not_begin_anew_with_its_late_photographs(place: MadePlace) -> None:
    place.run_until_quiet()
    shutil.rmtree(place.root / "photographs" / "mill" / "2026-04")
    place.upload_photographs("2026-04", range(4, 6))
    upload = get_upload(place.run_until_quiet(), "2026-04")
    assert upload.state is UploadState.FAILED
    assert upload.reason.startswith("more photographs arrived for campaign 2026-04, whose folder ")
    assert upload.reason.endswith("is gone; restore it, or put all its photographs into a new folder of the source")
    assert not (place.root / "photographs" / "mill" / "2026-04").exists()


def test_a_ledger_that_is_damaged(place: MadePlace) -> None:
    ledger = place.root / "lake" / "intake.sqlite"
    ledger.parent.mkdir()
    ledger.write_bytes(b"SQLite format 3\0" + b"\xff" * 200)
    with pytest.raises(StoreError) as caught:
        place.run_pass()
    assert str(caught.value) == (
        f"the intake's ledger sqlite:///{ledger} cannot be read or written (file is not a database); check that the "
        "database answers and the disk has space. Where the ledger is damaged, move it away: uploads are then compared "
        "with the photographs in place, and nothing is received twice"
    )
    ledger.unlink()
    with open_ledger(place.settings).begin() as connection:
        connection.execute(LEDGER.update().values(format=7))
    with pytest.raises(StoreError, match="has format 7, this Facadelake reads 1; move it away"):
        place.run_pass()


@pytest.fixture
def object_store() -> fs.FileSystem:
    """A store of objects in memory, which has prefixes and no folders."""
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]
    return fs.PyFileSystem(fs.FSSpecHandler(memory))


def test_an_object_store_is_received_by_the_same_code(tmp_path: Path, object_store: fs.FileSystem) -> None:
    place = MadePlace(tmp_path)
    (tmp_path / "photographs").mkdir()
    for name in ("2026-04/DCIM/1.JPG", "2026-04/2.JPG", "2026-04/.DS_Store"):
        memory = fsspec.filesystem("memory")
        memory.makedirs(f"/bucket/mill/{name.rpartition('/')[0]}", exist_ok=True)
        with memory.open(f"/bucket/mill/{name}", "wb") as file:
            file.write(photograph(LAT_DEG, LON_DEG, seed=len(name)))

    def open_location(location: str) -> UploadSource:
        assert location.endswith("mill")
        return UploadSource(location="s3://bucket/mill", filesystem=object_store, root="/bucket/mill")

    def run_pass(minutes: float) -> IntakeReport:
        place.clock.advance(minutes=minutes)
        return receive_complete_uploads([place.get_building()], place.settings, place.clock, open_location)

    run_pass(5)
    upload = get_upload(run_pass(30), "2026-04")
    assert (upload.state, upload.source) == (UploadState.RECEIVED, "s3://bucket/mill"), upload.reason
    assert place.list_received("2026-04") == ["2.JPG", "DCIM/1.JPG"]


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            "When getting information for key: AWS Error ACCESS_DENIED during HeadObject operation: No response body.",
            "the source s3://bucket/mill cannot be read: "
            "its credentials are refused or have expired; renew AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and "
            "AWS_SESSION_TOKEN in the environment of the service, which may list and read the bucket",
        ),
        (
            "AWS Error NETWORK_CONNECTION during ListObjectsV2 operation: curlCode: 7, Couldn't connect to server",
            "the source s3://bucket/mill cannot be read: "
            "it did not answer, or not in full; check the network, AWS_ENDPOINT_URL and AWS_REGION",
        ),
        (
            "Path does not exist 'bucket/mill'",
            "the source s3://bucket/mill cannot be read: "
            "there is no such bucket or prefix; correct 'intake: source' in the portfolio",
        ),
    ],
)
def test_errors_of_an_object_store_have_a_remedy(object_store: fs.FileSystem, error: str, message: str) -> None:
    source = UploadSource(location="s3://bucket/mill", filesystem=object_store, root="bucket/mill")
    with pytest.raises(StoreError) as caught, source.explain_errors():
        raise OSError(error)
    assert str(caught.value) == f"{message} ({error})"


def test_an_object_store_takes_endpoint_and_region_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr(fs, "S3FileSystem", lambda **options: given.update(options))
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:7070/")
    monkeypatch.delenv("AWS_REGION", raising=False)
    monkeypatch.delenv("AWS_DEFAULT_REGION", raising=False)
    assert open_source("s3://photos/mill/").root == "photos/mill"
    assert (given["scheme"], given["endpoint_override"], given["region"]) == ("http", "127.0.0.1:7070", "us-east-1")
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    monkeypatch.setenv("AWS_REGION", "eu-central-1")
    given.clear()
    open_source("s3://photos/mill")
    assert given == {"region": "eu-central-1", "connect_timeout": 10, "request_timeout": 60}
