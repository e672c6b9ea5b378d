"""A place that takes no file is told in a line, before any work."""

import sys
from pathlib import Path

import pytest

from cli.main import main


def test_a_folder_that_cannot_be_made_is_told_without_a_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    data = tmp_path / "labels"
    data.mkdir()
    monkeypatch.setattr(sys, "argv", ["facadelake", "evaluate-detector", "--data", str(data), "--plots", str(taken)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    told = capsys.readouterr().err
    assert "File exists" in told and str(taken) in told.replace("\n", "")
    assert "Traceback" not in told


def test_a_fault_of_ours_still_shows_where(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise FileNotFoundError(2, "No such file or directory", "x")

    monkeypatch.setattr("cli.main.app", fail)
    with pytest.raises(FileNotFoundError):
        main()
