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
from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata
from schemas.vocabulary import HeightDatum, PositionSource

RTK_FIXED = 50
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


# RtkFlag of a float solution: 32 to 49 in DJI's manuals, 34 in the older ones.
RTK_FLOAT = range(32, 50)
METRES_PER_DEGREE = 111_320.0


@dataclass(frozen=True, kw_only=True)
class PositionSigma:
    """Standard deviations in metres: of each horizontal axis, and of the height."""

    horizontal_m: float
    vertical_m: float


# Carrier phase ambiguities fixed: the makers state 1 cm + 1 ppm and 1.5 cm + 1 ppm rms; doubled for the offset between
# antenna and camera and the delay of the shutter.
SIGMA_RTK_FIXED = PositionSigma(horizontal_m=0.02, vertical_m=0.04)
# Ambiguities not fixed: decimetres.
SIGMA_RTK_FLOAT = PositionSigma(horizontal_m=0.5, vertical_m=1.0)
# A drone's single-frequency receiver under open sky has a stated hover accuracy of 1.5 m; near a facade, signals are
# obstructed and reflected. The height is combined with a drifting barometer.
SIGMA_DRONE = PositionSigma(horizontal_m=3.0, vertical_m=5.0)
# The accuracy estimate of a receiver does not include errors common to its signals (reflections at the facade).
SIGMA_OWN_ESTIMATE = PositionSigma(horizontal_m=1.0, vertical_m=2.0)
# The receiver of a phone or a camera between buildings.
SIGMA_HANDHELD = PositionSigma(horizontal_m=5.0, vertical_m=10.0)
# Range error between buildings, multiplied by the dilution of precision.
_RANGE_ERROR_M = 3.0
# A two-dimensional fix has an assumed height; a void fix has no satellites.
_SIGMA_NOT_MEASURED_M = 50.0


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
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180):
        return f"position lon {lon_deg:.6f}, lat {lat_deg:.6f} is out of range (lon -180..180, lat -90..90)"
    if abs(lon_deg) < 1e-6 and abs(lat_deg) < 1e-6:
        return "position is 0/0, which receivers write without a fix"
    return ""


def _estimate_drone_sigma(drone: DroneMetadata) -> tuple[PositionSigma, str]:
    flag = drone.rtk_flag
    if flag == RTK_FIXED:
        lon, lat, height = drone.rtk_std_lon_m, drone.rtk_std_lat_m, drone.rtk_std_height_m
        if lon > 0 and lat > 0 and height > 0:
            sigma = PositionSigma(horizontal_m=max(lon, lat), vertical_m=height)
            return sigma, f"RtkFlag 50 (fixed), RtkStd {lon:g}/{lat:g}/{height:g} m"
        return SIGMA_RTK_FIXED, "RtkFlag 50 (fixed)"
    if flag in RTK_FLOAT:
        return SIGMA_RTK_FLOAT, f"RtkFlag {flag} (float)"
    horizontal_m, vertical_m = drone.stated_sigma_horizontal_m, drone.stated_sigma_vertical_m
    if horizontal_m > 0 and vertical_m > 0:
        if drone.maker == "Parrot":  # its receivers use no corrections
            horizontal_m = max(horizontal_m, SIGMA_OWN_ESTIMATE.horizontal_m)
            vertical_m = max(vertical_m, SIGMA_OWN_ESTIMATE.vertical_m)
        stated = (
            f"GPSXYAccuracy {drone.stated_sigma_horizontal_m:.3g} m, GPSZAccuracy {drone.stated_sigma_vertical_m:.3g} m"
        )
        return PositionSigma(horizontal_m=horizontal_m, vertical_m=vertical_m), stated
    return SIGMA_DRONE, "a drone's receiver without corrections" + ("" if flag is None else f" (RtkFlag {flag})")


def _estimate_exif_sigma(exif: ExifMetadata) -> tuple[PositionSigma, str]:
    if math.isfinite(exif.position_error_m):
        sigma = PositionSigma(horizontal_m=exif.position_error_m, vertical_m=2 * exif.position_error_m)
        return sigma, f"GPSHPositioningError {exif.position_error_m:g} m"
    if math.isfinite(exif.dop):
        horizontal_m = max(SIGMA_HANDHELD.horizontal_m, _RANGE_ERROR_M * exif.dop)
        sigma = PositionSigma(horizontal_m=horizontal_m, vertical_m=2 * horizontal_m)
        return sigma, f"GPSDOP {exif.dop:g} of {_RANGE_ERROR_M:g} m"
    return SIGMA_HANDHELD, "a handheld receiver"


def _widen_sigma(
    sigma: PositionSigma, exif: ExifMetadata, source: PositionSource
) -> tuple[PositionSigma, tuple[str, ...]]:
    """The sigma, increased where EXIF states a poor fix, and the warnings."""
    horizontal_m, vertical_m, warnings = sigma.horizontal_m, sigma.vertical_m, []
    if source is PositionSource.EXIF:
        step_m = exif.position_step_deg * METRES_PER_DEGREE
        if step_m / math.sqrt(12) > 0.1 * horizontal_m:
            horizontal_m = math.hypot(horizontal_m, step_m / math.sqrt(12))  # uniform distribution over a step
            warnings.append(f"the position is written in steps of {step_m:.2g} m")
        if exif.void:
            horizontal_m, vertical_m = max(horizontal_m, _SIGMA_NOT_MEASURED_M), max(vertical_m, _SIGMA_NOT_MEASURED_M)
            warnings.append("EXIF GPSStatus is V (void): the receiver had no fix")
        if exif.two_dimensional:
            vertical_m = max(vertical_m, _SIGMA_NOT_MEASURED_M)
            warnings.append("EXIF GPSMeasureMode is 2: the height is not measured")
        if exif.map_datum and not exif.map_datum.upper().replace(" ", "").replace("-", "").startswith("WGS84"):
            warnings.append(f"EXIF GPSMapDatum is {exif.map_datum}; taken as WGS 84")
    return PositionSigma(horizontal_m=horizontal_m, vertical_m=vertical_m), tuple(warnings)


