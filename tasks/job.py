"""The job that all tasks of an inspection share, and the result of a stage."""

from __future__ import annotations

from dataclasses import dataclass, fields
from datetime import datetime
from pathlib import Path

from facadelake.core.cache import StageCache, open_stage_cache
from facadelake.registry import Building
from schemas.vocabulary import ControlKind


@dataclass(frozen=True, kw_only=True)
class InspectionJob:
    """One inspection: which building and campaign, into which lake, with which control (None: the best available).

    ``code_sha256``: the version of all the code that the inspection runs.

    ``poses``: the file or folder that poses are imported from; None: they are computed.
    """

    building: Building
    campaign_id: str
    run_id: str
    started_at: datetime
    code_sha256: str
    lake: Path
    control: ControlKind | None = None
    detections: str | None = None
    poses: Path | None = None

    @property
    def cache(self) -> StageCache:
        """The cache of stage results."""
        return open_stage_cache(self.lake)


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """The result of a stage: its folder, whether it came from the cache, its cost and its counts.

    ``key`` identifies its inputs and code, ``content_sha256`` its content; later stages depend on the content only.
    """

    stage: str
    key: str
    folder: Path
    content_sha256: str
    hit: bool
    seconds: float
    peak_mib: float
    counts: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, kw_only=True)
class StageResults:
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
    coverage: StageResult

    def map_by_name(self) -> dict[str, StageResult | None]:
        """All results by field name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def list_results(self) -> list[StageResult]:
        """The results that exist, in the order they ran."""
        return [stage for stage in self.map_by_name().values() if stage is not None]
