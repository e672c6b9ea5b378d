"""Tasks: commit the campaign to the lake in one transaction; publish it as files and as artifacts of the run."""

from __future__ import annotations

import base64
from pathlib import Path

from prefect import task
from prefect.artifacts import create_markdown_artifact, create_table_artifact

from facadelake.core.tables import read_table
from facadelake.georeferencing.campaign import REFERENCE_FILE, drop_reference, store_reference
from facadelake.lake import CommitResult, build_lake_tables, commit_campaign
from facadelake.lake import read_table as read_lake_table
from facadelake.publish import publish_campaign
from tasks.draw import PICTURES
from tasks.job import InspectionJob, StageResult, StageResults
from tasks.record import assemble_campaign
from tasks.track import TrackedCampaigns, build_tracked_history

SHOWN = ["defect_id", "defect_class", "severity", "facade", "storey", "photo_count", "width_m", "height_m"]


@task(name="commit")
def commit(job: InspectionJob, results: StageResults, tracked: TrackedCampaigns, checks: StageResult) -> CommitResult:
    """Commit the tables and keep the reference for later campaigns; returns the version and whether it is new."""
    run, tables = assemble_campaign(job, results)
    tables["checks"] = read_table("checks", checks.folder)
    committed = commit_campaign(
        job.lake,
        building_id=job.building.id,
        campaign_id=job.campaign_id,
        run_id=job.run_id,
        tables=build_lake_tables(tables, run),
        inputs_sha256=run.inputs_sha256,
        history=build_tracked_history(tracked),
    )
    reference = results.placed.folder / REFERENCE_FILE
    if reference.is_file():
        store_reference(reference, job.lake, job.building.id, job.campaign_id)
    else:
        drop_reference(job.lake, job.building.id, job.campaign_id)
    return committed


@task(name="publish")
def publish(job: InspectionJob, committed: CommitResult, pictures: StageResult | None) -> Path:
    """Write the release of this version; ``latest`` beside it links to it."""
    defects = read_lake_table(job.lake, "defects", building_id=job.building.id, campaign_id=job.campaign_id)
    release = publish_campaign(
        job.lake,
        building_id=job.building.id,
        campaign_id=job.campaign_id,
        version=committed.version,
        pictures=pictures.folder / PICTURES if pictures else None,
    )
    key = f"{job.building.id}-{job.campaign_id}".lower().replace(".", "-").replace("_", "-")
    create_table_artifact(
        key=f"{key}-defects",
        description=f"Defects of {job.building.name}, campaign {job.campaign_id}, lake version {committed.version}",
        table=defects.select(SHOWN).to_pylist(),
    )
    if pictures is not None:
        images = sorted(pictures.folder.rglob("thumbnail*.jpg"))
        if images:
            data = base64.b64encode(images[0].read_bytes()).decode()
            create_markdown_artifact(
                key=f"{key}-elevation",
                description=f"Elevation of {job.building.name}, campaign {job.campaign_id}",
                markdown=f"![elevation](data:image/jpeg;base64,{data})\n\nReport: `{release / 'report.html'}`",
            )
    return release
