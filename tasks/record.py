"""The tables of all stages of one inspection together, with the rows that tell of the whole campaign."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime

import pyarrow as pa

from facadelake.campaign import BuildingRecord, RunRecord, campaign_tables
from facadelake.core.cache import file_hash, key_of
from facadelake.core.tables import read_table
from facadelake.detect.chosen import model_file
from facadelake.geobim.model import SURFACE_FILE, read_building
from facadelake.registry import OnnxDetectorSetting
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob, StageResult


@dataclass(frozen=True, kw_only=True)
class StageFolders:
    """The results of the stages whose tables go into the lake; ``block`` is None where poses were imported."""

    model: StageResult
    photos: StageResult
    block: StageResult | None
    placed: StageResult
    detections: StageResult
    measured: StageResult
    registered: StageResult
    merged: StageResult
    integrity: StageResult

    def stages(self) -> Sequence[StageResult]:
        """All of them, in the order they ran; with imported poses there is no block."""
        stages = [getattr(self, field.name) for field in fields(self)]
        return [stage for stage in stages if stage is not None]

    def keys(self) -> list[str]:
        """Their cache keys: together they are the fingerprint of inputs, settings and code."""
        return [stage.key for stage in self.stages()]


def stage_tables(folders: StageFolders) -> dict[str, pa.Table]:
    """The tables of the stages, without the run's keys."""
    return {
        "photos": read_table("photos", folders.photos.folder),
        "poses": read_table("poses", folders.placed.folder),
        "georeference": read_table("georeference", folders.placed.folder),
        "georeference_points": read_table("georeference_points", folders.placed.folder),
        "elements": read_table("elements", folders.model.folder),
        "detections": read_table("detections", folders.measured.folder),
        "observations": read_table("observations", folders.merged.folder),
        "defects": read_table("defects", folders.merged.folder),
        "merges": read_table("merges", folders.merged.folder),
        "integrity_views": read_table("integrity_views", folders.integrity.folder),
    }


def fingerprint(folders: StageFolders) -> str:
    """Hash over all inputs and settings of the campaign."""
    return key_of({"stages": folders.keys()})


def whole_campaign(job: InspectionJob, folders: StageFolders) -> tuple[RunRecord, dict[str, pa.Table]]:
    """The run's record and all tables but ``checks``, without the run's keys."""
    tables = stage_tables(folders)
    building = read_building(folders.model.folder)
    kind = building.surface_kind
    # Without a model, the surface that the campaign itself made stands for it.
    model_path = folders.model.folder / SURFACE_FILE if kind is SurfaceKind.AS_BUILT else job.building.model_path()
    record = BuildingRecord(
        building_name=job.building.name,
        model_uri=job.building.model,
        model_sha256=file_hash(model_path),
        surface_kind=kind,
        map_crs=building.map_crs,
        vertical_datum=building.vertical_datum,
        georeference_level=building.georeference_level,
        georeference_remarks=building.remarks or None,
        origin_lon_deg=building.origin.lon_deg,
        origin_lat_deg=building.origin.lat_deg,
        origin_height_ellipsoidal_m=building.origin.height_ellipsoidal_m,
    )
    run = _run_record(job, folders, tables["detections"])
    return run, campaign_tables(run, record, str(job.building.photographs_of(job.campaign_id)), tables)


def _run_record(job: InspectionJob, folders: StageFolders, detections: pa.Table) -> RunRecord:
    detectors = detections.column("detector_sha256").unique().to_pylist()
    setting = job.building.detector
    if not detectors and isinstance(setting, OnnxDetectorSetting):  # it looked and found nothing
        detectors = [file_hash(model_file(setting))]
    fresh = [stage for stage in folders.stages() if not stage.hit]
    settings = {
        "control": job.control or "auto",
        "detections": job.detections or "registry",
        "poses": str(job.poses) if job.poses else "found",
        "building": job.building.model_dump(mode="json"),
    }
    return RunRecord(
        building_id=job.building.id,
        campaign_id=job.campaign_id,
        run_id=job.run_id,
        started_at=job.started_at,
        finished_at=datetime.now(UTC),
        inputs_sha256=fingerprint(folders),
        detector_sha256=detectors[0] if detectors else "none",
        configuration=json.dumps(settings, sort_keys=True),
        stage_seconds=json.dumps({stage.stage: round(stage.seconds, 2) for stage in fresh}),
        stage_peak_mib=json.dumps({stage.stage: round(stage.peak_mib) for stage in fresh}),
    )
