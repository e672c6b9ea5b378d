"""The doctor finds what is missing, names the remedy, and is not stopped by a probe that crashes."""

import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from facadelake import doctor
from facadelake.core.cache import DIAGNOSTICS, WORK_SIZE_FILE, open_stage_cache
from facadelake.core.system_libraries import Library
from facadelake.detection.model_registry import find_default_model
from facadelake.doctor import DISK_RESERVE, Check, Probe, Status, run_checks
from facadelake.lake.recorded_stage_keys import RunKeys


def probe(code: str) -> Check:
    return doctor.check_probe(Probe(name="probe", code=code, remedy="mend it"))


def test_this_machine_is_ready_once_set_up(tmp_path: Path) -> None:
    checks = run_checks(tmp_path / "lake" / "not-yet", [])
    lacking = [f"{check.name}: {check.found}" for check in checks if check.status is Status.MISSING]
    assert lacking == []
    names = [check.name for check in checks]
    assert len(names) == len(set(names))
    assert {"Python", "DuckDB extensions", "pycolmap", "Open3D", "disk space for the next campaign"} <= set(names)
    assert not (tmp_path / "lake").exists()


def test_missing_library_names_its_package() -> None:
    library = Library(file="libno-such-thing.so.9", package="libno-such-thing9", needed_by="a test")
    check = doctor.check_library(library)
    assert check.status is Status.MISSING
    assert "needed by a test" in check.found
    assert check.remedy.endswith("apt-get install -y --no-install-recommends libno-such-thing9")


def test_broken_egl_driver_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/dev/null")
    render = next(each for each in doctor.PROBES if "EGL" in each.name)
    check = doctor.check_probe(render)
    assert check.status is Status.MISSING
    assert "libegl-mesa0" in check.remedy


def test_probe_reports_its_last_line() -> None:
    check = probe("print('chatter'); print('version 7')")
    assert (check.status, check.found, check.remedy) == (Status.OK, "version 7", "")


def test_probe_that_raises_reports_the_error() -> None:
    check = probe("raise ImportError('libx.so.1: cannot open shared object file')")
    assert check.status is Status.MISSING
    assert check.found == "ImportError: libx.so.1: cannot open shared object file"
    assert check.remedy == "mend it"


def test_probe_that_crashes_is_a_line_of_the_report() -> None:
    check = probe("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    assert check.status is Status.MISSING
    assert check.found == "the process ended with status -11"


def test_probe_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "PROBE_LIMIT_S", 0.5)
    assert probe("import time; time.sleep(60)").found.startswith("no result within")


def test_little_disk_is_a_warning_with_the_figure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(doctor, "DISK_NEEDED_GIB", 10_000_000.0)
    check = doctor.check_disk(tmp_path)
    assert check.status is Status.WARNING
    assert "GiB free" in check.found
    assert "--lake" in check.remedy


def test_the_next_campaign_needs_what_the_largest_one_took(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of 1 and 3 MB; the larger one had a temporary folder of 5 MB and pictures of 2 MB, kept and published."""

    def fill(size: int, work_bytes: int = 0) -> Callable[[Path], None]:
        def make(folder: Path) -> None:
            (folder / "a").write_bytes(b"x" * size)
            (folder / DIAGNOSTICS).mkdir()
            (folder / DIAGNOSTICS / WORK_SIZE_FILE).write_text(str(work_bytes))

        return make

    cache = open_stage_cache(tmp_path)
    cache.get_or_make("reconstruct", "small", fill(1_000_000))
    cache.get_or_make("reconstruct", "large", fill(3_000_000, work_bytes=5_000_000))
    cache.get_or_make("draw", "pictures", fill(2_000_000))
    runs = [
        RunKeys(building_id="tower", campaign_id=campaign, run_id=campaign, version=2, keys={"reconstruct": key})
        for campaign, key in (("2026-04", "small"), ("2026-10", "large"))
    ]
    monkeypatch.setattr(doctor, "read_stage_keys", lambda lake: tuple(runs))
    largest = doctor.find_largest_campaign(tmp_path)
    assert largest is not None and largest.name == "tower 2026-10"
    assert abs(largest.size_bytes - 12_000_000) < 5_000  # bytes: manifests are a little more
    assert doctor.check_disk(tmp_path).status is Status.OK
    free_bytes = int(DISK_RESERVE * 12_000_000) - 10_000
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free_bytes))
    check = doctor.check_disk(tmp_path)
    assert check.status is Status.WARNING and "tower 2026-10 took" in check.found
    assert "facadelake cache prune" in check.remedy


def test_a_cache_without_a_committed_run_says_nothing_of_sizes(tmp_path: Path) -> None:
    assert doctor.find_largest_campaign(tmp_path) is None


def test_folder_that_takes_no_file() -> None:
    check = doctor.check_writable(Path("/proc/lake"))  # not even root can make a file in /proc
    assert check.status is Status.MISSING
    assert check.found.startswith("/proc: ")
    assert "--lake" in check.remedy


def test_model_files(tmp_path: Path) -> None:
    absent, empty, there = tmp_path / "absent.onnx", tmp_path / "empty.onnx", tmp_path / "there.onnx"
    empty.touch()
    there.write_bytes(b"x" * 3_500_000)
    _, *checks = doctor.check_models([absent, empty, there])
    assert [check.status for check in checks] == [Status.MISSING, Status.MISSING, Status.OK]
    assert str(absent) in checks[0].found
    assert "is empty" in checks[1].found
    assert checks[2].found.endswith("3.5 MB")
    assert "portfolio" in checks[0].remedy


def test_a_missing_default_detector_is_a_warning_with_its_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> Path:
        return find_default_model(tmp_path)

    monkeypatch.setattr(doctor, "find_default_model", missing)
    (check,) = doctor.check_models([])
    assert (check.name, check.status) == ("default detector", Status.WARNING)
    assert check.found.endswith("facadelake-nano.onnx does not exist")
    assert "name a model's file in the portfolio" in check.remedy
    (tmp_path / "facadelake-nano.onnx").write_bytes(b"x" * 3_500_000)
    (check,) = doctor.check_models([])
    assert (check.status, check.found.endswith("3.5 MB")) == (Status.OK, True)
