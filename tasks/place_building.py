"""Task: site frame of a building without a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from prefect import task

from facadelake.building import mesh_settings_from_registry
from facadelake.building.mesh import place_building_without_model
from facadelake.core.tables import read_table
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
