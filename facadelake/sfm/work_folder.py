"""Where a long reconstruction keeps what it has done, so that a killed one goes on instead of beginning anew."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock

from facadelake.core.errors import InputDataError

logger = logging.getLogger(__name__)

_PREFIX = ".work-"
_REMOVED_SUFFIX = ".done"
_ABANDONED_AFTER_S = 14 * 86400


@contextmanager
def open_work_folder(parent: Path, key: str) -> Iterator[Path]:
    """The folder ``parent/.work-<key>``, ours alone while the block runs.

    It is removed when the work ends well, and when the input is refused, for that ends the same way again; it stays
    after a crash or a kill. Folders that nobody came back to for two weeks are removed.
    """
    parent.mkdir(parents=True, exist_ok=True)
    folder = parent / f"{_PREFIX}{key}"
    with FileLock(parent / f"{_PREFIX}{key}.lock"):
        _remove_abandoned(parent, besides=folder)
        if folder.exists():
            logger.info("an interrupted reconstruction of the same photographs goes on")
        folder.mkdir(exist_ok=True)
        folder.touch()
        try:
            yield folder
        except InputDataError:
            _remove(folder)
            raise
        _remove(folder)


def _remove(folder: Path) -> None:
    """Under another name first: a kill while files go leaves no half of a work folder to go on from."""
    done = folder.with_name(folder.name + _REMOVED_SUFFIX)
    folder.rename(done)
    shutil.rmtree(done, ignore_errors=True)


def _remove_abandoned(parent: Path, *, besides: Path) -> None:
    for other in parent.glob(f"{_PREFIX}*"):
        if other.is_dir() and other != besides:
            forgotten = time.time() - other.stat().st_mtime > _ABANDONED_AFTER_S
            if forgotten or other.name.endswith(_REMOVED_SUFFIX):
                shutil.rmtree(other, ignore_errors=True)
