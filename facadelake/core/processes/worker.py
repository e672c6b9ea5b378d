"""What a worker process tells its parent, and that it ends with it."""

from __future__ import annotations

import ctypes
import json
import logging
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TextIO

from facadelake.core.errors import FacadelakeError

_PR_SET_PDEATHSIG = 1


def read_job(job_path: Path) -> dict[str, Any]:
    """Read the job in the worker, which from then on ends with its parent."""
    job: dict[str, Any] = json.loads(job_path.read_text(encoding="utf-8"))
    end_with_parent(job["parent"])
    return job


def end_with_parent(parent: int) -> None:
    """Ask the kernel (Linux) to end this process when its parent dies: an orphan would hold gigabytes."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit("the parent process has ended")


@dataclass(frozen=True, kw_only=True)
class EventStream:
    """The worker's events to its parent."""

    stream: TextIO

    @classmethod
    def take_standard_output(cls) -> Self:
        """Use standard output for events; all other output to it is redirected to the log (stderr)."""
        sys.stdout.flush()
        events = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
        os.dup2(2, 1)
        return cls(stream=events)

    def begin_step(self, label: str, total: int | None) -> None:
        """A step of ``total`` units of work begins, and ends the one before."""
        self._send(event="begin", label=label, total=total)

    def advance(self, steps: int = 1) -> None:
        """``steps`` more units of the current step are done."""
        self._send(event="advance", steps=steps)

    def log(self, text: str, *, logger: str, level: int = logging.INFO) -> None:
        """A message for the log of the parent."""
        self._send(event="note", text=text, logger=logger, level=level)

    def refuse(self, error: FacadelakeError) -> None:
        """The input cannot be used, for the reason that ``error`` gives."""
        self._send(event="refused", kind=type(error).__name__, text=str(error))

    def _send(self, **event: Any) -> None:
        """Write one event."""
        self.stream.write(json.dumps(event) + "\n")


class ProgressForwarder:
    """A progress listener that sends what it receives to the parent."""

    def __init__(self, events: EventStream) -> None:
        self._events = events

    def begin(self, label: str, total: int | None) -> int:
        """An operation begins; it ends with the next one, or with the process."""
        self._events.begin_step(label, total)
        return 0

    def advance(self, handle: int, steps: int) -> None:
        """``steps`` more steps are completed."""
        self._events.advance(steps)

    def end(self, handle: int) -> None:
        """The parent ends the operation."""


class NoteHandler(logging.Handler):
    """Sends log records to the parent."""

    def __init__(self, events: EventStream) -> None:
        super().__init__(logging.INFO)
        self._events = events

    def emit(self, record: logging.LogRecord) -> None:
        """Send one record."""
        self._events.log(record.getMessage(), logger=record.name, level=record.levelno)
