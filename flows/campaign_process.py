"""The process of one inspection that ``inspect_portfolio`` starts: a flow run of its own, and what became of it.

Run as ``python -m flows.campaign_process JOB.json``; it writes events to its standard output and ``result.json`` beside
its job. Without that file it has crashed or was killed.
"""

from __future__ import annotations

import json
import logging
import sys
import warnings
from pathlib import Path
from typing import Any
from uuid import UUID

from facadelake.core.errors import GeoreferenceError, InputDataError, ModelError, SchemaError
from facadelake.core.processes.worker import EventStream, NoteHandler, ProgressForwarder, read_job
from facadelake.core.progress import listen_to_progress

RESULT = "result.json"
# The input is at fault: the same photographs, files and settings lead to the same error.
_KILLED = "was killed by signal SIGKILL"  # of a process that the inspection had started (core/processes/parent.py)
_REFUSALS = (InputDataError, GeoreferenceError, ModelError, SchemaError)


def main(job_path: Path) -> None:
    """Run the flow run of the job and write its result."""
    events = EventStream.take_standard_output()
    job = read_job(job_path)
    log = logging.getLogger("facadelake.tasks")
    log.addHandler(NoteHandler(events))
    log.setLevel(logging.INFO)
    with listen_to_progress(ProgressForwarder(events)), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecation warnings of libraries are for developers
        result = _run(UUID(job["flow_run_id"]), job["parameters"])
    (job_path.parent / RESULT).write_text(json.dumps(result), encoding="utf-8")


def _run(flow_run_id: UUID, parameters: dict[str, Any]) -> dict[str, Any]:
    from prefect.client.orchestration import get_client
    from prefect.flow_engine import run_flow_sync

    from flows.inspect_building import InspectionResult, inspect_building

    with get_client(sync_client=True) as client:
        flow_run = client.read_flow_run(flow_run_id)
    try:
        result = run_flow_sync(inspect_building, flow_run=flow_run, parameters=parameters)
    except Exception as error:
        problem = str(error) or type(error).__name__
        outcome = "killed" if _KILLED in problem else "refused" if isinstance(error, _REFUSALS) else "failed"
        return {"outcome": outcome, "problem": problem}
    assert isinstance(result, InspectionResult)
    return {
        "outcome": "committed" if result.changed else "unchanged",
        "version": result.version,
        "warnings": list(result.warnings),
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]))