def _check_drone_position(drone: DroneMetadata) -> str:
    if drone.gps_status.lower() == "invalid":
        return "GpsStatus is Invalid"
    return check_position(drone.lon_deg, drone.lat_deg)


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
    xmp_sigma, _ = _estimate_drone_sigma(drone)
    exif_sigma = _estimate_exif_sigma(exif)[0] if math.isfinite(exif.position_error_m) else xmp_sigma
    horizontal_m = vertical_m = 0.0
    warnings = []
    if not _check_drone_position(drone) and not _check_exif_position(exif):
        north = exif.lat_deg - drone.lat_deg
        east = ((exif.lon_deg - drone.lon_deg + 180) % 360 - 180) * math.cos(math.radians(drone.lat_deg))
        apart_m = math.hypot(north, east) * METRES_PER_DEGREE
        # Rounded or truncated to a step in each axis.
        step_m = math.sqrt(2) * METRES_PER_DEGREE * exif.position_step_deg if exif.position_step_deg > 0 else 0.0
        limit_m = math.hypot(xmp_sigma.horizontal_m, exif_sigma.horizontal_m) + step_m
        if apart_m > limit_m:
            horizontal_m = apart_m
            warnings.append(
                f"the positions disagree by {apart_m:.2f} m, beyond their sigmas ({limit_m:.2g} m): "
                f"XMP lat {drone.lat_deg:.8f}, lon {drone.lon_deg:.8f}; "
                f"EXIF lat {exif.lat_deg:.8f}, lon {exif.lon_deg:.8f}; {outcome}"
            )
    apart_m = abs(exif.altitude_m - drone.absolute_altitude_m)
    step_m = exif.altitude_step_m if exif.altitude_step_m > 0 else 0.0
    limit_m = math.hypot(xmp_sigma.vertical_m, exif_sigma.vertical_m) + step_m
    if apart_m > limit_m and not _is_geoid_height(drone, exif, limit_m):
        vertical_m = apart_m
        warnings.append(
            f"the heights disagree by {apart_m:.2f} m, beyond their sigmas ({limit_m:.2g} m): "
            f"XMP {drone.absolute_altitude_m:.2f} m; EXIF {exif.altitude_m:.2f} m; {outcome}"
        )
    return _Disagreement(horizontal_m=horizontal_m, vertical_m=vertical_m, warnings=tuple(warnings))


# EGM96 differs from other models of the geoid by up to a metre.
_GEOID_MODEL_M = 1.0


def _is_geoid_height(drone: DroneMetadata, exif: ExifMetadata, limit_m: float) -> bool:
    """Whether XMP is above the ellipsoid and EXIF above sea level, of one and the same height."""
    if drone.rtk_flag != RTK_FIXED or exif.altitude_ref not in (0, 1) or _check_drone_position(drone):
        return False
    converted = ellipsoidal_from_egm96(drone.lon_deg, drone.lat_deg, exif.altitude_m)
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
    return prior


def _build_prior(
    source: PositionSource, drone: DroneMetadata | None, exif: ExifMetadata, counts: PositionSource | None
) -> PositionPrior:
    outcome = _ASK_REGISTRY if counts is None else f"{source.upper()} is used, as the portfolio says"
    disagreement = _compare_xmp_with_exif(drone, exif, outcome) if drone is not None else _Disagreement()
    exif_is_another = counts is PositionSource.EXIF and disagreement.horizontal_m > 0
    if drone is None or (exif_is_another and math.isfinite(exif.position_error_m)):
        sigma, sigma_evidence = _estimate_exif_sigma(exif)
    elif exif_is_another:  # the fix that XMP states the accuracy of is not that of EXIF
        sigma, sigma_evidence = SIGMA_DRONE, "no accuracy of its own, taken as that of a receiver without corrections"
    else:
        sigma, sigma_evidence = _estimate_drone_sigma(drone)
    sigma, warnings = _widen_sigma(sigma, exif, source)
    if counts is None:
        sigma = PositionSigma(
            horizontal_m=max(sigma.horizontal_m, disagreement.horizontal_m),
            vertical_m=max(sigma.vertical_m, disagreement.vertical_m),
        )
    warnings += disagreement.warnings
    lon_deg, lat_deg = exif.lon_deg, exif.lat_deg
    if drone is not None and source is PositionSource.XMP:
        lon_deg, lat_deg = drone.lon_deg, drone.lat_deg
    by_xmp = drone is not None and math.isfinite(drone.absolute_altitude_m)
    if counts is PositionSource.EXIF and math.isfinite(exif.altitude_m):
        by_xmp = False
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
