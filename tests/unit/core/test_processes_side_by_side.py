"""Workers side by side: how each ended, its messages and progress, and that none is left."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import psutil
import pytest

from facadelake.core.processes.side_by_side import EndedProcess, ProcessesSideBySide
from facadelake.core.progress import listen_to_progress

WORKER = """
import json, logging, os, signal, subprocess, sys, time
from pathlib import Path
from facadelake.core.processes.worker import EventStream, read_job
events = EventStream.take_standard_output()
job = read_job(Path(sys.argv[1]))
events.begin_step("work", 2)
events.advance()
events.log(f"hello from {job['does']}", logger="facadelake.tasks", level=logging.INFO)
print("chatter of a library", flush=True)
match job["does"]:
    case "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    case "exit":
        sys.exit(3)
    case "stay":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
        time.sleep(60)
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "worker_of_test.py").write_text(textwrap.dedent(WORKER))
    monkeypatch.syspath_prepend(str(tmp_path))
    return "worker_of_test"


class Progress:
    """Remembers labels of steps that began, and how many are open."""

    def __init__(self) -> None:
        self.labels: list[str] = []
        self.open = 0

    def begin(self, label: str, total: int | None) -> int:
        self.labels.append(label)
        self.open += 1
        return 0

    def advance(self, handle: int, steps: int) -> None:
        pass

    def end(self, handle: int) -> None:
        self.open -= 1


def test_each_end_is_told_and_one_crash_stops_no_other(
    module: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    progress = Progress()
    ended: dict[str, EndedProcess] = {}
    with (
        caplog.at_level(logging.INFO, "facadelake.tasks"),
        listen_to_progress(progress),
        ProcessesSideBySide() as processes,
    ):
        for does in ("good", "crash", "exit"):
            processes.start(does, module, {"does": does}, tmp_path / does, environment=os.environ)
        while processes.list_running():
            ended.update({one.name: one for one in processes.wait(30)})
    assert {name: one.problem for name, one in ended.items()} == {
        "good": "",
        "crash": "was killed by signal SIGSEGV",
        "exit": "exited with status 3",
    }
    assert {name: one.killed for name, one in ended.items()} == {"good": False, "crash": True, "exit": False}
    assert {"good", "good: work"} <= set(progress.labels) and progress.open == 0
    assert {"hello from good", "hello from crash"} <= set(caplog.messages)
    assert "chatter" in (tmp_path / "good" / "worker.log").read_text()


def test_workers_that_ignore_an_end_are_killed_within_five_seconds(module: str, tmp_path: Path) -> None:
    begin = time.monotonic()
    with ProcessesSideBySide(grace_s=1) as processes:
        processes.start("stay", module, {"does": "stay"}, tmp_path / "stay", environment=os.environ)
        while not _find_children():
            assert not processes.wait(0.2)
            assert time.monotonic() - begin < 30
        (worker,) = _find_children()
        (grandchild,) = worker.children()
        begin = time.monotonic()
    assert time.monotonic() - begin < 5
    assert not worker.is_running()
    while grandchild.is_running() and grandchild.status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() - begin < 10


def _find_children() -> list[psutil.Process]:
    """Workers of this process that have started their child."""
    return [one for one in psutil.Process().children() if "worker_of_test" in one.cmdline() and one.children()]


def test_a_worker_ends_with_the_process_that_started_it(module: str, tmp_path: Path) -> None:
    script = (
        "import sys, time; from pathlib import Path\n"
        "from facadelake.core.processes.side_by_side import ProcessesSideBySide\n"
        "with ProcessesSideBySide() as processes:\n"
        f"    folder = Path({str(tmp_path / 'orphan')!r})\n"
        f"    processes.start('stay', {module!r}, {{'does': 'stay'}}, folder, environment=os.environ)\n"
        "    print(psutil.Process().children()[0].pid, flush=True); processes.wait(60)\n"
    ).replace("import sys", "import os, psutil, sys")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)])}
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment) as parent:
        assert parent.stdout is not None
        worker = psutil.Process(int(parent.stdout.readline()))
        log = tmp_path / "orphan" / "worker.log"
        begin = time.monotonic()
        while "chatter" not in log.read_text() and time.monotonic() - begin < 30:
            time.sleep(0.1)
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    worker.wait(5)
