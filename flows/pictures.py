"""Draw pictures of a committed campaign; the lake is read, never changed."""

from __future__ import annotations

from pathlib import Path

from facadelake.building.surface.raycasting import Surface
from facadelake.core.pose_table import posed_cameras
from facadelake.core.tables import stage_schema
from facadelake.registry import Building
from facadelake.reporting.inspection import Inspection, PictureSettings
from facadelake.reporting.on_request import (
    Drawn,
    draw_wanted,
    everything,
    wanted_by_name,
    what_the_report_shows,
)
from flows.committed import committed_model, committed_tables

_TABLES = (
    "photos", "poses", "georeference", "georeference_points", "detections", "observations", "defects", "merges",
    "integrity_views", "checks",
)  # fmt: skip


def draw_pictures(
    building: Building,
    campaign_id: str,
    *,
    lake: Path,
    folder: Path,
    defects: tuple[str, ...] = (),
    facades: tuple[str, ...] = (),
    photos: tuple[str, ...] = (),
    all_of_them: bool = False,
) -> Drawn:
    """Pictures of a committed campaign into ``folder``; of what the report shows where nothing is named.

    Tables come from the lake, photographs and the building's model from the registry. Raises StoreError where the
    lake does not hold the campaign, InputDataError for a name there is not or a model that is not the campaign's.
    """
    inspection = _inspection(building, campaign_id, lake)
    surface = Surface(inspection.building)
    settings = PictureSettings()
    if all_of_them:
        wanted = everything(inspection, surface, settings)
    elif defects or facades or photos:
        wanted = wanted_by_name(inspection, surface, defects=defects, facades=facades, photos=photos, settings=settings)
    else:
        wanted = what_the_report_shows(inspection, surface, settings)
    return draw_wanted(inspection, surface, wanted, folder, settings)


def _inspection(building: Building, campaign_id: str, lake: Path) -> Inspection:
    held = committed_tables(building, campaign_id, _TABLES, lake=lake)
    tables = {name: held[name].select(stage_schema(name).names) for name in _TABLES}
    return Inspection(
        building_name=building.name,
        campaign_id=campaign_id,
        photographs_root=building.photographs_of(campaign_id),
        building=committed_model(building, campaign_id, held["buildings"].to_pylist()[0]),
        posed=posed_cameras(tables["poses"]),
        placement_sigma_max_m=building.tolerances.placement_sigma_max_m,
        **tables,
    )
