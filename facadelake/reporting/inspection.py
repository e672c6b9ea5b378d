"""What the pictures are made of: one campaign's tables, poses and building model, and the settings of the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from facadelake.building import BuildingModel
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError


@dataclass(frozen=True, kw_only=True, eq=False)
class Inspection:
    """One campaign: stage tables as schemas/ has them, ``posed`` by photo_id, photographs in ``photographs_root``.

    ``placement_sigma_max_m`` is what the building wants the campaign's place known to.
    """

    building_name: str
    campaign_id: str
    photographs_root: Path
    building: BuildingModel
    posed: Mapping[str, PosedCamera]
    photos: pa.Table
    poses: pa.Table
    georeference: pa.Table
    georeference_points: pa.Table
    detections: pa.Table
    observations: pa.Table
    defects: pa.Table
    merges: pa.Table
    integrity_views: pa.Table
    checks: pa.Table
    placement_sigma_max_m: float = 0.5

    def locate_photograph(self, photo_id: str) -> Path:
        """Path of a photograph."""
        return self.photographs_root / photo_id

    @property
    def control(self) -> str:
        """What placed the campaign on the globe, in words; "unknown" where the passport is empty."""
        return str(self.georeference.column("method")[0]) if len(self.georeference) else "unknown"

    @property
    def detectors(self) -> str:
        """Who found the detections, as column ``detector`` has it; "nobody" where there are none."""
        return ", ".join(sorted(set(self.detections.column("detector").to_pylist()))) or "nobody"


@dataclass(frozen=True, kw_only=True)
class PictureSettings:
    """How fine and how large the pictures are.

    ``cell_m``: side of an elevation's cell; made larger where a facade would have more than ``max_cells``.
    ``visibility_step``: which photograph is best is decided every so many cells.
    ``visibility_tolerance_m``: a surface this much in front of a cell does not hide it.
    ``feather_m``: width of the transition between two photographs.
    ``clip_m``: an elevation looks from this far in front of its facade; what is nearer to the viewer is cut away.
    ``min_facade_share``: facades with less of the walls' area are left out unless they carry a defect.
    ``card_observations``: at most so many sightings stand on a card, the best ones.
    ``report_cards``, ``report_observations``, ``report_overlays``: the report has cards of so many defects, the worst,
    with so many sightings each, and overlays of so many photographs. That bounds its time: cards read at most the
    product of the first two in photographs.
    """

    cell_m: float = 0.015
    max_cells: int = 6_000_000
    visibility_step: int = 4
    visibility_tolerance_m: float = 0.08
    max_incidence_deg: float = 78.0
    feather_m: float = 0.35
    clip_m: float = 2.5
    min_facade_share: float = 0.02
    thumbnail_px: int = 200
    overlay_width_px: int = 1600
    card_observations: int = 49
    report_cards: int = 8
    report_observations: int = 7
    report_overlays: int = 2

    def __post_init__(self) -> None:
        if not (0.001 <= self.cell_m <= 1.0 and self.max_cells >= 10_000 and self.visibility_step >= 1):
            raise InputDataError(
                f"picture settings cell_m {self.cell_m}, max_cells {self.max_cells}, visibility_step "
                f"{self.visibility_step} cannot be used; want 0.001 to 1 m, at least 10000, at least 1"
            )
