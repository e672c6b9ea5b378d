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
from facadelake.registration import register_detections, resolve_registration_settings
from facadelake.sfm import read_reconstruction
from schemas.vocabulary import ObservationOutcome, SurfaceKind
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage

# Detections beside the building are rare where photographs show little else; below ten, chance decides.
_MIN_DETECTIONS, _OFF_TARGET_SHARE_MAX = 10, 1 / 3


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
    """A warning where many detections are not on the building: model, poses or detector may be wrong."""
    counts = dict(registered.counts)
    not_seen = (ObservationOutcome.UNLOCALISED, ObservationOutcome.MASKED, ObservationOutcome.OUTSIDE)
    seen = sum(counts.values()) - sum(counts.get(outcome, 0) for outcome in not_seen)
    off_target = counts.get(ObservationOutcome.OFF_TARGET, 0)
    if seen < _MIN_DETECTIONS or off_target <= _OFF_TARGET_SHARE_MAX * seen:
        return []
    mesh = " (crs.axes and crs.unit of the mesh)" if job.building.surface_kind is SurfaceKind.MESH else ""
    share = f"{off_target / seen:.0%}, limit {_OFF_TARGET_SHARE_MAX:.0%}"
    return [
        f"{off_target} of {seen} detections ({share}) are not on the building: the model may be another, turned or "
        f"mirrored{mesh}, the poses may be wrong, or the detector finds much beside the building; look at a photograph "
        "beside the model with facadelake view"
    ]
