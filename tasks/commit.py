"""Task: the campaign enters the lake in one transaction."""

from __future__ import annotations

from prefect import task

from facadelake.lake.commit import Committed, commit_campaign
from tasks.job import InspectionJob, StageResult
from tasks.record import StageFolders, fingerprint, lake_form


@task(name="commit")
def commit(job: InspectionJob, folders: StageFolders, checks: StageResult) -> Committed:
    """The lake's version that holds the campaign, and whether it is new."""
    return commit_campaign(
        job.lake,
        building_id=job.building.id,
        campaign_id=job.campaign_id,
        run_id=job.run_id,
        tables=lake_form(job, folders, checks=checks),
        inputs_sha256=fingerprint(folders),
    )
