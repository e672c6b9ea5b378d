"""Task: publish the committed campaign as files, and as artifacts of the Prefect run."""

from __future__ import annotations

import base64
from pathlib import Path

from prefect import task
from prefect.artifacts import create_markdown_artifact, create_table_artifact

from facadelake.lake import CommitResult, read_table
from facadelake.publish import publish_campaign
from tasks.draw import PICTURES
from tasks.job import InspectionJob, StageResult

SHOWN = ["defect_id", "defect_class", "severity", "facade", "storey", "photo_count", "width_m", "height_m"]


@task(name="publish")
def publish(job: InspectionJob, committed: CommitResult, pictures: StageResult | None) -> Path:
    """Write the release of this version; ``latest`` beside it links to it."""
    defects = read_table(job.lake, "defects", building_id=job.building.id, campaign_id=job.campaign_id)
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
