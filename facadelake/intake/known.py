"""What is known beside an upload: where buildings are, and which photographs were received or inspected before."""

from __future__ import annotations

import logging
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, and_, select

from facadelake.core.errors import FacadelakeError
from facadelake.core.hashing import hash_file
from facadelake.intake.checks import BuildingPlace
from facadelake.intake.ledger import FILES, FOLDERS, UPLOADS
from facadelake.lake import has_lake, query
from facadelake.photos import find_photographs
from facadelake.registry import Building

log = logging.getLogger(__name__)

_ASKED_AT_ONCE = 500  # databases limit the number of values in a statement
_SHA256 = re.compile(r"[0-9a-f]{64}")
_PLACES = """
SELECT b.building_id AS building_id, any_value(b.origin_lon_deg) AS origin_lon_deg,
    any_value(b.origin_lat_deg) AS origin_lat_deg, any_value(p.lon_deg) AS lon_deg, any_value(p.lat_deg) AS lat_deg
FROM buildings b LEFT JOIN (
    SELECT building_id, median(lon_deg) AS lon_deg, median(lat_deg) AS lat_deg FROM poses GROUP BY building_id
) p USING (building_id)
GROUP BY b.building_id
"""


@dataclass(frozen=True, kw_only=True)
class ReceivedPhotographs:
    """Photographs that another upload has, by their hashes; ``in_source``: its folder is still in the source."""

    building_id: str
    folder: str
    campaign_id: str
    in_source: bool
    sha256: frozenset[str]


def find_places(buildings: Iterable[Building], lake: Path) -> dict[str, BuildingPlace]:
    """Where buildings are: by their photographs in the lake, else by their origin in it or in the portfolio."""
    places = {
        building.id: BuildingPlace(
            lon_deg=building.crs.origin.lon_deg,
            lat_deg=building.crs.origin.lat_deg,
            evidence="the origin in the portfolio",
        )
        for building in buildings
        if building.crs.origin is not None
    }
    for row in _query_rows(lake, _PLACES):
        if row["lon_deg"] is not None:
            evidence = "the photographs of its campaigns"
            place = BuildingPlace(lon_deg=row["lon_deg"], lat_deg=row["lat_deg"], evidence=evidence)
        else:
            evidence = "the origin of its model"
            place = BuildingPlace(lon_deg=row["origin_lon_deg"], lat_deg=row["origin_lat_deg"], evidence=evidence)
        places[row["building_id"]] = place
    return places


def find_inspected(sha256: Collection[str], lake: Path) -> dict[tuple[str, str], frozenset[str]]:
    """Which of these photographs the lake has, by building and campaign."""
    listed = ", ".join(f"'{one}'" for one in sorted(sha256) if _SHA256.fullmatch(one))
    if not listed:
        return {}
    found: dict[tuple[str, str], set[str]] = defaultdict(set)
    sql = f"SELECT building_id, campaign_id, sha256 FROM photos WHERE sha256 IN ({listed})"
    for row in _query_rows(lake, sql):
        found[row["building_id"], row["campaign_id"]].add(row["sha256"])
    return {key: frozenset(values) for key, values in found.items()}


def find_campaign_photographs(building_id: str, campaign_id: str, lake: Path) -> frozenset[str]:
    """The photographs of a campaign in the lake; empty where it has none."""
    named = {"building_id": building_id, "campaign_id": campaign_id}
    sql = "SELECT sha256 FROM photos WHERE building_id = $building_id AND campaign_id = $campaign_id"
    return frozenset(row["sha256"] for row in _query_rows(lake, sql, named))


def _query_rows(lake: Path, sql: str, parameters: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    try:
        return query(lake, sql, parameters).to_pylist() if has_lake(lake) else []
    except FacadelakeError as error:  # photographs arrive while the lake is moved, migrated or restored
        log.warning("the lake cannot be asked for buildings and photographs: %s", error)
        return []


def find_received(connection: Connection, sha256: Collection[str], own_id: int) -> list[ReceivedPhotographs]:
    """Which of these photographs other uploads have that were received."""
    joined = (
        select(FILES.c.sha256, FOLDERS.c.building_id, FOLDERS.c.name, UPLOADS.c.campaign_id, UPLOADS.c.in_source)
        .join_from(FILES, FOLDERS, FILES.c.folder_id == FOLDERS.c.id)
        .join(UPLOADS, UPLOADS.c.folder_id == FOLDERS.c.id)
        .where(and_(FILES.c.is_received, FILES.c.is_photograph, FOLDERS.c.id != own_id))
    )
    found: dict[tuple[str, str, str, bool], set[str]] = defaultdict(set)
    wanted = sorted(sha256)
    for begin in range(0, len(wanted), _ASKED_AT_ONCE):
        chunk = wanted[begin : begin + _ASKED_AT_ONCE]
        for row in connection.execute(joined.where(FILES.c.sha256.in_(chunk))):
            found[row.building_id, row.name, row.campaign_id or "", row.in_source].add(row.sha256)
    return [
        ReceivedPhotographs(
            building_id=building_id,
            folder=folder,
            campaign_id=campaign_id,
            in_source=in_source,
            sha256=frozenset(hashes),
        )
        for (building_id, folder, campaign_id, in_source), hashes in sorted(found.items())
    ]


def hash_photographs(folder: Path) -> frozenset[str]:
    """The hashes of the photographs of a campaign in place; empty where its folder is not there."""
    return frozenset(hash_file(path) for path in find_photographs(folder)) if folder.is_dir() else frozenset()
