"""The process in which ifcopenshell parses an IFC: ``python -m facadelake.building.ifc.worker JOB.json``.

Reason: its parser and kernels are native code that a malformed file can crash, occupy for ever or make allocate all
memory.
"""

from __future__ import annotations

import logging
import resource
import sys
from contextlib import suppress
from pathlib import Path

from pydantic import TypeAdapter

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.core.errors import FacadelakeError, ModelError
from facadelake.core.processes.worker import EventStream, NoteHandler, ProgressForwarder, read_job
from facadelake.core.progress import listen_to_progress

_FULL_SHARE = 0.5  # what failed to be allocated may be as large as all that was


def main(job_path: Path) -> int:
    """Load the model and save it into the job's folder; returns 0 on success, 2 where it was refused."""
    job = read_job(job_path)
    events = EventStream.take_standard_output()
    logging.getLogger("facadelake").addHandler(NoteHandler(events))
    logging.getLogger("facadelake").setLevel(logging.INFO)
    limit_memory(job["memory_max_bytes"])
    path = Path(job["model"])
    settings = TypeAdapter(IfcModelSettings).validate_python(job["settings"])
    try:
        with listen_to_progress(ProgressForwarder(events)):
            load_ifc_building(path, settings=settings).save(Path(job["folder"]))
    except (FacadelakeError, MemoryError) as error:
        events.refuse(_explain(error, path, job["memory_max_bytes"]))
        return 2
    return 0


def limit_memory(memory_max_bytes: int) -> None:
    """Limit the memory of this process, and let the kernel end it before others where all memory is used."""
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    limit = memory_max_bytes if hard == resource.RLIM_INFINITY else min(memory_max_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    with suppress(OSError):  # some containers mount /proc read-only
        Path("/proc/self/oom_score_adj").write_text("1000")


def _explain(error: FacadelakeError | MemoryError, path: Path, memory_max_bytes: int) -> FacadelakeError:
    """The error to report; for want of memory the parser also says that the file is damaged."""
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if isinstance(error, FacadelakeError) and not (
        isinstance(error, ModelError) and peak_bytes > _FULL_SHARE * memory_max_bytes
    ):
        return error
    return ModelError(
        f"reading building model {path} took {peak_bytes / 1e9:.1f} of the {memory_max_bytes / 1e9:.1f} GB of memory "
        f"that were free, and failed ({error or 'no more memory'}); end other programs, or export the model without "
        "furniture and services"
    )


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
