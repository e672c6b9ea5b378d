"""Start the worker process, hand on its progress, and turn its end into a result or a clear error."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from facadelake.core.cache import DIAGNOSTICS
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.progress import ProgressStep, report_progress

logger = logging.getLogger(__name__)

LOG_NAME = "worker.log"
_LOG_TAIL_LINES = 12


def run_worker(job: Mapping[str, Any], folder: Path) -> None:
    """Run ``job`` in a process of its own; results are in ``folder``, its log in ``diagnostics/worker.log`` there.

    Progress lines become progress bars. An interrupt (Ctrl-C) ends the worker too, and the worker ends when this
    process dies. Raises InputDataError for what the worker found wrong with the photographs, FacadelakeError, with
    the log's end, where the worker crashed or was killed.
    """
    diagnostics = folder / DIAGNOSTICS
    diagnostics.mkdir(parents=True, exist_ok=True)
    job_path, log_path = diagnostics / "job.json", diagnostics / LOG_NAME
    job_path.write_text(json.dumps({**job, "folder": str(folder), "parent": os.getpid()}), encoding="utf-8")
    with log_path.open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "facadelake.sfm.worker", str(job_path)],
            stdout=subprocess.PIPE,
            stderr=log,
            stdin=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            start_new_session=True,  # Ctrl-C reaches this process alone, which then ends the worker in order
        )
        problem = ""
        try:
            problem = _follow(process)
            code = process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
    if problem:
        raise InputDataError(problem)
    if code != 0:
        raise FacadelakeError(_describe_crash(code, log_path))


def _follow(process: subprocess.Popen[bytes]) -> str:
    """Hand on events until the worker closes its output; returns what it found wrong with the input, else empty."""
    assert process.stdout is not None  # asked for above
    problem = ""
    with ExitStack() as bars:
        step: ProgressStep | None = None
        for event in _read_events(process.stdout):
            match event.get("event"):
                case "begin":
                    bars.close()
                    step = bars.enter_context(report_progress(str(event["label"]), event["total"]))
                case "advance" if step is not None:
                    step.advance(int(event["steps"]))
                case "note":
                    logger.info("%s", event["text"])
                case "refused":
                    problem = str(event["text"])
    return problem


def _read_events(stream: Iterator[bytes]) -> Iterator[dict[str, Any]]:
    for line in stream:
        try:
            event = json.loads(line)
        except ValueError:
            continue  # the worker sends foreign chatter to the log; whatever slips through is not ours
        if isinstance(event, dict):
            yield event


def _describe_crash(code: int, log_path: Path) -> str:
    if code < 0:
        cause = f"was ended by signal {signal.Signals(-code).name}"
        if -code == signal.SIGKILL:
            cause += " (often: the machine ran out of memory; reduce max_image_px or max_features)"
    else:
        cause = f"ended with status {code}"
    tail = log_path.read_text(encoding="utf-8", errors="replace").splitlines()[-_LOG_TAIL_LINES:]
    return "\n".join([f"the reconstruction process {cause}; a new run goes on where it stopped. Its log's end:", *tail])
