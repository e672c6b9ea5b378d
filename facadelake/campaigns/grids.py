"""Which transformation grids a registered building needs and this machine lacks, before any model is opened."""

from __future__ import annotations

import mmap
import re
from dataclasses import dataclass
from pathlib import Path

from facadelake.core.errors import FacadelakeError, GeoreferenceError
from facadelake.core.geodesy import find_operation
from facadelake.core.proj.crs import ELLIPSOIDAL, GEO, combine_crs, promote_to_3d
from facadelake.core.proj.operations import require_best
from facadelake.georeferencing.gcp import read_surveyed_points
from facadelake.registry import Building
from schemas.vocabulary import SurfaceKind

_PROJECTED_CRS = re.compile(rb"IFCPROJECTEDCRS\s*\(\s*'(EPSG:\d+)'", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class GridCheck:
    """The CRSs that were looked at, and what is missing for them (empty: nothing)."""

    crs: tuple[str, ...]
    problems: tuple[str, ...]


def check_grids(building: Building) -> GridCheck:
    """Look for the grids of the best operations of the building's model and control points to EPSG:4979.

    The place is the site's origin in the portfolio, else the middle of the CRS's area of use. A CRS that only an IFC's
    property set or WKT states, and vertical datums of the IFC, are seen when the model is loaded.
    """
    stated = {_find_model_crs(building), *_list_control_crs(building)} - {""}
    problems = []
    for crs in sorted(stated):
        try:
            _require_grids(crs, building)
        except GeoreferenceError as error:
            problems.append(str(error))
    return GridCheck(crs=tuple(sorted(stated)), problems=tuple(dict.fromkeys(problems)))


def _find_model_crs(building: Building) -> str:
    """The model's CRS with its heights, by the portfolio or IfcProjectedCRS; empty where neither states a code."""
    horizontal = building.crs.map or ""
    path = Path(building.model)
    if not horizontal and building.surface_kind is SurfaceKind.IFC and path.is_file() and path.stat().st_size:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            found = _PROJECTED_CRS.search(content)
            horizontal = found[1].decode().upper() if found else ""
    vertical = building.crs.vertical or ELLIPSOIDAL
    return combine_crs(horizontal, vertical) if horizontal and vertical.upper().startswith("EPSG:") else horizontal


def _list_control_crs(building: Building) -> set[str]:
    """The CRSs in the headers of control and check points; the inspection names files that cannot be read."""
    found = set()
    for campaign_id in building.list_campaigns():
        for path in (building.locate_control_points(campaign_id), building.locate_check_points(campaign_id)):
            try:
                found |= {read_surveyed_points(path).crs} if path is not None else set()
            except FacadelakeError:
                continue
    return found


def _require_grids(crs: str, building: Building) -> None:
    """Raise GeoreferenceError where the best operation from ``crs`` lacks its grid and is not replaced by the next."""
    origin, parsed = building.crs.origin, promote_to_3d(crs)
    areas = [part.area_of_use for part in parsed.sub_crs_list or [parsed]]
    known = [area for area in areas if area is not None and area.west < area.east]
    if origin is not None:
        place = {"lon_deg": origin.lon_deg, "lat_deg": origin.lat_deg}
    elif known:
        area = min(known, key=lambda one: one.north - one.south)  # that of a vertical datum is mostly one country
        place = {"lon_deg": (area.west + area.east) / 2, "lat_deg": (area.south + area.north) / 2}
    else:
        return
    require_best(find_operation(crs, GEO, **place), building.crs.accept_operation_accuracy_m)
