"""Position priors of a photograph, each with its sigma, its height datum and its evidence.

XMP is used before EXIF, unless the portfolio says which of them counts. Where the two disagree, both are told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import find_operation, transform
from facadelake.core.proj.crs import GEO
from facadelake.core.proj.operations import METRES_PER_DEGREE
from facadelake.photos.coordinate_mistakes import measure_apart_m, name_mistake
from facadelake.photos.drone_xmp import RTK_FIXED, DroneMetadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.position_sigma import (
    SIGMA_DRONE,
    SIGMA_HANDHELD,
    PositionSigma,
    estimate_drone_sigma,
    estimate_exif_sigma,
    widen_by_fix,
    widen_by_steps,
)
from schemas.vocabulary import HeightDatum, PositionSource

EGM96 = "EPSG:4326+5773"


@dataclass(frozen=True, kw_only=True)
class HeightDatumEvidence:
    """The height datum of a prior and its evidence."""

    datum: HeightDatum
    evidence: str


def infer_height_datum(drone: DroneMetadata | None, exif: ExifMetadata) -> HeightDatumEvidence:
    """The height datum: ellipsoidal or orthometric where there is evidence, else unknown.

    The height of an RTK fix is ellipsoidal, as all differential positions are. DJI's AltitudeType is no evidence: it is
    RtkAlt without a fix, too, and GpsFusionAlt is barometric on some models. Parrot's documentation states the datum by
    model (ANAFI Ai: ellipsoid; ANAFI 4K, Thermal, USA: EGM96). The altitude reference 0 of EXIF 2 means sea level, but
    Android, Skydio and others write ellipsoidal heights with it: unknown. References 2 and 3 of EXIF 3.0 mean the
    ellipsoid.
    """
    if drone is not None and drone.rtk_flag == RTK_FIXED:
        return HeightDatumEvidence(datum=HeightDatum.ELLIPSOIDAL, evidence="ellipsoidal by the RTK fix")
    if drone is not None and drone.maker == "Parrot" and exif.model.upper().replace(" ", "").startswith("ANAFI"):
        if exif.model.upper().replace(" ", "").startswith("ANAFIAI"):
            return HeightDatumEvidence(datum=HeightDatum.ELLIPSOIDAL, evidence="ellipsoidal by Parrot's documentation")
        return HeightDatumEvidence(datum=HeightDatum.ORTHOMETRIC, evidence="above EGM96 by Parrot's documentation")
    if exif.altitude_ref in (2, 3):
        return HeightDatumEvidence(datum=HeightDatum.ELLIPSOIDAL, evidence="ellipsoidal by EXIF GPSAltitudeRef")
    return HeightDatumEvidence(datum=HeightDatum.UNKNOWN, evidence="of unknown datum")


def ellipsoidal_from_egm96(lon_deg: float, lat_deg: float, height_m: float) -> tuple[float, str] | None:
    """The ellipsoidal height of a height above EGM96, and the geoid grid used; None where no grid is installed."""
    try:
        geo = transform(np.array([[lon_deg, lat_deg, height_m]]), EGM96, GEO)
    except GeoreferenceError:
        return None
    operation = find_operation(EGM96, GEO, lon_deg=lon_deg, lat_deg=lat_deg)
    return float(geo[0, 2]), ", ".join(operation.grids) or operation.name


@dataclass(frozen=True, kw_only=True)
class PositionPrior:
    """Position of the camera by the metadata (WGS 84 degrees, metres); ``height_m`` is NaN where it is unknown.

    ``evidence`` states the tags that position, height and sigma are taken from, ``warnings`` their inconsistencies.
    Where ``source`` is NONE the numbers are NaN, and ``reason`` states why.
    """

    source: PositionSource
    lon_deg: float = math.nan
    lat_deg: float = math.nan
    height_m: float = math.nan
    height_datum: HeightDatum = HeightDatum.UNKNOWN
    sigma: PositionSigma = SIGMA_HANDHELD
    evidence: str = ""
    warnings: tuple[str, ...] = ()
    reason: str = ""


def check_position(lon_deg: float, lat_deg: float) -> str:
    """Why the coordinates are not a valid position; empty where they are."""
    if math.isnan(lon_deg) or math.isnan(lat_deg):
        return "no position"
    if _is_out_of_range(lon_deg, lat_deg):
        return f"position lon {lon_deg:.6f}, lat {lat_deg:.6f} is out of range (lon -180..180, lat -90..90)"
    if abs(lon_deg) < 1e-6 and abs(lat_deg) < 1e-6:
        return "position is 0/0, which receivers write without a fix"
    return ""


def _is_out_of_range(lon_deg: float, lat_deg: float) -> bool:
    return abs(lat_deg) > 90 or abs(lon_deg) > 180


def _check_drone_position(drone: DroneMetadata) -> str:
    if drone.gps_status.lower() == "invalid":
        return "GpsStatus is Invalid"
    return drone.position_problem or check_position(drone.lon_deg, drone.lat_deg)


def _check_exif_position(exif: ExifMetadata) -> str:
    return exif.position_problem or check_position(exif.lon_deg, exif.lat_deg)


@dataclass(frozen=True, kw_only=True)
class _Disagreement:
    """Differences of the positions in XMP and EXIF beyond their sigmas, m (0: they agree), and warnings with both."""

    horizontal_m: float = 0.0
    vertical_m: float = 0.0
    warnings: tuple[str, ...] = ()


def _compare_xmp_with_exif(drone: DroneMetadata, exif: ExifMetadata, outcome: str) -> _Disagreement:
    """Compare the two statements about one photograph; ``outcome`` says which one counts, for the warning.

    Both are written from one fix of one receiver, so that they must agree within one sigma of their difference and the
    rounding of EXIF. An accuracy that EXIF states is that of its own position, else both have that of the receiver.
    """
    xmp_sigma, _ = estimate_drone_sigma(drone)
    exif_sigma = estimate_exif_sigma(exif)[0] if math.isfinite(exif.position_error_m) else xmp_sigma
    horizontal_m = vertical_m = 0.0
    warnings = []
    if not _check_drone_position(drone) and not _check_exif_position(exif):
        xmp_place, exif_place = (drone.lon_deg, drone.lat_deg), (exif.lon_deg, exif.lat_deg)
        apart_m = measure_apart_m(xmp_place, exif_place)
        # Rounded or truncated to a step in each axis.
        steps_deg = sum(step for step in (drone.position_step_deg, exif.position_step_deg) if step > 0)
        step_m = math.sqrt(2) * METRES_PER_DEGREE * steps_deg
        limit_m = math.hypot(xmp_sigma.horizontal_m, exif_sigma.horizontal_m) + step_m
        if apart_m > limit_m:
            horizontal_m = apart_m
            mistake = name_mistake(xmp_place, exif_place)
            warnings.append(
                f"the positions disagree by {apart_m:.2f} m, beyond their sigmas ({limit_m:.2g} m)"
                f"{f', as with {mistake}' if mistake else ''}: "
                f"XMP lat {drone.lat_deg:.8f}, lon {drone.lon_deg:.8f}; "
                f"EXIF lat {exif.lat_deg:.8f}, lon {exif.lon_deg:.8f}; {outcome}"
            )
    apart_m = abs(exif.altitude_m - drone.absolute_altitude_m)
    step_m = sum(step for step in (drone.altitude_step_m, exif.altitude_step_m) if step > 0)
    limit_m = math.hypot(xmp_sigma.vertical_m, exif_sigma.vertical_m) + step_m
    if apart_m > limit_m and not _is_geoid_height(drone, exif, limit_m):
        vertical_m = apart_m
        mirrored = abs(exif.altitude_m + drone.absolute_altitude_m) <= limit_m
        warnings.append(
            f"the heights disagree by {apart_m:.2f} m, beyond their sigmas ({limit_m:.2g} m)"
            f"{', as with the sign changed' if mirrored else ''}: "
            f"XMP {drone.absolute_altitude_m:.2f} m; EXIF {exif.altitude_m:.2f} m; {outcome}"
        )
    return _Disagreement(horizontal_m=horizontal_m, vertical_m=vertical_m, warnings=tuple(warnings))


# EGM96 differs from other models of the geoid by up to a metre.
_GEOID_MODEL_M = 1.0


def _is_geoid_height(drone: DroneMetadata, exif: ExifMetadata, limit_m: float) -> bool:
    """Whether XMP is above the ellipsoid and EXIF above sea level, of one and the same height."""
    if drone.rtk_flag != RTK_FIXED or exif.altitude_ref not in (0, 1):
        return False
    place = (exif.lon_deg, exif.lat_deg) if _check_drone_position(drone) else (drone.lon_deg, drone.lat_deg)
    if check_position(*place):
        return False
    converted = ellipsoidal_from_egm96(*place, exif.altitude_m)
    return converted is not None and abs(converted[0] - drone.absolute_altitude_m) <= limit_m + _GEOID_MODEL_M


_ASK_REGISTRY = "XMP is used, its sigma covers both; set 'positions: exif' or 'positions: xmp' in the portfolio"


def derive_position_prior(
    drone: DroneMetadata | None, exif: ExifMetadata, counts: PositionSource | None = None
) -> PositionPrior:
    """The position of XMP if it is valid, else that of EXIF, else none with the reason.

    Where the two disagree beyond their sigmas there is a warning with both. The sigma then covers the difference,
    unless ``counts`` says which one counts (XMP or EXIF); the other one is used only where that has no position.

    Args:
        drone: XMP metadata; None where no drone wrote any.
        exif: EXIF metadata.
        counts: XMP or EXIF, as the portfolio says; None where it says nothing.

    Returns:
        The prior; its source is NONE where there is no position.
    """
    problems = {PositionSource.EXIF: _check_exif_position(exif)}
    if drone is not None:
        problems = {PositionSource.XMP: _check_drone_position(drone)} | problems
    sources = sorted(problems, key=lambda source: source is not counts)
    source = next((source for source in sources if not problems[source]), PositionSource.NONE)
    if source is PositionSource.NONE:
        reason = "; ".join(f"{source.upper()}: {problems[source]}" for source in problems)
        return PositionPrior(source=PositionSource.NONE, reason=reason)
    prior = _build_prior(source, drone, exif, counts)
    if counts in problems and source is not counts:
        warning = f"{counts.upper()}, which counts by the portfolio, has no position ({problems[counts]}); "
        return replace(prior, warnings=(*prior.warnings, f"{warning}{source.upper()} is used"))
    if drone is not None and source is PositionSource.EXIF and _is_out_of_range(drone.lon_deg, drone.lat_deg):
        return replace(prior, warnings=(*prior.warnings, f"XMP {problems[PositionSource.XMP]}; EXIF is used"))
    return prior


def _build_prior(
    source: PositionSource, drone: DroneMetadata | None, exif: ExifMetadata, counts: PositionSource | None
) -> PositionPrior:
    outcome = _ASK_REGISTRY if counts is None else f"{source.upper()} is used, as the portfolio says"
    disagreement = _compare_xmp_with_exif(drone, exif, outcome) if drone is not None else _Disagreement()
    exif_is_another = counts is PositionSource.EXIF and disagreement.horizontal_m > 0
    if drone is None or (exif_is_another and math.isfinite(exif.position_error_m)):
        sigma, sigma_evidence = estimate_exif_sigma(exif)
    elif exif_is_another:  # the fix that XMP states the accuracy of is not that of EXIF
        sigma, sigma_evidence = SIGMA_DRONE, "no accuracy of its own, taken as that of a receiver without corrections"
    else:
        sigma, sigma_evidence = estimate_drone_sigma(drone)
    by_xmp = drone is not None and math.isfinite(drone.absolute_altitude_m)
    if counts is PositionSource.EXIF and math.isfinite(exif.altitude_m):
        by_xmp = False
    step_deg, height_step_m = exif.position_step_deg, exif.altitude_step_m
    if drone is not None:
        step_deg = drone.position_step_deg if source is PositionSource.XMP else step_deg
        height_step_m = drone.altitude_step_m if by_xmp else height_step_m
    sigma, warnings = widen_by_steps(sigma, METRES_PER_DEGREE * step_deg, height_step_m)
    sigma, warnings_of_fix = widen_by_fix(sigma, exif, source)
    warnings += warnings_of_fix
    if counts is None:
        sigma = PositionSigma(
            horizontal_m=max(sigma.horizontal_m, disagreement.horizontal_m),
            vertical_m=max(sigma.vertical_m, disagreement.vertical_m),
        )
    warnings += disagreement.warnings
    lon_deg, lat_deg = exif.lon_deg, exif.lat_deg
    if drone is not None and source is PositionSource.XMP:
        lon_deg, lat_deg = drone.lon_deg, drone.lat_deg
    height_m = drone.absolute_altitude_m if drone is not None and by_xmp else exif.altitude_m
    height_source = f"XMP {drone.altitude_type}".strip() if drone is not None and by_xmp else "EXIF"
    # The fix that XMP speaks of is not that of another height.
    inferred = infer_height_datum(drone if by_xmp or not disagreement.vertical_m else None, exif)
    datum, height_evidence = inferred.datum, f"{height_source} height {inferred.evidence}"
    if datum is HeightDatum.ORTHOMETRIC and math.isfinite(height_m):
        converted = ellipsoidal_from_egm96(lon_deg, lat_deg, height_m)
        if converted is not None:
            height_evidence += f", {height_m:.2f} m converted to ellipsoidal by grid {converted[1]}"
            height_m, datum = converted[0], HeightDatum.ELLIPSOIDAL
    return PositionPrior(
        source=source,
        lon_deg=lon_deg,
        lat_deg=lat_deg,
        height_m=height_m,
        height_datum=datum,
        sigma=sigma,
        evidence=f"{source.upper()} position, {sigma_evidence}"
        + (f"; {height_evidence}" if math.isfinite(height_m) else "; no height"),
        warnings=warnings,
    )
