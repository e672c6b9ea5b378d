"""The worker process: started with a job, resumed from its work folder."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock

from facadelake.core.cache import DIAGNOSTICS
from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.processes.parent import get_log_path, run_worker_process

logger = logging.getLogger(__name__)

_LOG_TAIL_LINES = 12
_PREFIX = ".work-"
_REMOVED_SUFFIX = ".removed"
_ABANDONED_AFTER_S = 14 * 86400


def run_worker(job: Mapping[str, Any], folder: Path) -> None:
    """Run ``job`` in a process of its own; results are in ``folder``, its log in ``diagnostics/worker.log`` there.

    Raises InputDataError where the worker refuses the photographs, and FacadelakeError with the end of the log where it
    crashed or was killed.
    """
    diagnostics = folder / DIAGNOSTICS
    diagnostics.mkdir(parents=True, exist_ok=True)
    cause = run_worker_process("facadelake.sfm.worker", {**job, "folder": str(folder)}, diagnostics)
    if cause:
        raise FacadelakeError(_describe_crash(cause, get_log_path(diagnostics)))


def _describe_crash(cause: str, log_path: Path) -> str:
    """Message of an unexpected end of the worker, with the last lines of its log."""
    if "SIGKILL" in cause:
        cause += " (usually the machine ran out of memory; reduce max_image_px or max_features)"
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
