"""Task: detections made by an ONNX model, as the registry says."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

import pyarrow as pa
from prefect import task

from facadelake.building.model import BuildingModel, read_building
from facadelake.building.surface.raycasting import Surface
from facadelake.core.hashing import file_sha256
from facadelake.core.pose_table import posed_cameras
from facadelake.core.tables import read_table, write_table
from facadelake.detection.campaign import View, detect_photographs
from facadelake.detection.configured import chosen_detector, chosen_fingerprint, threads_of
from facadelake.photos.files import find_masks
from facadelake.registration.target_view import target_view
from facadelake.registry import OnnxDetectorSetting
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob, StageResult
from tasks.stage import Counts, run_stage

WITHOUT_POSE = "the photograph has no pose: it was looked at everywhere, at its own pixels"


@task(name="detect")
def detect(job: InspectionJob, model: StageResult, photos: StageResult, placed: StageResult) -> StageResult:
    """Table ``detections`` made by the building's ONNX model, which looks where the poses say the building is."""
    setting = job.building.detector
    assert isinstance(setting, OnnxDetectorSetting)
    root = job.building.photographs_of(job.campaign_id)
    masks = find_masks(root)

    def make(folder: Path) -> Counts:
        table = detect_photographs(
            read_table("photos", photos.folder),
            root,
            chosen_detector(setting),
            class_names=setting.classes,
            view_of=views_of(read_building(model.folder), read_table("poses", placed.folder), masks),
            workers=threads_of(setting),
        )
        write_table("detections", table, folder)
        return Counter(table.column("detection_outcome").to_pylist())

    inputs = {
        "detector": chosen_fingerprint(setting),
        "score_threshold": setting.score_threshold,
        "masks": {photo_id: [mask.name, file_sha256(mask)] for photo_id, mask in masks.items()},
    }
    reads = {"model": model, "photos": photos, "placed": placed}
    return run_stage(job, "detect", reads=reads, inputs=inputs, make=make)


def views_of(building: BuildingModel, poses: pa.Table, masks: Mapping[str, Path]) -> Callable[[str], View]:
    """What is known of each photograph, by its photo_id, from table ``poses`` and the user's masks."""
    posed, surface = posed_cameras(poses), Surface(building)

    def view_of(photo_id: str) -> View:
        if photo_id not in posed:
            return View(remark=WITHOUT_POSE)
        seen = target_view(posed[photo_id], surface, building.elements, masks.get(photo_id))
        # A surface made of tie points has holes where a wall is bare.
        target = None if building.surface_kind is SurfaceKind.AS_BUILT else seen.target
        return View(gsd_mm=None if math.isnan(seen.gsd_mm) else seen.gsd_mm, target=target)

    return view_of
