"""Tasks: a building without any model: its place before the block stands, its surface from the block's tie points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from prefect import task

from facadelake.core.pose_table import posed_cameras
from facadelake.core.tables import read_table
from facadelake.geobim.mesh_building import place_without_model
from facadelake.geobim.model import read_building
from facadelake.pose.as_built import as_built_building
from facadelake.pose.reconstruction import read_reconstruction
from tasks.job import InspectionJob, StageResult
from tasks.load_model import bare_settings
from tasks.stage import Counts, run_stage


@task(name="place building")
def place_building(job: InspectionJob, photos: StageResult) -> StageResult:
    """The building's origin, CRS and storeys, by its photographs and the registry; it has no surface yet."""

    def make(folder: Path) -> Counts:
        table = read_table("photos", photos.folder).select(["prior_lon_deg", "prior_lat_deg"])
        lon_lat = np.column_stack([column.to_numpy() for column in table.columns]).astype(np.float64)
        place_without_model(lon_lat, settings=bare_settings(job.building)).save(folder)
        return {"photographs that say where": int(np.isfinite(lon_lat).all(axis=1).sum())}

    inputs = {"photos": photos.key, **job.building.model_dump(mode="json", include={"crs", "storeys"})}
    return run_stage(job, "place-building", code=["geobim"], inputs=inputs, make=make)


@task(name="as-built model")
def as_built_model(job: InspectionJob, place: StageResult, block: StageResult, placed: StageResult) -> StageResult:
    """The building with the campaign's own surface, cut into facade planes."""

    def make(folder: Path) -> Counts:
        posed = posed_cameras(read_table("poses", placed.folder))
        model = as_built_building(read_building(place.folder), read_reconstruction(block.folder), posed)
        model.save(folder)
        return {"facade planes": len(model.elements), "triangles": len(model.triangles)}

    inputs = {"place": place.key, "block": block.key, "poses": placed.key}
    code = [
        "geobim",
        "posed.py",
        "pose/as_built.py",
        "pose/surface_mesh.py",
        "pose/free_space.py",
        "pose/reconstruction.py",
        "pose/tie_point_quality.py",
    ]
    return run_stage(job, "as-built-model", code=code, inputs=inputs, make=make)
