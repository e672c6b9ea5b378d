"""Task: detections, imported from a COCO file or made by an ONNX model, as the registry says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.cache import file_hash
from facadelake.detect.coco import import_coco
from facadelake.detect.onnx import OnnxDetector, detect_photographs
from facadelake.registry import CocoDetector
from facadelake.tables import read_table, write_table
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="detect")
def detect(job: InspectionJob, photos: StageResult) -> StageResult:
    """Table ``detections``."""
    detector = job.building.detector
    if isinstance(detector, CocoDetector):
        return _import(job, photos, detector)
    raise NotImplementedError


def _import(job: InspectionJob, photos: StageResult, detector: CocoDetector) -> StageResult:
    file = job.building.detections_of(job.campaign_id, job.detections)

    def make(folder: Path) -> Counts:
        table = import_coco(file, read_table("photos", photos.folder), class_names=detector.classes)
        write_table("detections", table, folder)
        return Counter(table.column("detection_outcome").to_pylist())

    inputs = {"photos": photos.key, "file": file.name, "bytes": file_hash(file), "classes": detector.classes}
    return run_stage(job, "detect", code=["detect"], inputs=inputs, make=make)
