"""Task: detections made by an ONNX model, as configured in the portfolio."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from prefect import task

from facadelake.building import read_building
from facadelake.core.hashing import hash_file
from facadelake.core.tables import read_table, write_table
from facadelake.detection import count_threads, detect_photographs, hash_configured_detector, load_configured_detector
from facadelake.photos import find_masks
from facadelake.registration import prepare_search_regions
from facadelake.registry import OnnxDetectorSetting
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage


@task(name="detect")
def detect(job: InspectionJob, model: StageResult, photos: StageResult, placed: StageResult) -> StageResult:
    """Table ``detections`` of the building's ONNX model, searched where the poses show the building."""
    setting = job.building.detector
    assert isinstance(setting, OnnxDetectorSetting)
    root = job.building.locate_photographs(job.campaign_id)
    masks = find_masks(root)

    def make(folder: Path) -> Counts:
        table = detect_photographs(
            read_table("photos", photos.folder),
            root,
            load_configured_detector(setting),
            class_names=setting.classes,
            find_region=prepare_search_regions(read_building(model.folder), read_table("poses", placed.folder), masks),
            workers=count_threads(setting),
        )
        write_table("detections", table, folder)
        return Counter(table.column("detection_outcome").to_pylist())

    inputs = {
        "detector": hash_configured_detector(setting),
        "score_threshold": setting.score_threshold,
        "masks": {photo_id: [mask.name, hash_file(mask)] for photo_id, mask in masks.items()},
    }
    reads = {"model": model, "photos": photos, "placed": placed}
    return run_stage(job, "detect", reads=reads, inputs=inputs, make=make)
