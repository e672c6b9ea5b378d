"""Task: read the building model, triangulate it, georeference it."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.building import read_registered_model
from facadelake.core.hashing import hash_file
from facadelake.core.progress import report_progress
from facadelake.registry import find_buffer_files
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="load model")
def load_model(job: InspectionJob) -> StageResult:
    """The building model, an IFC or a mesh, as triangles in site and a table of elements."""
    building = job.building
    path, offset = building.locate_model(), building.locate_offset_file()

    def make(folder: Path) -> Counts:
        with report_progress(f"Reading {path.name}"):
            model = read_registered_model(building)
        model.save(folder)
        return {"elements": len(model.elements), "triangles": len(model.triangles)}

    inputs = {
        "model": hash_file(path),
        **{f"beside {file.name}": hash_file(file) for file in find_buffer_files(path)},
        "kind": building.surface_kind,
        "offset": hash_file(offset) if offset else None,
        **building.model_dump(mode="json", include={"crs", "storeys", "model_building"}),
    }
    return run_stage(job, "load-model", reads={}, inputs=inputs, make=make)
