"""Task: detections, imported from a COCO file or made by an ONNX model, as the registry says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.detect.coco import import_coco
from facadelake.detect.detector import detector_fingerprint, load_detector
from facadelake.detect.onnx import detect_photographs
from facadelake.registry import CocoDetector
from facadelake.tables import read_table, write_table
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="detect")
def detect(job: InspectionJob, photos: StageResult) -> StageResult:
    """Table ``detections``."""
    detector = job.building.detector
    if isinstance(detector, CocoDetector):
        file = job.building.detections_of(job.campaign_id, job.detections)
        fingerprint = detector_fingerprint(file, detector.classes)
    else:
        file = Path(detector.model)
        fingerprint = detector_fingerprint(file, detector.classes, Path(detector.card) if detector.card else None)

    def make(folder: Path) -> Counts:
        table_of_photos = read_table("photos", photos.folder)
        if isinstance(detector, CocoDetector):
            table = import_coco(file, table_of_photos, class_names=detector.classes)
        else:
            model = load_detector(file, Path(detector.card) if detector.card else None)
            root = job.building.photographs_of(job.campaign_id)
            table = detect_photographs(table_of_photos, root, model, class_names=detector.classes)
        write_table("detections", table, folder)
        return Counter(table.column("detection_outcome").to_pylist())

    inputs = {"photos": photos.key, "detector": fingerprint}
    return run_stage(job, "detect", code=["detect", "photo_names.py"], inputs=inputs, make=make)
