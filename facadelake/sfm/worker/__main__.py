"""Entry point of the worker process: read the job, run it, report events on standard output, one JSON object a line."""

from __future__ import annotations

import sys
from pathlib import Path

from facadelake.core.errors import InputDataError
from facadelake.core.processes.worker import read_job
from facadelake.sfm.worker.report import ProgressReport


def main(job_path: Path) -> int:
    """Run the job; returns 0 on success, 2 where the photographs were refused (the reason was reported)."""
    job = read_job(job_path)
    report = ProgressReport.take_standard_output()
    from facadelake.sfm.worker.job import run_job  # pycolmap loads after its output was redirected

    try:
        run_job(job, Path(job["folder"]), report)
    except InputDataError as error:
        report.refuse(error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
