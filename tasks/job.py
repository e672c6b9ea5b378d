"""What every task of one inspection is told."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from facadelake.core.cache import StageCache
from facadelake.registry import Building
from schemas.vocabulary import ControlKind


@dataclass(frozen=True, kw_only=True)
class InspectionJob:
    """One inspection: which building and campaign, into which lake, under which control (None: by what there is).

    ``poses``: the file or folder that poses are imported from; None: they are found anew.
    """

    building: Building
    campaign_id: str
    run_id: str
    started_at: datetime
    lake: Path
    control: ControlKind | None = None
    detections: str | None = None
    poses: Path | None = None

    @property
    def cache(self) -> StageCache:
        """Where stage results are kept."""
        return StageCache(root=self.lake / "cache")


@dataclass(frozen=True, kw_only=True)
class StageResult:
    """What a stage left behind: its folder, whether it was there before, what it cost and what it counted."""

    stage: str
    key: str
    folder: Path
    hit: bool
    seconds: float
    peak_mib: float
    counts: tuple[tuple[str, int], ...] = ()
