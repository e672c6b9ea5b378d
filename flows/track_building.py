"""Flow: the history of a building anew, from its campaigns in the lake."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

from prefect import flow

from facadelake.campaigns import LATEST, resolve_campaign
from facadelake.core.code_version import compute_code_version, require_unchanged_code
from facadelake.core.errors import InputDataError
from facadelake.registry import read_portfolio
from flows.running import HOOKS
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob, StageResult
from tasks.load_model import load_model
from tasks.track import commit_tracks, track_committed

_MODULE = "flows.track_building"  # __name__ is another one where Prefect loads this file by its path


@dataclass(frozen=True, kw_only=True)
class TrackingResult:
    """Result of tracking: the lake's version that has it, None where nothing has changed."""

    building_id: str
    version: int | None
    stage: StageResult
    warnings: tuple[str, ...]


@flow(name="track-building", flow_run_name="{building_id}", validate_parameters=True, **HOOKS)
def track_building(building_id: str, portfolio: str = "data/portfolio.yaml", lake: str = "lake") -> TrackingResult:
    """Follow the defects of a building through all its campaigns in the lake; ids of known tracks stay.

    Args:
        building_id: the building's id in the portfolio.
        portfolio: path of the portfolio.
        lake: folder of the lake.

    Raises FacadelakeError where the lake has no campaign of the building, or where it has no model.
    """
    building = read_portfolio(Path(portfolio)).get_building(building_id)
    if building.surface_kind is SurfaceKind.AS_BUILT:
        raise InputDataError(
            f"building '{building_id}' has no model (model: as-built): its surface is made with an inspection, which "
            f"tracks all campaigns; run 'facadelake inspect {building_id}'"
        )
    started_at = datetime.now(UTC)
    job = InspectionJob(
        building=building,
        campaign_id=resolve_campaign(building, LATEST),
        run_id=f"{started_at:%Y%m%dT%H%M%SZ}-{uuid4().hex[:8]}",
        started_at=started_at,
        code_sha256=compute_code_version(_MODULE).sha256,
        lake=Path(lake).resolve(),
    )
    tracked = track_committed(job, load_model(job))
    require_unchanged_code(_MODULE)
    return TrackingResult(
        building_id=building_id,
        version=commit_tracks(job, tracked),
        stage=tracked.stage,
        warnings=tracked.warnings,
    )
