"""Task: register detections on the building's surface, and exclude those that are not on the building."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path

from prefect import task

from facadelake.building import read_building
from facadelake.core.hashing import hash_file
from facadelake.core.tables import read_table, write_table
from facadelake.photos import find_masks
from facadelake.registration import describe_off_target, register_detections, resolve_registration_settings
from facadelake.sfm import read_reconstruction
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="register")
def register(
    job: InspectionJob,
    model: StageResult,
    placed: StageResult,
    detections: StageResult,
    block: StageResult | None,
) -> StageResult:
    """Table ``observations``, not yet merged; without a ``block`` (poses were imported) there are no tie points."""
    settings = resolve_registration_settings(job.building)
    masks = find_masks(job.building.locate_photographs(job.campaign_id))

    def make(folder: Path) -> Counts:
        table = register_detections(
            read_table("detections", detections.folder),
            read_table("poses", placed.folder),
            read_building(model.folder),
            passport=read_table("georeference", placed.folder).to_pylist()[0],
            settings=settings,
            masks=masks,
            block=read_reconstruction(block.folder) if block else None,
        )
        write_table("observations", table, folder)
        return Counter(table.column("observation_outcome").to_pylist())

    inputs = {
        "masks": {photo_id: [mask.name, hash_file(mask)] for photo_id, mask in masks.items()},
        "settings": asdict(settings),
    }
    reads = {"model": model, "placed": placed, "detections": detections, "block": block}
    return run_stage(job, "register", reads=reads, inputs=inputs, make=make)


def list_registration_warnings(job: InspectionJob, registered: StageResult) -> list[str]:
    """What concerns the campaign's detections as a whole, for the user."""
    return [text for text in [describe_off_target(dict(registered.counts), job.building.surface_kind)] if text]
