"""Task: as-built surface of a building without a model, from the tie points of the block."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.building import read_building
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.tables import read_table
from facadelake.sfm import build_as_built_model, read_reconstruction
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="as-built model")
def make_as_built_model(job: InspectionJob, place: StageResult, block: StageResult, placed: StageResult) -> StageResult:
    """The building with its as-built surface, divided into facade planes."""

    def make(folder: Path) -> Counts:
        posed = read_posed_cameras(read_table("poses", placed.folder))
        model = build_as_built_model(read_building(place.folder), read_reconstruction(block.folder), posed)
        model.save(folder)
        return {"facade planes": len(model.elements), "triangles": len(model.triangles)}

    reads = {"place": place, "block": block, "placed": placed}
    return run_stage(job, "as-built-model", reads=reads, inputs={}, make=make)
