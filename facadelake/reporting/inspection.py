"""Input of reports and pictures: one campaign's tables, poses and building model, and the settings of pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from facadelake.building import BuildingModel
from facadelake.building.surface import Surface
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import SITE_AXES


@dataclass(frozen=True, kw_only=True, eq=False)
class Inspection:
    """One campaign: its tables (columns as in schemas/), its building model and its poses.

    ``photographs_root``: folder of the photographs. ``posed``: cameras with poses, by photo_id.
    ``placement_sigma_max_m``: largest permitted standard deviation of the campaign's position, metres. ``as_built``:
    surface of the campaign's tie points in site, which shows what hides the walls; None where there is none (imported
    poses, or pictures of a committed campaign, whose as-built surface is not in the lake).
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
    placement_checks: pa.Table
    detections: pa.Table
    observations: pa.Table
    defects: pa.Table
    merges: pa.Table
    integrity_views: pa.Table
    coverage: pa.Table
    checks: pa.Table
    placement_sigma_max_m: float = 0.5
    as_built: Surface | None = None

    def locate_photograph(self, photo_id: str) -> Path:
        """Path of a photograph; the file need not exist."""
        return self.photographs_root / photo_id

    @property
    def placement_sigma_m(self) -> float:
        """Largest standard deviation of the campaign's position, metres; 0 where table ``georeference`` is empty."""
        if not len(self.georeference):
            return 0.0
        return max(float(self.georeference.column(f"sigma_{axis}_m").to_pylist()[0]) for axis in SITE_AXES)

    @property
    def control(self) -> str:
        """Description of the georeferencing method; "unknown" where table ``georeference`` is empty."""
        return str(self.georeference.column("method")[0]) if len(self.georeference) else "unknown"

    @property
    def detectors(self) -> str:
        """Names of the detectors, from column ``detector``; "no detector" where there are no detections."""
        return ", ".join(sorted(set(self.detections.column("detector").to_pylist()))) or "no detector"


@dataclass(frozen=True, kw_only=True)
class PictureSettings:
    """Resolution and limits of pictures.

    ``cell_m``: size of an elevation's cell, metres; larger where a facade would have more than ``max_cells``.
    ``visibility_step``: spacing, in cells, of the grid on which photographs are selected.
    ``visibility_tolerance_m``: a surface up to this distance in front of a cell does not hide it.
    ``max_incidence_deg``: largest angle between viewing ray and surface normal for a photograph to be used.
    ``feather_m``: width of the transition between two photographs.
    ``clip_m``: distance of an elevation's view plane from the foremost wall of its facade; objects nearer to the
    viewer are not drawn.
    ``min_facade_share``: facades with a smaller share of the walls' area are drawn only if they carry a defect.
    ``thumbnail_px``: width of a defect's crop. ``overlay_width_px``: width of an overlay.
    ``card_observations``: largest number of observations on a card.
    ``report_cards``, ``report_observations``, ``report_overlays``: largest numbers in a report of cards (of the most
    severe defects), of observations on a card, and of overlays. They limit the time of a report: its cards read at
    most the product of the first two in photographs.
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
    report_cards: int = 100
    report_observations: int = 7
    report_overlays: int = 2

    def __post_init__(self) -> None:
        if not (0.001 <= self.cell_m <= 1.0 and self.max_cells >= 10_000 and self.visibility_step >= 1):
            raise InputDataError(
                f"invalid picture settings: cell_m {self.cell_m}, max_cells {self.max_cells}, visibility_step "
                f"{self.visibility_step}; permitted are 0.001 to 1 m, at least 10000 and at least 1"
            )
