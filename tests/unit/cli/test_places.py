"""A place that takes no file is told in a line, before any work."""

import errno

import pytest

from cli.main import main


def test_a_disk_that_refuses_is_told_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "/lake/cache/photos.parquet")

    monkeypatch.setattr("cli.main.app", fail)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    told = capsys.readouterr().err.replace("\n", "")
    assert "No space left on device: /lake/cache/photos.parquet" in told and "free space" in told
    assert "Traceback" not in told


def test_a_fault_of_ours_still_shows_where(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise FileNotFoundError(2, "No such file or directory", "x")

    monkeypatch.setattr("cli.main.app", fail)
    with pytest.raises(FileNotFoundError):
        main()
