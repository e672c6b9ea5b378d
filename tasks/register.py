"""Task: bring each detection onto the building's surface."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path

from prefect import task

from facadelake.geobim.model import read_building
from facadelake.geobim.surface import Surface
from facadelake.posed import pose_covariances, posed_cameras
from facadelake.register.observe import observe
from facadelake.register.settings import RegisterSettings
from facadelake.registry import Building
from facadelake.tables import read_table, write_table
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="register")
def register(job: InspectionJob, model: StageResult, placed: StageResult, detections: StageResult) -> StageResult:
    """Table ``observations``, not yet merged."""
    settings = register_settings(job.building)

    def make(folder: Path) -> Counts:
        building = read_building(model.folder)
        poses = read_table("poses", placed.folder)
        table = observe(
            read_table("detections", detections.folder),
            posed_cameras(poses),
            building,
            Surface(building),
            settings=settings,
            covariances=pose_covariances(poses),
        )
        write_table("observations", table, folder)
        return Counter(table.column("observation_outcome").to_pylist())

    inputs = {"model": model.key, "poses": placed.key, "detections": detections.key, "limits": asdict(settings)}
    return run_stage(job, "register", code=["register", "geobim", "posed.py"], inputs=inputs, make=make)


def register_settings(building: Building) -> RegisterSettings:
    """The registry's tolerances, as register takes them."""
    limits = building.tolerances
    return RegisterSettings(
        grazing_above_deg=limits.grazing_above_deg,
        target_share_min=limits.target_share_min,
        model_sigma_m=limits.model_sigma_m,
    )
