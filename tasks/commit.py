"""Task: commit the campaign to the lake in one transaction."""

from __future__ import annotations

from prefect import task

from facadelake.core.tables import read_table
from facadelake.georeferencing.campaign import REFERENCE_FILE, drop_reference, store_reference
from facadelake.lake import CommitResult, build_lake_tables, commit_campaign
from tasks.job import InspectionJob, StageResult, StageResults
from tasks.record import assemble_campaign


@task(name="commit")
def commit(job: InspectionJob, results: StageResults, checks: StageResult) -> CommitResult:
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
    )
    reference = results.placed.folder / REFERENCE_FILE
    if reference.is_file():
        store_reference(reference, job.lake, job.building.id, job.campaign_id)
    else:
        drop_reference(job.lake, job.building.id, job.campaign_id)
    return committed
