"""A committed campaign for those who look at it again: its tables, and the registry's model as it was then."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from facadelake.building import BuildingModel, read_registered_model
from facadelake.core.errors import InputDataError, StoreError
from facadelake.core.hashing import hash_file
from facadelake.core.progress import report_progress
from facadelake.lake import has_lake, read_tables
from facadelake.registry import Building
from schemas.vocabulary import SurfaceKind

log = logging.getLogger("facadelake.flows")

_SAME_PLACE_M = 0.001


def read_committed_tables(
    building: Building, campaign_id: str, names: Sequence[str], *, lake: Path
) -> dict[str, pa.Table]:
    """The campaign's rows of table ``buildings`` and of those in ``names``, all of one version.

    Raises StoreError where the lake does not hold the campaign.
    """
    if not has_lake(lake):
        raise StoreError(f"there is no lake at {lake}; run 'facadelake inspect {building.id} {campaign_id}' first")
    with report_progress("Reading the lake"):
        tables = read_tables(lake, ["buildings", *names], building_id=building.id, campaign_id=campaign_id)
    if not len(tables["buildings"]):
        raise StoreError(
            f"the lake {lake} does not hold {building.id} {campaign_id}; "
            f"run 'facadelake inspect {building.id} {campaign_id}' first, or see 'facadelake campaigns'"
        )
    return tables


def read_committed_model(building: Building, campaign_id: str, committed: Mapping[str, Any]) -> BuildingModel:
    """The registry's model, which must stand where it stood in ``committed``, the campaign's row of table buildings.

    Raises InputDataError where it does not, or where the building has no model.
    """
    if building.surface_kind is SurfaceKind.AS_BUILT:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built): its surface is the run's own and is not kept in "
            f"the lake; its pictures are in the release that 'facadelake inspect {building.id} {campaign_id}' published"
        )
    path = building.locate_model()
    with report_progress(f"Reading {path.name}"):
        model = read_registered_model(building)
    names = ("origin_lon_deg", "origin_lat_deg", "origin_height_ellipsoidal_m")
    then = np.array([[committed[name] for name in names]], dtype=np.float64)
    off_m = float(np.linalg.norm(model.origin.site_from_geo(then)))
    if off_m > _SAME_PLACE_M:
        raise InputDataError(
            f"the model {path} places the site {off_m:.3f} m from where it was when {building.id} {campaign_id} was "
            f"committed (limit {_SAME_PLACE_M} m), so nothing would fit; inspect the campaign again, or give the "
            "registry the model of then"
        )
    if hash_file(path) != committed["model_sha256"]:
        log.warning("the model %s was changed since the campaign was committed; edges may not fit", path)
    return model
