"""Flow: one campaign of one building, from photographs to a version of the tables."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

from prefect import flow

from facadelake.campaigns import AUTO, LATEST, describe_replaced_regrading, plan_inspection
from facadelake.core.code_version import compute_code_version, require_unchanged_code
from facadelake.core.errors import FacadelakeError, HistoryOutdatedError
from facadelake.lake import CommitResult
from facadelake.registry import CocoDetectorSetting, read_portfolio
from flows.running import HOOKS
from schemas.vocabulary import SurfaceKind
from tasks.commit import commit, publish
from tasks.detect import detect
from tasks.draw import draw
from tasks.georeference import georeference_block
from tasks.import_detections import import_detections
from tasks.import_poses import import_poses
from tasks.ingest import ingest, list_ingest_warnings
from tasks.job import InspectionJob, StageResult, StageResults
from tasks.load_model import load_model
from tasks.measure import measure
from tasks.measure_coverage import measure_coverage
from tasks.merge import merge_duplicates
from tasks.reconstruct import reconstruct_block
from tasks.record import list_earlier_references
from tasks.register import list_registration_warnings, register
from tasks.track import TrackedCampaigns, track
from tasks.validate import validate_tables
from tasks.verify_model import verify_model
from tasks.without_model import make_as_built_model, place_building

log = logging.getLogger("facadelake.flows")

_MODULE = "flows.inspect_building"  # __name__ is another one where Prefect loads this file by its path

_COMMIT_ATTEMPTS = 3


@dataclass(frozen=True, kw_only=True)
class InspectionResult:
    """Result of an inspection: its version in the lake and its release."""

    building_id: str
    campaign_id: str
    run_id: str
    version: int
    changed: bool
    release: Path
    stages: tuple[StageResult, ...]
    warnings: tuple[str, ...]


@flow(name="inspect-building", flow_run_name="{building_id} {campaign_id}", validate_parameters=True, **HOOKS)
def inspect_building(
    building_id: str,
    campaign_id: str = LATEST,
    portfolio: str = "data/portfolio.yaml",
    lake: str = "lake",
    georeference: str = AUTO,
    detections: str | None = None,
    poses: str | None = None,
) -> InspectionResult:
    """Inspect one campaign of a building, from photographs to tables and pictures.

    Args:
        building_id: the building's id in the portfolio.
        campaign_id: the campaign; 'latest' is the newest that has photographs.
        portfolio: path of the portfolio.
        lake: folder of the lake.
        georeference: the control, or 'auto'.
        detections: other detections than the portfolio's: an alternative's name, or a COCO file.
        poses: a file or folder of poses to import; the portfolio's are imported unless a control is named.

    Raises FacadelakeError where the campaign cannot be right, or where the code changed meanwhile; then nothing is
    committed.
    """
    started_at = datetime.now(UTC)
    plan = plan_inspection(
        read_portfolio(Path(portfolio)).get_building(building_id),
        campaign_id,
        georeference=georeference,
        detections=detections,
        poses=poses,
    )
    building, campaign, warnings = plan.building, plan.campaign_id, list(plan.warnings)
    job = InspectionJob(
        building=building,
        campaign_id=campaign,
        run_id=f"{started_at:%Y%m%dT%H%M%SZ}-{uuid4().hex[:8]}",
        started_at=started_at,
        code_sha256=compute_code_version(_MODULE).sha256,
        lake=Path(lake).resolve(),
        control=plan.control,
        detections=detections,
        poses=plan.poses,
    )
    bare = building.surface_kind is SurfaceKind.AS_BUILT  # its surface is made once the block stands
    if bare:
        photos = ingest(job, None)
        model = place_building(job, photos)
    else:
        model = load_model(job)
        photos = ingest(job, model)
    warnings += list_ingest_warnings(photos)
    # A file is imported first, so that an error in it is reported early; a model needs the poses.
    imported = import_detections(job, photos) if isinstance(building.detector, CocoDetectorSetting) else None
    block: StageResult | None = None
    if job.poses is not None:
        placed = import_poses(job, model, photos)
    else:
        block = reconstruct_block(job, photos)
        placed = georeference_block(job, model, photos, block, list_earlier_references(job, photos))
        if bare:
            model = make_as_built_model(job, model, block, placed)
    found = imported or detect(job, model, photos, placed)
    measured = measure(job, photos, found)
    registered = register(job, model, placed, measured, block)
    warnings += list_registration_warnings(job, registered)
    merged = merge_duplicates(job, model, photos, placed, registered, measured)
    integrity = verify_model(job, model, block, placed)
    coverage = measure_coverage(job, model, photos, placed, integrity)
    results = StageResults(
        model=model,
        photos=photos,
        detections=found,
        measured=measured,
        block=block,
        placed=placed,
        registered=registered,
        merged=merged,
        integrity=integrity,
        coverage=coverage,
    )
    tracked, checks, committed = _commit_tracked(job, results)
    warnings += tracked.warnings
    warnings += [describe_replaced_regrading(building, campaign, rules) for rules in committed.regraded_before]
    pictures: StageResult | None = None
    try:
        pictures = draw(job, results, checks, tracked)
    except (FacadelakeError, OSError) as error:  # the campaign is committed; a missing picture must not undo that
        warnings.append(f"no pictures: {error}")
        log.warning("%s", warnings[-1])
    release = publish(job, committed, pictures)
    return InspectionResult(
        building_id=building_id,
        campaign_id=campaign,
        run_id=job.run_id,
        version=committed.version,
        changed=committed.changed,
        release=release,
        stages=(*results.list_results(), tracked.stage, checks, *([pictures] if pictures else [])),
        warnings=tuple(warnings),
    )


def _commit_tracked(job: InspectionJob, results: StageResults) -> tuple[TrackedCampaigns, StageResult, CommitResult]:
    """Track and commit the campaign, anew where another process has committed one of the building meanwhile."""
    for attempts_left in reversed(range(_COMMIT_ATTEMPTS)):
        tracked = track(job, results)
        checks = validate_tables(job, results, tracked.stage)
        require_unchanged_code(_MODULE)
        try:
            return tracked, checks, commit(job, results, tracked, checks)
        except HistoryOutdatedError:
            if not attempts_left:
                raise
            log.warning(
                "another process has committed campaigns or tracks of %s meanwhile; tracking again", job.building.id
            )
    raise AssertionError("the last attempt commits or raises")
