"""A process is told from a later one of the same number, and from one of another machine."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from facadelake.core.processes.identity import ProcessIdentity


def test_a_process_runs_until_it_has_ended(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    identity = ProcessIdentity.from_pid(process.pid)
    identity.write(tmp_path / "notes" / "one.json")
    held = ProcessIdentity.read(tmp_path / "notes" / "one.json")
    assert held == identity and held.is_running() and held != ProcessIdentity.from_this_process()
    process.kill()
    while identity.is_running():  # also while nobody has waited for it, as a zombie
        pass
    process.wait()
    assert not identity.is_running()
    with pytest.raises(ProcessLookupError):
        ProcessIdentity.from_pid(process.pid)


def test_a_number_that_is_used_again_is_another_process() -> None:
    own = ProcessIdentity.from_this_process()
    assert own.is_running()
    assert not replace(own, start_ticks=own.start_ticks - 1).is_running()
    assert not replace(own, boot_id="another boot").is_running()


def test_a_process_of_another_machine_cannot_be_told() -> None:
    with pytest.raises(ValueError, match="only that machine"):
        replace(ProcessIdentity.from_this_process(), host="elsewhere").is_running()


@pytest.mark.parametrize("content", [None, "", "{", "[]", '{"pid": 1}'])
def test_a_note_that_is_not_whole_is_none(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "note.json"
    if content is not None:
        path.write_text(content)
    assert ProcessIdentity.read(path) is None
