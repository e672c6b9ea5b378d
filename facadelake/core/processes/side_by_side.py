"""Worker processes side by side: started, followed and ended by one thread, which waits for whichever ends first.

The workers are those of ``parent.run_worker_process``: a module run as ``python -m MODULE JOB.json`` that writes events
to its standard output and ends with the thread that started it.
"""

from __future__ import annotations

import json
import logging
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from facadelake.core.progress import ProgressStep, report_progress

_CHUNK_BYTES = 65_536


@dataclass(frozen=True, kw_only=True)
class EndedProcess:
    """A worker that has ended: its name, "" or how it ended otherwise, its peak memory (children included) and time."""

    name: str
    problem: str
    killed: bool
    peak_mib: float
    seconds: float


@dataclass(kw_only=True)
class _Running:
    name: str
    process: subprocess.Popen[bytes]
    started_s: float
    bars: ExitStack = field(default_factory=ExitStack)
    step: ProgressStep | None = None
    pending: bytes = b""
    peak_mib: float = 0.0


class ProcessesSideBySide:
    """Context manager of worker processes; those that still run at its end are ended."""

    def __init__(self, grace_s: float = 3.0) -> None:
        self._grace_s = grace_s
        self._running: dict[str, _Running] = {}
        self._selector = selectors.DefaultSelector()

    def __enter__(self) -> ProcessesSideBySide:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end(list(self._running))
        self._selector.close()

    def list_running(self) -> list[str]:
        """Names of the workers that run."""
        return list(self._running)

    def start(
        self, name: str, module: str, job: Mapping[str, Any], folder: Path, *, environment: Mapping[str, str]
    ) -> None:
        """Start a worker.

        Args:
            name: of the worker, also in progress bars.
            module: dotted name of its module.
            job: values that JSON can represent; "parent" is added.
            folder: folder for the job and the worker's log, ``worker.log``.
            environment: variables of the worker, but PYTHONPATH, which is that of this process.
        """
        folder.mkdir(parents=True, exist_ok=True)
        job_path = folder / "job.json"
        job_path.write_text(json.dumps({**job, "parent": os.getpid()}), encoding="utf-8")
        with (folder / "worker.log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", module, str(job_path)],
                stdout=subprocess.PIPE,
                stderr=log,
                stdin=subprocess.DEVNULL,
                env=dict(environment) | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
                start_new_session=True,  # Ctrl-C reaches this process alone, which then ends the workers
            )
        one = _Running(name=name, process=process, started_s=time.monotonic())
        assert process.stdout is not None  # a pipe, as requested above
        os.set_blocking(process.stdout.fileno(), False)
        self._selector.register(process.stdout, selectors.EVENT_READ, one)
        self._running[name] = one
        one.step = one.bars.enter_context(report_progress(name, None))

    def wait(self, timeout_s: float) -> list[EndedProcess]:
        """Follow the workers until one ends or the time is over; those that have ended."""
        deadline = time.monotonic() + timeout_s
        while True:
            for key, _ in self._selector.select(min(1.0, max(0.0, deadline - time.monotonic()))):
                _forward_events(key.data)
            ended = []
            for one in list(self._running.values()):
                one.peak_mib = max(one.peak_mib, _measure_memory_mib(one.process.pid))
                if one.process.poll() is not None:
                    ended.append(self._close(one))
            if ended or time.monotonic() >= deadline or not self._running:
                return ended

    def end(self, names: list[str]) -> list[EndedProcess]:
        """End workers: SIGTERM, and SIGKILL for those that have not ended after the grace time."""
        ending = [self._running[name] for name in names if name in self._running]
        for one in ending:
            one.process.terminate()
        deadline = time.monotonic() + self._grace_s
        for one in ending:
            try:
                one.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                one.process.kill()
                one.process.wait()
        return [self._close(one) for one in ending]

    def _close(self, one: _Running) -> EndedProcess:
        _forward_events(one)
        stdout = one.process.stdout
        assert stdout is not None
        self._selector.unregister(stdout)
        stdout.close()
        one.bars.close()
        del self._running[one.name]
        with suppress(ProcessLookupError):  # what it has started and left
            os.killpg(one.process.pid, signal.SIGKILL)
        code = one.process.returncode
        problem = f"was killed by signal {signal.Signals(-code).name}" if code < 0 else f"exited with status {code}"
        return EndedProcess(
            name=one.name,
            problem=problem if code else "",
            killed=code < 0,
            peak_mib=one.peak_mib,
            seconds=time.monotonic() - one.started_s,
        )


def _forward_events(one: _Running) -> None:
    """Progress and messages that a worker has written since."""
    assert one.process.stdout is not None
    while chunk := _read(one.process.stdout.fileno()):
        *lines, one.pending = (one.pending + chunk).split(b"\n")
        for line in lines:
            try:
                event = json.loads(line)
            except ValueError:
                continue  # output of a library
            if isinstance(event, dict):
                _forward_event(one, event)


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, _CHUNK_BYTES)
    except BlockingIOError:
        return b""


def _forward_event(one: _Running, event: Mapping[str, Any]) -> None:
    match event.get("event"):
        case "begin":
            one.bars.close()
            one.step = one.bars.enter_context(report_progress(f"{one.name}: {event['label']}", event["total"]))
        case "advance" if one.step is not None:
            one.step.advance(int(event["steps"]))
        case "note":
            logging.getLogger(str(event["logger"])).log(int(event["level"]), "%s", event["text"])


def _measure_memory_mib(pid: int) -> float:
    """Resident memory of a process with its children."""
    total = 0
    try:
        process = psutil.Process(pid)
        for each in [process, *process.children(recursive=True)]:
            try:
                total += each.memory_info().rss
            except psutil.Error:
                continue  # it has ended
    except psutil.Error:
        return 0.0
    return total / 2**20
