"""Task: measure which parts of the facades the photographs show, and how well."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.building import read_building
from facadelake.core.geodesy import SITE_AXES
from facadelake.core.hashing import hash_file
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.tables import read_table, write_table
from facadelake.coverage import CampaignPhotographs, resolve_campaign_reach
from facadelake.coverage import measure_coverage as measure_facade_coverage
from facadelake.photos import find_masks
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage
from tasks.verify_model import read_as_built_surface


@task(name="measure coverage")
def measure_coverage(
    job: InspectionJob, model: StageResult, photos: StageResult, placed: StageResult, integrity: StageResult
) -> StageResult:
    """Table ``coverage``; table ``photos`` has the photographs' hashes."""
    reach = resolve_campaign_reach(job.building, job.campaign_id, job.detections, read_table("photos", photos.folder))
    root = job.building.locate_photographs(job.campaign_id)
    masks = find_masks(root)
    grazing_above_deg = job.building.tolerances.grazing_above_deg

    def make(folder: Path) -> Counts:
        passport = read_table("georeference", placed.folder).to_pylist()[0]
        table = measure_facade_coverage(
            read_building(model.folder),
            CampaignPhotographs(posed=read_posed_cameras(read_table("poses", placed.folder)), root=root, masks=masks),
            reach,
            grazing_above_deg=grazing_above_deg,
            as_built=read_as_built_surface(integrity, placed),
            placement_sigma_m=max(passport[f"sigma_{axis}_m"] for axis in SITE_AXES),
        )
        write_table("coverage", table, folder)
        return Counter(table.column("coverage_outcome").to_pylist())

    inputs = {
        "reach": {**vars(reach), "searched": sorted(reach.searched)},
        "masks": {photo_id: [mask.name, hash_file(mask)] for photo_id, mask in masks.items()},
        "grazing_above_deg": grazing_above_deg,
    }
    reads = {"model": model, "photos": photos, "placed": placed, "integrity": integrity}
    return run_stage(job, "coverage", reads=reads, inputs=inputs, make=make)
