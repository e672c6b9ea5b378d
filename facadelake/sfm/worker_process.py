"""The worker process: started with a job, followed by its events, resumed from its work folder."""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock

from facadelake.core.cache import DIAGNOSTICS
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.progress import ProgressStep, report_progress

logger = logging.getLogger(__name__)

LOG_NAME = "worker.log"
_LOG_TAIL_LINES = 12
_PREFIX = ".work-"
_REMOVED_SUFFIX = ".removed"
_ABANDONED_AFTER_S = 14 * 86400


def run_worker(job: Mapping[str, Any], folder: Path) -> None:
    """Run ``job`` in a process of its own; results are in ``folder``, its log in ``diagnostics/worker.log`` there.

    Progress events become progress bars. An interrupt (Ctrl-C) ends the worker too, and the worker ends when this
    process dies. Raises InputDataError where the worker refuses the photographs, and FacadelakeError with the end of
    the log where it crashed or was killed.
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
            start_new_session=True,  # Ctrl-C reaches this process alone, which then ends the worker
        )
        refusal = ""
        try:
            refusal = _follow(process)
            code = process.wait()
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
    if refusal:
        raise InputDataError(refusal)
    if code != 0:
        raise FacadelakeError(_describe_crash(code, log_path))


def _follow(process: subprocess.Popen[bytes]) -> str:
    """Forward events until the worker closes its output; returns the reason of a refusal, else an empty string."""
    assert process.stdout is not None  # a pipe, as requested above
    refusal = ""
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
                    refusal = str(event["text"])
    return refusal


def _read_events(stream: Iterator[bytes]) -> Iterator[dict[str, Any]]:
    """The JSON events in the output of the worker."""
    for line in stream:
        try:
            event = json.loads(line)
        except ValueError:
            continue  # output of libraries goes to the log; a line that is no event is ignored
        if isinstance(event, dict):
            yield event


def _describe_crash(code: int, log_path: Path) -> str:
    """Message of an unexpected end of the worker, with the last lines of its log."""
    if code < 0:
        cause = f"was killed by signal {signal.Signals(-code).name}"
        if -code == signal.SIGKILL:
            cause += " (usually the machine ran out of memory; reduce max_image_px or max_features)"
    else:
        cause = f"exited with status {code}"
    tail = log_path.read_text(encoding="utf-8", errors="replace").splitlines()[-_LOG_TAIL_LINES:]
    message = f"the reconstruction process {cause}; a new run resumes where it stopped. End of its log:"
    return "\n".join([message, *tail])


@contextmanager
def open_work_folder(parent: Path, key: str) -> Iterator[Path]:
    """The folder ``parent/.work-<key>``, locked while the block runs.

    It is removed when the block succeeds, and when the input is refused, because the next run would be refused again.
    It stays after a crash or a kill, so that the next run resumes. Folders not used for two weeks are removed.
    """
    parent.mkdir(parents=True, exist_ok=True)
    folder = parent / f"{_PREFIX}{key}"
    with FileLock(parent / f"{_PREFIX}{key}.lock"):
        _remove_abandoned(parent, current=folder)
        if folder.exists():
            logger.info("resuming an interrupted reconstruction of the same photographs")
        folder.mkdir(exist_ok=True)
        folder.touch()
        try:
            yield folder
        except InputDataError:
            _remove(folder)
            raise
        _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a work folder, renamed first so that an interruption leaves no incomplete folder to resume from."""
    removed = folder.with_name(folder.name + _REMOVED_SUFFIX)
    folder.rename(removed)
    shutil.rmtree(removed, ignore_errors=True)


def _remove_abandoned(parent: Path, *, current: Path) -> None:
    """Remove work folders that were not used for two weeks, and those whose removal was interrupted."""
    for other in parent.glob(f"{_PREFIX}*"):
        if other.is_dir() and other != current:
            abandoned = time.time() - other.stat().st_mtime > _ABANDONED_AFTER_S
            if abandoned or other.name.endswith(_REMOVED_SUFFIX):
                shutil.rmtree(other, ignore_errors=True)
