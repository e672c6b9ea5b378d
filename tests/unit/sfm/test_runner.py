"""The worker process: its progress, its refusals and its end, seen from the parent."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from facadelake.core.cache import DIAGNOSTICS
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.processes import parent as process_parent
from facadelake.core.progress import listen_to_progress
from facadelake.sfm import worker_process as runner

SCRIPT = """
import json, os, signal, sys
job = json.loads(open(sys.argv[1]).read())
print("chatter of a library")
for event in job["events"]:
    print(json.dumps(event), flush=True)
print("last words", file=sys.stderr, flush=True)
if job["end"] == "kill":
    os.kill(os.getpid(), signal.SIGKILL)
sys.exit(job["end"])
"""


class ProgressRecorder:
    """A listener that records what it receives."""

    def __init__(self) -> None:
        self.received: list[tuple[str, object]] = []

    def begin(self, label: str, total: int | None) -> int:
        self.received.append((label, total))
        return len(self.received)

    def advance(self, handle: int, steps: int) -> None:
        self.received.append(("advance", steps))

    def end(self, handle: int) -> None:
        self.received.append(("end", handle))


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Workers run SCRIPT instead of pycolmap."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    real = subprocess.Popen
    monkeypatch.setattr(
        process_parent.subprocess,
        "Popen",
        lambda command, **how: real([sys.executable, str(script), command[-1]], **how),
    )


EVENTS = [
    {"event": "begin", "label": "Extracting features", "total": 4},
    {"event": "advance", "steps": 4},
    {"event": "begin", "label": "Matching features", "total": 9},
    {"event": "advance", "steps": 2},
]
REFUSED = {"event": "refused", "kind": "InputDataError", "text": "no overlap"}


@pytest.mark.usefixtures("scripted")
def test_progress_reaches_the_listener_and_bars_end(tmp_path: Path) -> None:
    recorder = ProgressRecorder()
    with listen_to_progress(recorder):
        runner.run_worker({"events": EVENTS, "end": 0}, tmp_path / "out")
    assert recorder.received == [
        ("Extracting features", 4), ("advance", 4), ("end", 1), ("Matching features", 9), ("advance", 2), ("end", 4),
    ]  # fmt: skip
    assert "last words" in process_parent.get_log_path(tmp_path / "out" / DIAGNOSTICS).read_text()


@pytest.mark.usefixtures("scripted")
@pytest.mark.parametrize(
    ("job", "kind", "message"),
    [
        (
            {"events": [{"event": "refused", "kind": "InputDataError", "text": "no overlap"}], "end": 2},
            InputDataError,
            "^no overlap$",
        ),
        ({"events": [], "end": 3}, FacadelakeError, r"exited with status 3; .*\n.*last words"),
        ({"events": [], "end": "kill"}, FacadelakeError, r"signal SIGKILL .*out of memory.*\n.*last words"),
    ],
)
def test_the_end_of_a_worker_is_reported(
    tmp_path: Path, job: dict[str, object], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message):
        runner.run_worker(job, tmp_path / "out")


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] not in ("Z", "X")
    except OSError:
        return False


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_the_worker_ends_with_its_parent(tmp_path: Path, end: signal.Signals) -> None:
    """A parent whose worker is at work is killed, or interrupted: the worker must go too."""
    folder = tmp_path / "out"
    folder.mkdir()
    waiting = tmp_path / "parent.py"
    # The worker is the real one; only its work is replaced by a long sleep, after it has asked the kernel.
    waiting.write_text(
        "import sys, pathlib, subprocess\n"
        "from facadelake.sfm import worker_process as runner\n"
        "from facadelake.core.processes import parent as process_parent\n"
        "real = subprocess.Popen\n"
        "code = ('import sys,time,os,facadelake.core.processes.worker as m; m.end_with_parent(int(sys.argv[1]));'\n"
        "        'print(os.getpid(), file=open(sys.argv[2],\"w\")); time.sleep(60)')\n"
        "process_parent.subprocess.Popen = lambda c, **k: real([sys.executable, '-c', code, "
        "str(__import__('os').getpid()), sys.argv[2]], **k)\n"
        "runner.run_worker({}, pathlib.Path(sys.argv[1]))\n"
    )
    pid_file = tmp_path / "pid"
    parent = subprocess.Popen(
        [sys.executable, str(waiting), str(folder), str(pid_file)], stderr=subprocess.DEVNULL, cwd=Path.cwd()
    )
    for _ in range(600):
        if pid_file.exists() and pid_file.read_text().strip():
            break
        time.sleep(0.05)
    worker = int(pid_file.read_text())
    assert _alive(worker)
    parent.send_signal(end)
    parent.wait(timeout=20)
    deadline = time.monotonic() + 10
    while _alive(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _alive(worker)
