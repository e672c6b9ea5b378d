"""The tables of all stages of an inspection, with the rows of tables buildings, campaigns and runs."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa

from facadelake.building import SURFACE_FILE, read_building
from facadelake.campaigns import find_earlier_campaigns
from facadelake.core.hashing import compute_key, hash_file
from facadelake.core.tables import read_table
from facadelake.detection import locate_model
from facadelake.georeferencing.campaign import list_references
from facadelake.lake import BuildingRecord, RunRecord, build_campaign_tables
from facadelake.registry import OnnxDetectorSetting
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob, StageResult, StageResults


def read_stage_tables(results: StageResults) -> dict[str, pa.Table]:
    """The tables of the stages, without the run's keys."""
    return {
        "photos": read_table("photos", results.photos.folder),
        "poses": read_table("poses", results.placed.folder),
        "georeference": read_table("georeference", results.placed.folder),
        "georeference_points": read_table("georeference_points", results.placed.folder),
        "placement_checks": read_table("placement_checks", results.placed.folder),
        "elements": read_table("elements", results.model.folder),
        "detections": read_table("detections", results.measured.folder),
        "observations": read_table("observations", results.merged.folder),
        "defects": read_table("defects", results.merged.folder),
        "merges": read_table("merges", results.merged.folder),
        "integrity_views": read_table("integrity_views", results.integrity.folder),
        "coverage": read_table("coverage", results.coverage.folder),
    }


def compute_fingerprint(results: StageResults) -> str:
    """Hash over the keys of all stages: inputs, settings and code of the campaign."""
    return compute_key({"stages": [stage.key for stage in results.list_results()]})


def assemble_campaign(job: InspectionJob, results: StageResults) -> tuple[RunRecord, dict[str, pa.Table]]:
    """The run's record and all tables but ``checks``, without the run's keys."""
    tables = read_stage_tables(results)
    building = read_building(results.model.folder)
    kind = building.surface_kind
    # Without a model, the as-built surface takes its place.
    model_path = results.model.folder / SURFACE_FILE if kind is SurfaceKind.AS_BUILT else job.building.locate_model()
    record = BuildingRecord(
        building_name=job.building.name,
        model_uri=job.building.model,
        model_sha256=hash_file(model_path),
        surface_kind=kind,
        map_crs=building.map_crs,
        vertical_datum=building.vertical_datum,
        georeference_level=building.georeference_level,
        georeference_remarks=building.remarks or None,
        origin_lon_deg=building.origin.lon_deg,
        origin_lat_deg=building.origin.lat_deg,
        origin_height_ellipsoidal_m=building.origin.height_ellipsoidal_m,
    )
    run = _run_record(job, results, tables["detections"])
    return run, build_campaign_tables(run, record, str(job.building.locate_photographs(job.campaign_id)), tables)


def _run_record(job: InspectionJob, results: StageResults, detections: pa.Table) -> RunRecord:
    detectors = detections.column("detector_sha256").unique().to_pylist()
    setting = job.building.detector
    if not detectors and isinstance(setting, OnnxDetectorSetting):  # it found nothing
        detectors = [hash_file(locate_model(setting))]
    fresh = [stage for stage in results.list_results() if not stage.hit]
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
        inputs_sha256=compute_fingerprint(results),
        code_sha256=job.code_sha256,
        detector_sha256=detectors[0] if detectors else "none",
        configuration=json.dumps(settings, sort_keys=True),
        stage_seconds=json.dumps({stage.stage: round(stage.seconds, 2) for stage in fresh}),
        stage_keys=json.dumps({stage.stage: stage.key for stage in results.list_results()}),
        stage_peak_mib=json.dumps({stage.stage: round(stage.peak_mib) for stage in fresh}),
    )


def list_earlier_references(job: InspectionJob, photos: StageResult) -> tuple[Path, ...]:
    """The references of the building's campaigns that were flown before this one, the first one first.

    It is no part of the stage that reads them: which campaigns there are is a question to the lake.
    """
    table = read_table("photos", photos.folder)
    earlier = find_earlier_campaigns(job.lake, job.building.id, job.campaign_id, table)
    return tuple(list_references(job.lake, job.building.id, earlier))
