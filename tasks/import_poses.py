"""Task: import camera poses of another program instead of reconstructing and georeferencing."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.building import read_building
from facadelake.building.surface import Surface
from facadelake.core.hashing import hash_files
from facadelake.core.proj.crs import GEO
from facadelake.core.tables import read_table, write_table
from facadelake.georeferencing import SiteFrame
from facadelake.georeferencing.gcp import read_surveyed_points
from facadelake.georeferencing.imported import list_pose_files, place_imported_poses, read_poses
from facadelake.georeferencing.model import build_target_surface
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="import poses")
def import_poses(job: InspectionJob, model: StageResult, photos: StageResult) -> StageResult:
    """Tables ``poses``, ``georeference``, ``georeference_points`` and ``placement_checks``, no reference.

    Control and check points of the campaign, where it has any, test the poses and do not move them.
    """
    assert job.poses is not None
    path, crs = job.poses, job.building.crs
    limit_m = job.building.tolerances.placement_sigma_max_m
    files = (job.building.locate_control_points(job.campaign_id), job.building.locate_check_points(job.campaign_id))
    surveyed = [file for file in files if file is not None]
    accepted = job.building.list_accepted_statements(job.campaign_id)

    def make(folder: Path) -> Counts:
        building = read_building(model.folder)
        photos_table = read_table("photos", photos.folder)
        placed = place_imported_poses(
            read_poses(path),
            photos_table,
            site_frame=SiteFrame(
                origin=building.origin,
                map_crs=building.map_crs,
                vertical_datum=building.vertical_datum,
                georeference_level=building.georeference_level,
                model_remarks=building.remarks,
                gnss_crs=crs.gnss or GEO,
                accepted_operation_accuracy_m=crs.accept_operation_accuracy_m,
            ),
            surface=build_target_surface(building) or Surface(building),
            placement_sigma_max_m=limit_m,
            surveyed=[read_surveyed_points(file) for file in surveyed],
            accepted_statements=accepted,
        )
        write_table("poses", placed.poses, folder)
        write_table("georeference", placed.georeference, folder)
        write_table("georeference_points", placed.georeference_points, folder)
        write_table("placement_checks", placed.placement_checks, folder)
        return {"localised": placed.localised, "not localised": len(placed.poses) - placed.localised}

    inputs = {
        "poses": hash_files(list_pose_files(path)),
        "name": path.name,
        "surveyed": hash_files(surveyed),
        "crs": [crs.gnss, crs.accept_operation_accuracy_m],
        "placement_sigma_max_m": limit_m,
        "accept_placement": [one.model_dump() for one in accepted],
    }
    return run_stage(job, "import-poses", reads={"model": model, "photos": photos}, inputs=inputs, make=make)
