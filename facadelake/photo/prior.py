"""Position and attitude priors of a photograph: XMP before EXIF, each with its sigma and its height datum."""

from __future__ import annotations

import math
from dataclasses import dataclass

from facadelake.photo.exif import ExifMetadata
from facadelake.photo.xmp import DroneMetadata
from schemas.vocabulary import HeightDatum, PositionSource

RTK_FIXED, RTK_FLOAT = 50, 34


@dataclass(frozen=True, kw_only=True)
class Sigma:
    """One sigma in metres: each horizontal axis, and height."""

    horizontal_m: float
    vertical_m: float


# Carrier phase ambiguities fixed: the makers state 1 cm + 1 ppm and 1.5 cm + 1 ppm rms; doubled, because the antenna's
# offset from the camera and the shutter's delay come on top.
SIGMA_RTK_FIXED = Sigma(horizontal_m=0.02, vertical_m=0.04)
# Ambiguities not fixed: decimetres.
SIGMA_RTK_FLOAT = Sigma(horizontal_m=0.5, vertical_m=1.0)
# A drone's single-frequency receiver in the open (hover accuracy is stated as 1.5 m); near a facade, signals are
# shaded and reflected. The height is fused with a barometer that drifts.
SIGMA_DRONE = Sigma(horizontal_m=3.0, vertical_m=5.0)
# A phone or a camera's own receiver between buildings.
SIGMA_HANDHELD = Sigma(horizontal_m=5.0, vertical_m=10.0)


@dataclass(frozen=True, kw_only=True)
class PositionPrior:
    """Where the photograph says it was taken (WGS 84 degrees, metres); ``height_m`` is NaN where it says none.

    With ``source`` NONE the numbers are NaN and ``reason`` says why.
    """

    source: PositionSource
    lon_deg: float = math.nan
    lat_deg: float = math.nan
    height_m: float = math.nan
    height_datum: HeightDatum = HeightDatum.UNKNOWN
    sigma: Sigma = SIGMA_HANDHELD
    reason: str = ""


def position_problem(lon_deg: float, lat_deg: float) -> str:
    """Why the coordinates cannot be a place where a photograph was taken; empty where they can."""
    if math.isnan(lon_deg) or math.isnan(lat_deg):
        return "no position"
    if not (abs(lat_deg) <= 90 and abs(lon_deg) <= 180):
        return f"position lon {lon_deg:.6f}, lat {lat_deg:.6f} is off the globe (lon -180..180, lat -90..90)"
    if abs(lon_deg) < 1e-6 and abs(lat_deg) < 1e-6:
        return "position is 0/0, which receivers write without a fix"
    return ""


def _drone_sigma(drone: DroneMetadata) -> Sigma:
    if drone.rtk_flag == RTK_FLOAT:
        return SIGMA_RTK_FLOAT
    if drone.rtk_flag != RTK_FIXED:
        return SIGMA_DRONE
    horizontal = max(drone.rtk_std_lon_m, drone.rtk_std_lat_m)
    stated = math.isfinite(horizontal) and horizontal > 0 and drone.rtk_std_height_m > 0
    return Sigma(horizontal_m=horizontal, vertical_m=drone.rtk_std_height_m) if stated else SIGMA_RTK_FIXED


def _drone_datum(drone: DroneMetadata, exif: ExifMetadata) -> HeightDatum:
    """Ellipsoidal only with evidence: an RTK fix (differential positions are ellipsoidal) or EXIF 3.0's reference.

    DJI's AltitudeType says RtkAlt without a fix too, and GpsFusionAlt is barometric on some models: no evidence.
    """
    if drone.rtk_flag == RTK_FIXED:
        return HeightDatum.ELLIPSOIDAL
    return _exif_datum(exif)


def _exif_datum(exif: ExifMetadata) -> HeightDatum:
    """EXIF 2's reference 0 claims sea level, but many writers put ellipsoidal heights beside it: unknown."""
    return HeightDatum.ELLIPSOIDAL if exif.altitude_ref in (2, 3) else HeightDatum.UNKNOWN


def _finite_or(value: float, other: float) -> float:
    return value if math.isfinite(value) else other


def position_prior(drone: DroneMetadata | None, exif: ExifMetadata) -> PositionPrior:
    """XMP's position if it is a possible one, else EXIF's (some firmware truncates it), else none, with the reason."""
    problems: list[str] = []
    if drone is not None:
        problem = position_problem(drone.lon_deg, drone.lat_deg)
        if not problem:
            return PositionPrior(
                source=PositionSource.XMP,
                lon_deg=drone.lon_deg,
                lat_deg=drone.lat_deg,
                height_m=_finite_or(drone.absolute_altitude_m, exif.altitude_m),
                height_datum=_drone_datum(drone, exif),
                sigma=_drone_sigma(drone),
            )
        problems.append(f"XMP: {problem}")
    problem = position_problem(exif.lon_deg, exif.lat_deg)
    if problem:
        return PositionPrior(source=PositionSource.NONE, reason="; ".join([*problems, f"EXIF: {problem}"]))
    if drone is not None:
        return PositionPrior(
            source=PositionSource.EXIF,
            lon_deg=exif.lon_deg,
            lat_deg=exif.lat_deg,
            height_m=_finite_or(drone.absolute_altitude_m, exif.altitude_m),
            height_datum=_drone_datum(drone, exif),
            sigma=_drone_sigma(drone),
        )
    stated = exif.position_error_m
    return PositionPrior(
        source=PositionSource.EXIF,
        lon_deg=exif.lon_deg,
        lat_deg=exif.lat_deg,
        height_m=exif.altitude_m,
        height_datum=_exif_datum(exif),
        sigma=Sigma(horizontal_m=stated, vertical_m=2 * stated) if math.isfinite(stated) else SIGMA_HANDHELD,
    )
