"""Draw pictures of a committed campaign; the lake is read, never changed."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from facadelake.cache import file_hash
from facadelake.errors import InputDataError, StoreError
from facadelake.geobim.model import BuildingModel
from facadelake.geobim.surface import Surface
from facadelake.lake.connect import exists
from facadelake.lake.read import read_tables
from facadelake.pictures.inspection import Inspection, PictureSettings
from facadelake.pictures.on_request import (
    Drawn,
    draw_wanted,
    everything,
    wanted_by_name,
    what_the_report_shows,
)
from facadelake.posed import posed_cameras
from facadelake.progress import stage_progress
from facadelake.registry import Building
from facadelake.tables import stage_schema
from schemas.vocabulary import SurfaceKind
from tasks.load_model import read_model

log = logging.getLogger("facadelake.flows")

_TABLES = (
    "photos", "poses", "georeference", "georeference_points", "detections", "observations", "defects", "merges",
    "integrity_views", "checks",
)  # fmt: skip
_SAME_PLACE_M = 0.001


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
    if not exists(lake):
        raise StoreError(f"there is no lake at {lake}; run 'facadelake inspect {building.id} {campaign_id}' first")
    with stage_progress("Reading the lake"):
        held = read_tables(lake, ["buildings", *_TABLES], building_id=building.id, campaign_id=campaign_id)
    if not len(held["buildings"]):
        raise StoreError(
            f"the lake {lake} does not hold {building.id} {campaign_id}; "
            f"run 'facadelake inspect {building.id} {campaign_id}' first, or see 'facadelake campaigns'"
        )
    tables = {name: held[name].select(stage_schema(name).names) for name in _TABLES}
    return Inspection(
        building_name=building.name,
        campaign_id=campaign_id,
        photographs_root=building.photographs_of(campaign_id),
        building=_model(building, campaign_id, held["buildings"].to_pylist()[0]),
        posed=posed_cameras(tables["poses"]),
        placement_sigma_max_m=building.tolerances.placement_sigma_max_m,
        **tables,
    )


def _model(building: Building, campaign_id: str, committed: dict[str, object]) -> BuildingModel:
    """The registry's model, which must stand where it stood when the campaign was committed."""
    if building.surface_kind is SurfaceKind.AS_BUILT:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built): its surface is the run's own and is not kept in "
            f"the lake; its pictures are in the release that 'facadelake inspect {building.id} {campaign_id}' published"
        )
    path = building.model_path()
    with stage_progress(f"Reading {path.name}"):
        model = read_model(building)
    names = ("origin_lon_deg", "origin_lat_deg", "origin_height_ellipsoidal_m")
    then = np.array([[committed[name] for name in names]], dtype=np.float64)
    off = float(np.linalg.norm(model.origin.site_from_geo(then)))
    if off > _SAME_PLACE_M:
        raise InputDataError(
            f"the model {path} places the site {off:.3f} m from where it was when {building.id} {campaign_id} was "
            f"committed (limit {_SAME_PLACE_M} m), so nothing would fit; inspect the campaign again, or give the "
            "registry the model of then"
        )
    if file_hash(path) != committed["model_sha256"]:
        log.warning("the model %s was changed since the campaign was committed; edges may not fit", path)
    return model
