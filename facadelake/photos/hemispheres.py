"""Hemispheres of positions whose EXIF does not state them, by what else is known of the place."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx2
from facadelake.photos.coordinate_mistakes import LonLat
from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.plausibility import FAR_M, east_north_from_lon_lat
from facadelake.photos.position_prior import check_position


@dataclass(frozen=True, kw_only=True)
class ResolvedExif:
    """EXIF with a hemisphere where it could be determined, and the warnings that say how."""

    exif: ExifMetadata
    warnings: tuple[str, ...] = ()


def resolve_hemispheres(
    exifs: Sequence[ExifMetadata],
    drones: Sequence[DroneMetadata | None],
    distance_to_model_m: Callable[[Float64Nx2], Float64N] | None,
) -> list[ResolvedExif]:
    """EXIF of all photographs of a campaign, with hemispheres that are not stated where only one is possible.

    Evidence is the position of the building, else that in XMP, else that of the other photographs: exactly one of the
    possible positions must be near it. Without such evidence the position stays unknown.

    Args:
        exifs: EXIF of the photographs.
        drones: XMP of the photographs; None where no drone wrote any.
        distance_to_model_m: as in ``plausibility.check_priors``.

    Returns:
        EXIF of each photograph.
    """
    known = [
        place
        for exif, drone in zip(exifs, drones, strict=True)
        for place in [get_drone_place(drone) or get_place(exif.lon_deg, exif.lat_deg)]
        if place
    ]
    out = []
    for exif, drone in zip(exifs, drones, strict=True):
        candidates = _list_candidates(exif)
        if not candidates:
            out.append(ResolvedExif(exif=exif))
            continue
        evidence: list[tuple[str, Callable[[Float64Nx2], Float64N]]] = []
        if distance_to_model_m:
            evidence.append(("the position of the building", distance_to_model_m))
        own = get_drone_place(drone)
        if own:
            evidence.append(("the position in XMP", build_distance(own)))
        if known:
            centre: LonLat = (float(np.median([lon for lon, _ in known])), float(np.median([lat for _, lat in known])))
            evidence.append(("the positions of the other photographs", build_distance(centre)))
        out.append(_resolve(exif, candidates, evidence))
    return out


def _resolve(
    exif: ExifMetadata,
    candidates: list[LonLat],
    evidence: list[tuple[str, Callable[[Float64Nx2], Float64N]]],
) -> ResolvedExif:
    for name, distance_m in evidence:
        near = np.flatnonzero(distance_m(np.array(candidates)) <= FAR_M)
        if len(near) == 1:
            lon_deg, lat_deg = candidates[near[0]]
            letters = f"{'S' if lat_deg < 0 else 'N'}, {'W' if lon_deg < 0 else 'E'}"
            warning = f"{exif.position_problem}; taken as {letters} by {name}"
            resolved = replace(
                exif,
                lat_deg=lat_deg,
                lon_deg=lon_deg,
                unsigned_lat_deg=math.nan,
                unsigned_lon_deg=math.nan,
                position_problem="",
            )
            return ResolvedExif(exif=resolved, warnings=(warning,))
    tried = " or ".join(name for name, _ in evidence)
    outcome = f"{tried} does not decide it" if tried else "nothing else decides it"
    problem = f"{exif.position_problem}, and {outcome}; write the reference into EXIF"
    return ResolvedExif(exif=replace(exif, position_problem=problem), warnings=(f"EXIF position not used: {problem}",))


def _list_candidates(exif: ExifMetadata) -> list[LonLat]:
    """The possible positions (lon, lat) where a hemisphere is unknown; empty where none is, or there is no position."""
    if math.isnan(exif.unsigned_lat_deg) and math.isnan(exif.unsigned_lon_deg):
        return []
    lats = [exif.lat_deg] if math.isfinite(exif.lat_deg) else [exif.unsigned_lat_deg, -exif.unsigned_lat_deg]
    lons = [exif.lon_deg] if math.isfinite(exif.lon_deg) else [exif.unsigned_lon_deg, -exif.unsigned_lon_deg]
    return [(lon, lat) for lon, lat in product(lons, lats) if not check_position(lon, lat)]


def get_place(lon_deg: float, lat_deg: float) -> LonLat | None:
    """The position (lon, lat); None where the coordinates are none."""
    return None if check_position(lon_deg, lat_deg) else (lon_deg, lat_deg)


def get_drone_place(drone: DroneMetadata | None) -> LonLat | None:
    """The position (lon, lat) in XMP; None where there is none."""
    if drone is None or drone.gps_status.lower() == "invalid":
        return None
    return get_place(drone.lon_deg, drone.lat_deg)


def build_distance(place: LonLat) -> Callable[[Float64Nx2], Float64N]:
    """The function that returns the distance (n,) in metres of positions (n, 2: lon_deg, lat_deg) from ``place``."""

    def distance_m(lon_lat_deg: Float64Nx2) -> Float64N:
        metres: Float64N = np.hypot(*east_north_from_lon_lat(lon_lat_deg, np.array(place)).T)
        return metres

    return distance_m
