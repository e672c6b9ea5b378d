"""Task: measure cracks in the photographs, in pixels."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.core.tables import read_table, write_table
from facadelake.measurement import measure_detections
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="measure")
def measure(job: InspectionJob, photos: StageResult, detections: StageResult) -> StageResult:
    """Table ``detections`` with widths and lengths of cracks; table ``photos`` has the photographs' hashes."""

    def make(folder: Path) -> Counts:
        root = job.building.locate_photographs(job.campaign_id)
        table = measure_detections(read_table("detections", detections.folder), root)
        write_table("detections", table, folder)
        return Counter(word for word in table.column("crack_width_outcome").to_pylist() if word is not None)

    return run_stage(job, "measure", reads={"photos": photos, "detections": detections}, inputs={}, make=make)
