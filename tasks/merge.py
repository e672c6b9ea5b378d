"""Task: merge observations into defects and grade them by the building's rule pack."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.building import read_building
from facadelake.core.pose_table import read_pose_covariances, read_posed_cameras
from facadelake.core.tables import read_table, write_table
from facadelake.deduplication import PhotographSource, merge_observations, resolve_merge_settings
from facadelake.severity import find_rule_file, grade_defects
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="merge")
def merge_duplicates(
    job: InspectionJob,
    model: StageResult,
    photos: StageResult,
    placed: StageResult,
    observations: StageResult,
    detections: StageResult,
) -> StageResult:
    """Tables ``defects``, ``observations`` (each with the defect it shows) and ``merges``.

    Ambiguous pairs are compared in the photographs, whose hashes are in table ``photos``.
    """
    rules = find_rule_file(job.building.severity_rules)

    def make(folder: Path) -> Counts:
        passport = read_table("georeference", placed.folder).to_pylist()[0]
        poses = read_table("poses", placed.folder)
        posed = read_posed_cameras(poses)
        merged = merge_observations(
            read_table("observations", observations.folder),
            read_table("detections", detections.folder),
            read_building(model.folder),
            posed,
            prefix=f"{job.building.id}-{job.campaign_id}",
            settings=resolve_merge_settings(passport),
            covariances=read_pose_covariances(poses),
            photographs=PhotographSource(root=job.building.locate_photographs(job.campaign_id), posed=posed),
        )
        write_table("observations", merged.observations, folder)
        write_table("merges", merged.merges, folder)
        write_table("defects", grade_defects(merged.defects, rules), folder)
        return {"defects": len(merged.defects), "decisions": len(merged.merges)}

    inputs = {"rules": rules.stem, "prefix": [job.building.id, job.campaign_id]}
    reads = {
        "model": model, "photos": photos, "placed": placed, "observations": observations, "detections": detections
    }  # fmt: skip
    return run_stage(job, "merge", reads=reads, inputs=inputs, make=make)
