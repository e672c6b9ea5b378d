"""Task: structure from motion, in a process of its own."""

from __future__ import annotations

from pathlib import Path

from prefect import task

from facadelake.core.tables import read_table
from facadelake.sfm import ReconstructionSettings, read_reconstruction, reconstruct
from schemas.vocabulary import PoseSource
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="reconstruct")
def reconstruct_block(job: InspectionJob, photos: StageResult) -> StageResult:
    """Camera poses and tie points in frame ``sfm``."""
    settings = ReconstructionSettings(max_image_px=job.building.tolerances.features_max_image_px)
    root = job.building.locate_photographs(job.campaign_id)

    def make(folder: Path) -> Counts:
        reconstruct(read_table("photos", photos.folder), root, folder, settings)
        block = read_reconstruction(folder)
        resected = sum(photo.source == PoseSource.RESECTED for photo in block.photos)
        return {"cameras": len(block.photos), "of them resected": resected, "tie points": len(block.xyz_sfm)}

    return run_stage(job, "reconstruct", reads={"photos": photos}, inputs={"settings": settings.cache_key}, make=make)
