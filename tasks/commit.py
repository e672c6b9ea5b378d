"""Task: the campaign enters the lake in one transaction."""

from __future__ import annotations

from prefect import task

from facadelake.core.tables import read_table
from facadelake.georeferencing.campaign import REFERENCE_FILE, drop_reference, store_reference
from facadelake.lake import Committed, commit_campaign, lake_tables
from tasks.job import InspectionJob, StageResult, StageResults
from tasks.record import whole_campaign


@task(name="commit")
def commit(job: InspectionJob, results: StageResults, checks: StageResult) -> Committed:
    """The lake's version that holds the campaign, and whether it is new; later campaigns find it by its reference."""
    run, tables = whole_campaign(job, results)
    tables["checks"] = read_table("checks", checks.folder)
    committed = commit_campaign(
        job.lake,
        building_id=job.building.id,
        campaign_id=job.campaign_id,
        run_id=job.run_id,
        tables=lake_tables(tables, run),
        inputs_sha256=run.inputs_sha256,
    )
    reference = results.placed.folder / REFERENCE_FILE
    if reference.is_file():
        store_reference(reference, job.lake, job.building.id, job.campaign_id)
    else:
        drop_reference(job.lake, job.building.id, job.campaign_id)
    return committed
