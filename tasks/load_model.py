"""Task: read the building model, mesh it once, place it on the globe."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.cache import file_hash
from facadelake.geobim.control_fit import ControlPair
from facadelake.geobim.georeference import MapPlacement
from facadelake.geobim.load import load_building
from facadelake.geobim.model import ModelSettings
from facadelake.geodesy import SiteOrigin
from facadelake.progress import stage_progress
from facadelake.registry import Building
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="load model")
def load_model(job: InspectionJob) -> StageResult:
    """The building model as triangles in site and a table of elements."""
    path = job.building.model_path()
    settings = model_settings(job.building)

    def make(folder: Path) -> Counts:
        with stage_progress(f"Reading {path.name}"):
            model = load_building(path, settings=settings)
        model.save(folder)
        return {"elements": len(model.elements), "triangles": len(model.triangles)}

    inputs = {"model": file_hash(path), "crs": job.building.crs.model_dump()}
    return run_stage(job, "load-model", code=["geobim"], inputs=inputs, make=make)


def model_settings(building: Building) -> ModelSettings:
    """The registry's word on the model, as geobim takes it."""
    crs = building.crs
    place = crs.placement
    return ModelSettings(
        placement=MapPlacement(
            east_m=place.east_m,
            north_m=place.north_m,
            height_m=place.height_m,
            rotation_deg=place.rotation_deg,
            scale=(place.scale, place.scale, 1.0),
        )
        if place
        else None,
        control=tuple(ControlPair(ifc_m=pair.ifc_m, map_m=pair.map_m) for pair in crs.control),
        accept_level=crs.accept_level,
        map_crs=crs.map,
        vertical_datum=crs.vertical,
        origin=SiteOrigin(**crs.origin.model_dump()) if crs.origin else None,
    )
