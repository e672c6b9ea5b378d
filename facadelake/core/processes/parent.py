"""Run a worker process and follow its progress, messages, refusals and end."""

from __future__ import annotations

import json
import logging
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from facadelake.core import errors
from facadelake.core.progress import ProgressStep, report_progress

_CHUNK_BYTES = 65_536


class _SilenceError(Exception):
    """The worker sent no event for too long."""


def run_worker_process(module: str, job: Mapping[str, Any], folder: Path, *, silence_max_s: float | None = None) -> str:
    """Run ``job`` by the worker ``module`` and return how it ended: an empty string, or what happened to the process.

    Progress events become progress bars, notes are logged. An interrupt (Ctrl-C) ends the worker too, and the worker
    ends when this process dies.

    Args:
        module: dotted name of the worker's module.
        job: values that JSON can represent; "parent", the process that it ends with, is added.
        folder: folder for the job and the worker's log.
        silence_max_s: the worker is killed when it reports nothing for so long; None: never.

    Returns:
        "", or such as "was killed by signal SIGSEGV", "exited with status 3", "reported no progress for 900 s".

    Raises:
        FacadelakeError: the worker refused the input; the class is that of the worker's error.
    """
    job_path = folder / "job.json"
    job_path.write_text(json.dumps({**job, "parent": os.getpid()}), encoding="utf-8")
    with get_log_path(folder).open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", module, str(job_path)],
            stdout=subprocess.PIPE,
            stderr=log,
            stdin=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            start_new_session=True,  # Ctrl-C reaches this process alone, which then ends the worker
        )
        refusal: errors.FacadelakeError | None = None
        try:
            refusal = _follow(process, silence_max_s)
            code = process.wait()
        except _SilenceError:
            return f"reported no progress for {silence_max_s:g} s and was ended"
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            assert process.stdout is not None  # a pipe, as requested above
            process.stdout.close()
    if refusal is not None:
        raise refusal
    if code < 0:
        return f"was killed by signal {signal.Signals(-code).name}"
    return f"exited with status {code}" if code else ""


def get_log_path(folder: Path) -> Path:
    """The worker's log in the folder of its job."""
    return folder / "worker.log"


def _follow(process: subprocess.Popen[bytes], silence_max_s: float | None) -> errors.FacadelakeError | None:
    """Forward events until the worker closes its output; returns its refusal, if any."""
    refusal: errors.FacadelakeError | None = None
    with ExitStack() as bars:
        step: ProgressStep | None = None
        for event in _read_events(process, silence_max_s):
            match event.get("event"):
                case "begin":
                    bars.close()
                    step = bars.enter_context(report_progress(str(event["label"]), event["total"]))
                case "advance" if step is not None:
                    step.advance(int(event["steps"]))
                case "note":
                    logging.getLogger(str(event["logger"])).log(int(event["level"]), "%s", event["text"])
                case "refused":
                    refusal = getattr(errors, event["kind"])(event["text"])
    return refusal


def _read_events(process: subprocess.Popen[bytes], silence_max_s: float | None) -> Iterator[dict[str, Any]]:
    """The JSON events in the output of the worker; output of libraries is ignored."""
    assert process.stdout is not None  # a pipe, as requested by the caller
    pending = b""
    while True:
        if not select.select([process.stdout], [], [], silence_max_s)[0]:
            raise _SilenceError
        chunk = os.read(process.stdout.fileno(), _CHUNK_BYTES)
        if not chunk:
            return
        *lines, pending = (pending + chunk).split(b"\n")
        for line in lines:
            try:
                event = json.loads(line)
            except ValueError:
                continue
            if isinstance(event, dict):
                yield event
