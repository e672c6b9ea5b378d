"""The ledger in PostgreSQL: the same states, one process at a time, and a database that goes."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from facadelake.core.errors import StoreError
from facadelake.intake import IntakeBusyError, UploadState, receive_complete_uploads
from facadelake.intake.ledger import open_ledger
from facadelake.registry import ServiceSettings
from tests.unit.intake.made_uploads import MadePlace, get_upload

PROGRAMS = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))


@dataclass(frozen=True)
class MadeDatabase:
    """A database of its own, and what stops it."""

    url: str
    command: tuple[str, ...]
    run_as: dict[str, int]

    def control(self, *arguments: str) -> None:
        subprocess.run([*self.command, *arguments], check=True, capture_output=True, timeout=60, **self.run_as)  # type: ignore[call-overload]


@pytest.fixture
def database() -> Iterator[MadeDatabase]:
    """A PostgreSQL server on a free port; it does not run as root, who alone may enter the folders of the tests."""
    if not PROGRAMS:
        pytest.skip("PostgreSQL is not installed (apt-get install postgresql)")
    run_as: dict[str, int] = {}
    home = Path(tempfile.mkdtemp(prefix="facadelake-postgresql-"))
    if os.getuid() == 0:
        try:
            owner = pwd.getpwnam("postgres")
        except KeyError:
            pytest.skip("PostgreSQL does not run as root, and there is no user 'postgres'")
        run_as = {"user": owner.pw_uid, "group": owner.pw_gid}
        os.chown(home, owner.pw_uid, owner.pw_gid)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    bin_folder = PROGRAMS[-1].parent
    initialise = [bin_folder / "initdb", "-D", home / "data", "-A", "trust", "-U", "facadelake", "--no-sync"]
    subprocess.run(initialise, check=True, capture_output=True, timeout=120, **run_as)  # type: ignore[call-overload]
    options = f"-p {port} -k {home} -c listen_addresses=127.0.0.1 -c fsync=off"
    command = (str(bin_folder / "pg_ctl"), "-D", str(home / "data"), "-l", str(home / "log"), "-o", options, "-w")
    made = MadeDatabase(f"postgresql://facadelake@127.0.0.1:{port}/postgres", command, run_as)
    made.control("start")
    yield made
    subprocess.run([*command, "-m", "immediate", "stop"], check=False, capture_output=True, **run_as)  # type: ignore[call-overload]
    shutil.rmtree(home, ignore_errors=True)


def test_uploads_are_received_once_and_a_lost_database_is_told(tmp_path: Path, database: MadeDatabase) -> None:
    place = MadePlace(tmp_path)
    settings: ServiceSettings = place.settings.model_copy(update={"database": database.url})

    def run_pass(minutes: float) -> UploadState:
        place.clock.advance(minutes=minutes)
        report = receive_complete_uploads(place.buildings, settings, place.clock)
        return get_upload(report, "2026-04").state

    place.upload_photographs("2026-04", range(3))
    (tmp_path / "uploads" / "tower").mkdir()
    assert run_pass(5) is UploadState.GROWING
    with open_ledger(settings).hold(), pytest.raises(IntakeBusyError):
        run_pass(30)
    database.control("-m", "immediate", "stop")
    with pytest.raises(StoreError) as caught:
        run_pass(5)
    assert "the intake's ledger postgresql+pg8000://facadelake@127.0.0.1" in str(caught.value)
    database.control("start")
    assert run_pass(5) is UploadState.RECEIVED
    place.upload_photographs("2026-04", range(3, 4))
    assert [run_pass(5), run_pass(30), run_pass(5)] == [UploadState.GROWING, UploadState.RECEIVED, UploadState.RECEIVED]
    assert len(place.list_received("2026-04")) == 4
    assert not (tmp_path / "lake" / "intake.sqlite").exists()
