"""Entry point of the worker process: read the job, run it, report events on standard output, one JSON object a line."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

from facadelake.core.errors import InputDataError
from facadelake.sfm.worker.report import ProgressReport

_PR_SET_PDEATHSIG = 1


def _end_with_parent(parent: int) -> None:
    """Ask the kernel (Linux) to end this process when its parent dies: an orphan would hold gigabytes."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        sys.exit("the parent process has ended")


def main(job_path: Path) -> int:
    """Run the job; returns 0 on success, 2 where the photographs were refused (the reason was reported)."""
    job: dict[str, Any] = json.loads(job_path.read_text(encoding="utf-8"))
    _end_with_parent(job["parent"])
    report = ProgressReport.take_standard_output()
    from facadelake.sfm.worker.job import run_job  # pycolmap loads after its output was redirected

    try:
        run_job(job, Path(job["folder"]), report)
    except InputDataError as error:
        report.refuse(str(error))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
