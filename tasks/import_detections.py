"""Task: detections imported from a COCO file, as configured in the portfolio."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.core.tables import read_table, write_table
from facadelake.detection.coco import import_coco
from facadelake.detection.inference import hash_detector
from facadelake.registry import CocoDetectorSetting
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="import detections")
def import_detections(job: InspectionJob, photos: StageResult) -> StageResult:
    """Table ``detections`` of a COCO file."""
    detector = job.building.detector
    assert isinstance(detector, CocoDetectorSetting)
    file = job.building.locate_detections(job.campaign_id, job.detections)

    def make(folder: Path) -> Counts:
        table = import_coco(
            file,
            read_table("photos", photos.folder),
            class_names=detector.classes,
            exif_view=detector.exif_view,
        )
        write_table("detections", table, folder)
        return Counter(table.column("detection_outcome").to_pylist())

    inputs = {"detector": hash_detector(file, detector.classes), "exif_view": detector.exif_view}
    return run_stage(job, "detect", reads={"photos": photos}, inputs=inputs, make=make)
