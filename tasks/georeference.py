"""Task: place the block of photographs on the globe."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.cache import file_hash
from facadelake.geobim.model import read_building
from facadelake.geobim.surface import Surface
from facadelake.pose.control_points import read_control_points
from facadelake.pose.georeference import georeference
from facadelake.pose.poses import poses_table
from facadelake.pose.reconstruction import read_reconstruction
from facadelake.tables import read_table, write_table
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage

SITE_FROM_SFM = "site_from_sfm.json"


@task(name="georeference")
def georeference_block(job: InspectionJob, model: StageResult, photos: StageResult, block: StageResult) -> StageResult:
    """Tables ``poses`` and ``georeference``: every camera in site, and how well the block is placed."""
    gcp_file = job.building.control_points_of(job.campaign_id)

    def make(folder: Path) -> Counts:
        building = read_building(model.folder)
        reconstruction = read_reconstruction(block.folder)
        photos_table = read_table("photos", photos.folder)
        placed = georeference(
            reconstruction,
            photos_table,
            origin=building.origin,
            map_crs=building.map_crs,
            vertical_datum=building.vertical_datum,
            control=job.control,
            control_points=read_control_points(gcp_file) if gcp_file else None,
            surface=Surface(building),
        )
        placed.site_from_sfm.save(folder / SITE_FROM_SFM)
        write_table("poses", poses_table(placed, reconstruction, photos_table, origin=building.origin), folder)
        write_table("georeference", placed.table(), folder)
        return {"localised": len(placed.cameras), "not localised": len(reconstruction.unlocalised)}

    inputs = {
        "model": model.key,
        "photos": photos.key,
        "block": block.key,
        "control": job.control,
        "control_points": file_hash(gcp_file) if gcp_file else None,
    }
    return run_stage(job, "georeference", code=["pose", "geobim", "posed.py"], inputs=inputs, make=make)
