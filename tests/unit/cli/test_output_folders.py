"""A command that writes files into a folder looks at it before its work."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.main import app
from cli.options import require_output_folder
from facadelake.core.errors import InputDataError
from tests.unit.lake.small_campaign import BUILDING, commit

REMEDY = "but several files are written into a folder: name another one, or move the file away"


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["compare", BUILDING], "--output"),
        (["why", f"{BUILDING}-0001"], "--pictures"),
        (["pictures", "demo"], "--output"),
        (["evaluate", "demo", "2026-04", "--truth", "t"], "--plots"),
        (["evaluate", "demo", "--history", "--truth", "t"], "--plots"),
        (["evaluate-detector"], "--plots"),
        (["compare-models", "default", "new.onnx", "--campaign", "demo/2026-04"], "--output"),
        (["review", "export-task", "demo", "2026-04"], "FOLDER"),
    ],
)
def test_a_file_where_a_folder_is_to_be_written_ends_the_command_at_once(
    tmp_path: Path, command: list[str], option: str
) -> None:
    commit(tmp_path / "lake", defects=1)  # one campaign, which nothing can be compared with: later, another error
    page = tmp_path / "page.html"
    page.write_text("kept")
    given = [option, str(page)] if option.startswith("-") else [str(page)]
    lake = [] if command[0] == "evaluate-detector" else ["--lake", str(tmp_path / "lake")]
    found = CliRunner().invoke(app, [*command, *given, *lake])
    assert str(found.exception) == f"{option} {page} is a file, {REMEDY}"
    assert isinstance(found.exception, InputDataError)
    assert found.output == ""
    assert page.read_text() == "kept"


def test_a_file_on_the_way_to_a_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("")
    with pytest.raises(InputDataError) as raised:
        require_output_folder(tmp_path / "a" / "b" / "c", "--output")
    assert str(raised.value) == (
        f"--output {tmp_path}/a/b/c cannot be created, since {tmp_path}/a is a file, but several files are written "
        "into a folder: name another one, or move the file away"
    )


def test_a_folder_that_may_not_be_changed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputDataError) as raised:
        require_output_folder(tmp_path / "b", "--output")
    assert str(raised.value) == (
        f"--output {tmp_path}/b cannot be written: {tmp_path} may not be changed by this user; name another folder, or "
        "change its rights"
    )


def test_a_folder_that_is_there_or_can_be_made_will_do(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "new" / "folder", None):
        require_output_folder(folder, "--output")
    assert not (tmp_path / "new").exists()
