"""Task: georeference the block."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prefect import task

from facadelake.building import list_registered_readings, read_building
from facadelake.core.hashing import hash_file
from facadelake.core.proj.crs import GEO
from facadelake.core.tables import read_table, write_table
from facadelake.georeferencing import (
    Control,
    SiteFrame,
    build_checks_table,
    build_poses_table,
    georeference_reconstruction,
)
from facadelake.georeferencing.campaign import REFERENCE_FILE, read_reference
from facadelake.georeferencing.gcp import read_surveyed_points
from facadelake.georeferencing.model import build_model_control
from facadelake.sfm import read_descriptors, read_reconstruction
from schemas.vocabulary import ControlKind
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage

SITE_FROM_SFM = "site_from_sfm.json"


@task(name="georeference")
def georeference_block(
    job: InspectionJob, model: StageResult, photos: StageResult, block: StageResult, earlier: Sequence[Path]
) -> StageResult:
    """Tables ``poses``, ``georeference``, ``georeference_points`` and ``placement_checks``, and the reference for later
    campaigns.

    ``earlier``: references of earlier campaigns of the building, the first one first.
    """
    building, tolerances, crs = job.building, job.building.tolerances, job.building.crs
    gcp_file, check_file = (
        building.locate_control_points(job.campaign_id),
        building.locate_check_points(job.campaign_id),
    )
    # With GPS or model control, no earlier campaign is used.
    alone = job.control in (ControlKind.GPS, ControlKind.MODEL)
    references = [] if alone else list(earlier)
    root = building.locate_photographs(job.campaign_id)
    accepted = building.list_accepted_statements(job.campaign_id)

    def make(folder: Path) -> Counts:
        model_of_building = read_building(model.folder)
        reconstruction = read_reconstruction(block.folder)
        descriptors = read_descriptors(block.folder)
        photos_table = read_table("photos", photos.folder)
        placed = georeference_reconstruction(
            reconstruction,
            photos_table,
            site_frame=SiteFrame(
                origin=model_of_building.origin,
                map_crs=model_of_building.map_crs,
                vertical_datum=model_of_building.vertical_datum,
                georeference_level=model_of_building.georeference_level,
                model_remarks=model_of_building.remarks,
                gnss_crs=crs.gnss or GEO,
                accepted_operation_accuracy_m=crs.accept_operation_accuracy_m,
            ),
            control=Control(
                kind=job.control,
                points=read_surveyed_points(gcp_file) if gcp_file else None,
                check_points=read_surveyed_points(check_file) if check_file else None,
                model=build_model_control(
                    model_of_building,
                    [root / photo.photo_id for photo in reconstruction.photos],
                    tolerances.model_sigma_m,
                    list_registered_readings(building, model_of_building.origin),
                )
                if model_of_building.has_surface
                else None,
                references=[(read_reference(path), descriptors) for path in references],
                placement_sigma_max_m=tolerances.placement_sigma_max_m,
                accepted=accepted,
            ),
        )
        placed.site_from_sfm.save(folder / SITE_FROM_SFM)
        origin = model_of_building.origin
        write_table("poses", build_poses_table(placed, reconstruction, photos_table, origin=origin), folder)
        write_table("georeference", placed.build_table(), folder)
        write_table("georeference_points", placed.build_points_table(origin), folder)
        write_table("placement_checks", build_checks_table(placed.placement_checks), folder)
        reference = placed.build_reference(reconstruction, descriptors, building.id, job.campaign_id, origin)
        if reference is not None:
            reference.save(folder / REFERENCE_FILE)
        return {"localised": len(placed.cameras), "not localised": len(reconstruction.unlocalised)}

    inputs = {
        "named": [building.id, job.campaign_id],  # in the reference, by which later campaigns name it
        "control": job.control,
        "control_points": hash_file(gcp_file) if gcp_file else None,
        "check_points": hash_file(check_file) if check_file else None,
        "references": [hash_file(path) for path in references],
        "model_sigma_m": tolerances.model_sigma_m,
        "crs": [crs.gnss, crs.accept_operation_accuracy_m],
        "placement_sigma_max_m": tolerances.placement_sigma_max_m,
        "open_readings": [crs.axes, crs.unit],  # of a mesh, beside the one that the model was read with
        "accept_placement": [one.model_dump() for one in accepted],
    }
    reads = {"model": model, "photos": photos, "block": block}
    return run_stage(job, "georeference", reads=reads, inputs=inputs, make=make)
