"""Positions of XMP and EXIF that cannot both be: the one that fits the place of the campaign is used, or neither."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx2
from facadelake.photos.coordinate_mistakes import LonLat, measure_apart_m, name_mistake
from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.hemispheres import build_distance, get_drone_place, get_place
from facadelake.photos.plausibility import FAR_M
from schemas.vocabulary import PositionSource

# A position is right where evidence lies nearer to it than this share of its distance from the other one.
_NEAR_SHARE = 0.25


@dataclass(frozen=True, kw_only=True)
class ResolvedStatements:
    """Metadata of a photograph, with ``position_problem`` in those whose position cannot be, and the warning."""

    exif: ExifMetadata
    drone: DroneMetadata | None
    warnings: tuple[str, ...] = ()


def resolve_contradictions(
    exifs: Sequence[ExifMetadata],
    drones: Sequence[DroneMetadata | None],
    distance_to_model_m: Callable[[Float64Nx2], Float64N] | None,
    counts: PositionSource | None,
) -> list[ResolvedStatements]:
    """Metadata of all photographs of a campaign, where XMP and EXIF differ by a mistake of writing, or by kilometres.

    No sigma covers such a difference. The position that lies near the building, else near the other photographs, is
    used; neither is used where that does not decide and the portfolio does not say which one counts.

    Args:
        exifs: EXIF of the photographs, with hemispheres.
        drones: XMP of the photographs; None where no drone wrote any.
        distance_to_model_m: as in ``plausibility.check_priors``.
        counts: XMP or EXIF, as the portfolio says; None where it says nothing.

    Returns:
        The metadata of each photograph.
    """
    places = [
        (get_drone_place(drone), get_place(exif.lon_deg, exif.lat_deg) if not exif.position_problem else None)
        for exif, drone in zip(exifs, drones, strict=True)
    ]
    contradict = [bool(xmp and exif and _cannot_both_be(xmp, exif)) for xmp, exif in places]
    known = [
        place
        for (xmp, exif), contradicts in zip(places, contradict, strict=True)
        if not contradicts and (place := xmp or exif)
    ]
    evidence: list[tuple[str, Callable[[Float64Nx2], Float64N]]] = []
    if distance_to_model_m:
        evidence.append(("the building", distance_to_model_m))
    if known:
        centre: LonLat = (float(np.median([lon for lon, _ in known])), float(np.median([lat for _, lat in known])))
        evidence.append(("the other photographs", build_distance(centre)))
    return [
        _resolve(exif, drone, xmp_place, exif_place, evidence, counts)
        if contradicts and drone and xmp_place and exif_place
        else ResolvedStatements(exif=exif, drone=drone)
        for exif, drone, (xmp_place, exif_place), contradicts in zip(exifs, drones, places, contradict, strict=True)
    ]


def _cannot_both_be(xmp: LonLat, exif: LonLat) -> bool:
    return measure_apart_m(xmp, exif) > FAR_M or bool(name_mistake(xmp, exif))


def _resolve(
    exif: ExifMetadata,
    drone: DroneMetadata,
    xmp_place: LonLat,
    exif_place: LonLat,
    evidence: Sequence[tuple[str, Callable[[Float64Nx2], Float64N]]],
    counts: PositionSource | None,
) -> ResolvedStatements:
    """The metadata of a photograph whose XMP and EXIF contradict each other.

    Args:
        exif: EXIF of the photograph.
        drone: its XMP.
        xmp_place: position (lon, lat) in XMP.
        exif_place: position (lon, lat) in EXIF.
        evidence: what else is known of the place, the best first: its name, and the distances of positions from it.
        counts: XMP or EXIF, as the portfolio says; None where it says nothing.

    Returns:
        the metadata, of which one or both have no valid position.
    """
    apart_m = measure_apart_m(xmp_place, exif_place)
    mistake = name_mistake(xmp_place, exif_place)
    how = f" (as with {mistake})" if mistake else ""
    difference = (
        f"XMP lat {xmp_place[1]:.8f}, lon {xmp_place[0]:.8f} and EXIF lat {exif_place[1]:.8f}, lon "
        f"{exif_place[0]:.8f} are {_format_distance(apart_m)} apart{how}"
    )
    for name, distance_m in evidence:
        metres = distance_m(np.array([xmp_place, exif_place]))
        near = np.flatnonzero(metres <= min(FAR_M, _NEAR_SHARE * apart_m))
        if len(near) != 1:
            continue
        used, left_out = ("XMP", "EXIF") if near[0] == 0 else ("EXIF", "XMP")
        problem = f"its position is {_format_distance(metres[1 - near[0]])} from {name}"
        warning = f"{difference}; {used} is used, which lies near {name}: correct the position in {left_out}"
        if near[0] == 0:
            return ResolvedStatements(
                exif=replace(exif, position_problem=problem, altitude_m=exif.altitude_m if mistake else math.nan),
                drone=drone,
                warnings=(warning,),
            )
        return ResolvedStatements(
            exif=exif,
            drone=replace(drone if mistake else _forget_fix(drone), position_problem=problem),
            warnings=(warning,),
        )
    if counts is not None or apart_m <= FAR_M:
        return ResolvedStatements(exif=exif, drone=drone)
    remedy = "correct them, or set 'positions: exif' or 'positions: xmp' in the portfolio"
    warning = f"{difference}, and nothing decides which one is right; neither is used: {remedy}"
    problem = "its position is contradicted"
    return ResolvedStatements(
        exif=replace(exif, position_problem=f"{problem} by XMP, and nothing decides which one is right; {remedy}"),
        drone=replace(drone, position_problem=f"{problem} by EXIF"),
        warnings=(warning,),
    )


def _forget_fix(drone: DroneMetadata) -> DroneMetadata:
    """The metadata without height and accuracy, which are those of a fix at another place."""
    return replace(
        drone,
        rtk_flag=None,
        absolute_altitude_m=math.nan,
        stated_sigma_horizontal_m=math.nan,
        stated_sigma_vertical_m=math.nan,
    )


def _format_distance(metres: float) -> str:
    return f"{metres / 1000:,.0f} km" if metres > FAR_M else f"{metres:.0f} m"
