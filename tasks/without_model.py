"""Tasks of a building without a model: its site frame, and its as-built surface from the tie points of the block."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from prefect import task

from facadelake.building import mesh_settings_from_registry, read_building
from facadelake.building.mesh import place_building_without_model
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.tables import read_table
from facadelake.sfm import build_as_built_model, read_reconstruction
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="place building")
def place_building(job: InspectionJob, photos: StageResult) -> StageResult:
    """The building's origin, CRS and storeys from its photographs and the portfolio, without a surface."""

    def make(folder: Path) -> Counts:
        table = read_table("photos", photos.folder).select(["prior_lon_deg", "prior_lat_deg"])
        lon_lat = np.column_stack([column.to_numpy() for column in table.columns]).astype(np.float64)
        place_building_without_model(lon_lat, settings=mesh_settings_from_registry(job.building)).save(folder)
        return {"photographs that say where": int(np.isfinite(lon_lat).all(axis=1).sum())}

    inputs = job.building.model_dump(mode="json", include={"crs", "storeys"})
    return run_stage(job, "place-building", reads={"photos": photos}, inputs=inputs, make=make)


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
