"""Tables of a committed campaign, and the portfolio's model, checked against the one it was committed with."""

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

log = logging.getLogger(__name__)

_ORIGIN_DISTANCE_MAX_M = 0.001


def read_committed_tables(
    building: Building, campaign_id: str, names: Sequence[str], *, lake: Path, as_of: int | None = None
) -> dict[str, pa.Table]:
    """The campaign's rows of table ``buildings`` and of the tables ``names``, all of one version.

    Args:
        building: the registered building.
        campaign_id: its campaign.
        names: tables to be read.
        lake: path of the lake.
        as_of: an earlier version of the lake; None: the newest.

    Raises:
        StoreError: where there is no lake, or it does not contain the campaign.
    """
    if not has_lake(lake):
        raise StoreError(f"there is no lake at {lake}; run 'facadelake inspect {building.id} {campaign_id}' first")
    with report_progress("Reading the lake"):
        tables = read_tables(lake, ["buildings", *names], building_id=building.id, campaign_id=campaign_id, as_of=as_of)
    if not len(tables["buildings"]):
        at = "" if as_of is None else f" at version {as_of}"
        raise StoreError(
            f"the lake {lake} does not contain {building.id} {campaign_id}{at}; "
            f"run 'facadelake inspect {building.id} {campaign_id}' first, or see 'facadelake campaigns'"
        )
    return tables


def read_committed_model(building: Building, campaign_id: str, committed: Mapping[str, Any]) -> BuildingModel:
    """The portfolio's model; its origin must be that of ``committed``, the campaign's row of table ``buildings``.

    Raises InputDataError where it is not, or where the building has no model.
    """
    if building.surface_kind is SurfaceKind.AS_BUILT:
        raise InputDataError(
            f"building '{building.id}' has no model (model: as-built): the lake does not store its surface; "
            f"the figures are in the release that 'facadelake inspect {building.id} {campaign_id}' published"
        )
    path = building.locate_model()
    with report_progress(f"Reading {path.name}"):
        model = read_registered_model(building)
    names = ("origin_lon_deg", "origin_lat_deg", "origin_height_ellipsoidal_m")
    origin_geo = np.array([[committed[name] for name in names]], dtype=np.float64)
    distance_m = float(np.linalg.norm(model.origin.site_from_geo(origin_geo)))
    if distance_m > _ORIGIN_DISTANCE_MAX_M:
        raise InputDataError(
            f"the origin of the model {path} is {distance_m:.3f} m from that of the model with which {building.id} "
            f"{campaign_id} was committed (limit {_ORIGIN_DISTANCE_MAX_M} m); inspect the campaign again, or name the "
            "earlier model in the portfolio"
        )
    if hash_file(path) != committed["model_sha256"]:
        log.warning(
            "the model %s has changed since the campaign was committed; its edges may not fit the photographs", path
        )
    return model
