"""Task: draw the pictures and the report of the campaign."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree

from prefect import task

from facadelake.building import read_building
from facadelake.building.surface import Surface
from facadelake.core.pose_table import read_posed_cameras
from facadelake.core.tables import read_table
from facadelake.lake import read_tables
from facadelake.reporting import Inspection, PictureSettings
from facadelake.reporting.history import READ_COLUMNS, TABLES, compare_with_previous
from facadelake.reporting.page import write_report
from schemas.tables import HISTORY_TABLES
from tasks.job import InspectionJob, StageResult, StageResults
from tasks.record import read_stage_tables
from tasks.stage import Counts, run_stage
from tasks.track import LOOKS, TrackedCampaigns
from tasks.verify_model import read_as_built_surface

_OF_CAMPAIGNS = ("buildings", "campaigns", "poses", "defects", "observations")  # besides the history
PICTURES = "pictures"  # published; the stage's folder also holds diagnostics


@task(name="draw")
def draw(job: InspectionJob, results: StageResults, checks: StageResult, tracked: TrackedCampaigns) -> StageResult:
    """A folder ``pictures`` with ``report.html`` and its images; the campaign is committed."""
    history = tracked.stage

    def make(folder: Path) -> Counts:
        tables = read_stage_tables(results)
        building = read_building(results.model.folder)
        inspection = Inspection(
            building_name=job.building.name,
            campaign_id=job.campaign_id,
            photographs_root=job.building.locate_photographs(job.campaign_id),
            building=building,
            posed=read_posed_cameras(tables["poses"]),
            photos=tables["photos"],
            poses=tables["poses"],
            georeference=tables["georeference"],
            georeference_points=tables["georeference_points"],
            placement_checks=tables["placement_checks"],
            detections=tables["detections"],
            observations=tables["observations"],
            defects=tables["defects"],
            merges=tables["merges"],
            integrity_views=tables["integrity_views"],
            coverage=tables["coverage"],
            checks=read_table("checks", checks.folder),
            placement_sigma_max_m=job.building.tolerances.placement_sigma_max_m,
            as_built=read_as_built_surface(results.integrity, results.placed),
        )
        committed = read_tables(job.lake, _OF_CAMPAIGNS, building_id=job.building.id, columns=READ_COLUMNS)
        states = {name: read_table(name, history.folder) for name in TABLES if name in HISTORY_TABLES}
        since = compare_with_previous({**committed, **states}, job.building, job.campaign_id, job.lake, building.origin)
        write_report(inspection, Surface(building), folder / PICTURES, PictureSettings(), since)
        copytree(history.folder / LOOKS, folder / PICTURES / LOOKS)
        return {"pictures": len(list(folder.rglob("*.png"))) + len(list(folder.rglob("*.jpg")))}

    inputs = {
        "building": job.building.name,
        "runs": tracked.run_ids,
        "campaign": job.campaign_id,
        "placement_sigma_max_m": job.building.tolerances.placement_sigma_max_m,
    }
    return run_stage(
        job, "draw", reads={**results.map_by_name(), "checks": checks, "history": history}, inputs=inputs, make=make
    )
