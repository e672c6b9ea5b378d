"""Sigmas of position priors: as the metadata state them, as they are assumed, and widened by how they are written."""

from __future__ import annotations

import math
from dataclasses import dataclass

from facadelake.photos.drone_xmp import RTK_FIXED, RTK_FLOAT, DroneMetadata
from facadelake.photos.exif import ExifMetadata
from schemas.vocabulary import PositionSource


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
# Positions that are not a receiver's: of the cell of a mobile network, of a WLAN, entered by hand.
_NETWORK_SIGMA_M = {"CELLID": 1000.0, "WLAN": 50.0, "MANUAL": 50.0}
_SIGMA_OTHER_DATUM_M = 500.0  # local datums lie 100 to 1000 m from WGS 84 (Tokyo 450 m)
# Starts of GPSMapDatum, capitals and digits alone, of datums within 2 m of WGS 84.
_DATUMS_LIKE_WGS84 = (
    "WGS84", "WORLDGEODETICSYSTEM1984", "ITRF", "ETRS89", "ETRF", "NAD83", "JGD", "GDA", "CGCS2000", "NZGD2000",
    "SIRGAS", "KGD2002", "PZ90",
)  # fmt: skip
# The error of rounding to a step is uniform; its sigma counts where it is more than this share of the other.
_UNIFORM = math.sqrt(12)
_ROUNDING_SHARE = 0.25


def estimate_drone_sigma(drone: DroneMetadata) -> tuple[PositionSigma, str]:
    """The sigma of the position in XMP and what it is taken from: as stated for its solution, else as assumed."""
    flag = drone.rtk_flag
    lon, lat, height = drone.rtk_std_lon_m, drone.rtk_std_lat_m, drone.rtk_std_height_m
    if flag == RTK_FIXED and lon > 0 and lat > 0 and height > 0:
        sigma = PositionSigma(horizontal_m=max(lon, lat), vertical_m=height)
        return sigma, f"RtkFlag 50 (fixed), RtkStd {lon:g}/{lat:g}/{height:g} m"
    if flag == RTK_FIXED or flag in RTK_FLOAT:
        assumed = SIGMA_RTK_FIXED if flag == RTK_FIXED else SIGMA_RTK_FLOAT
        sigma = PositionSigma(  # an accuracy stated of one axis counts where it is worse
            horizontal_m=max([assumed.horizontal_m, *(std for std in (lon, lat) if std > 0)]),
            vertical_m=max([assumed.vertical_m, *(std for std in (height,) if std > 0)]),
        )
        return sigma, f"RtkFlag {flag} ({'fixed' if flag == RTK_FIXED else 'float'})"
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


def estimate_exif_sigma(exif: ExifMetadata) -> tuple[PositionSigma, str]:
    """The sigma of the position in EXIF and what it is taken from."""
    if math.isfinite(exif.position_error_m):
        sigma = PositionSigma(horizontal_m=exif.position_error_m, vertical_m=2 * exif.position_error_m)
        return sigma, f"GPSHPositioningError {exif.position_error_m:g} m"
    if math.isfinite(exif.dop):
        horizontal_m = max(SIGMA_HANDHELD.horizontal_m, _RANGE_ERROR_M * exif.dop)
        sigma = PositionSigma(horizontal_m=horizontal_m, vertical_m=2 * horizontal_m)
        return sigma, f"GPSDOP {exif.dop:g} of {_RANGE_ERROR_M:g} m"
    return SIGMA_HANDHELD, "a handheld receiver"


def widen_by_fix(
    sigma: PositionSigma, exif: ExifMetadata, source: PositionSource
) -> tuple[PositionSigma, tuple[str, ...]]:
    """The sigma, increased where EXIF states a poor fix of its position, and the warnings."""
    if source is not PositionSource.EXIF:
        return sigma, ()
    horizontal_m, vertical_m, warnings = sigma.horizontal_m, sigma.vertical_m, []
    if exif.void:
        horizontal_m, vertical_m = max(horizontal_m, _SIGMA_NOT_MEASURED_M), max(vertical_m, _SIGMA_NOT_MEASURED_M)
        warnings.append("EXIF GPSStatus is V (void): the receiver had no fix")
    if exif.two_dimensional:
        vertical_m = max(vertical_m, _SIGMA_NOT_MEASURED_M)
        warnings.append("EXIF GPSMeasureMode is 2: the height is not measured")
    if exif.processing_method.upper() in _NETWORK_SIGMA_M:
        horizontal_m = max(horizontal_m, _NETWORK_SIGMA_M[exif.processing_method.upper()])
        vertical_m = max(vertical_m, _SIGMA_NOT_MEASURED_M)
        warnings.append(
            f"EXIF GPSProcessingMethod is {exif.processing_method}: no position of a receiver; its sigma is taken as "
            f"{horizontal_m:.0f} m"
        )
    datum = "".join(letter for letter in exif.map_datum.upper() if letter.isalnum())
    if datum and not datum.startswith(_DATUMS_LIKE_WGS84):
        horizontal_m = max(horizontal_m, _SIGMA_OTHER_DATUM_M)
        vertical_m = max(vertical_m, _SIGMA_NOT_MEASURED_M)
        warnings.append(
            f"EXIF GPSMapDatum is {exif.map_datum}, read as WGS 84 with a sigma of {_SIGMA_OTHER_DATUM_M:.0f} m: "
            "name the CRS of the positions in crs.gnss"
        )
    return PositionSigma(horizontal_m=horizontal_m, vertical_m=vertical_m), tuple(warnings)


def widen_by_steps(
    sigma: PositionSigma, position_step_m: float, height_step_m: float
) -> tuple[PositionSigma, tuple[str, ...]]:
    """The sigma with the rounding of the numbers, and warnings where that counts.

    Args:
        sigma: that of the numbers before they were rounded.
        position_step_m: resolution of latitude and longitude as written, NaN where unknown.
        height_step_m: resolution of the height as written, NaN where unknown.

    Returns:
        the sigma and the warnings.
    """
    horizontal_m, vertical_m, warnings = sigma.horizontal_m, sigma.vertical_m, []
    if position_step_m / _UNIFORM > _ROUNDING_SHARE * horizontal_m:
        horizontal_m = math.hypot(horizontal_m, position_step_m / _UNIFORM)
        warnings.append(f"the position is written in steps of {position_step_m:.2g} m")
    if height_step_m / _UNIFORM > _ROUNDING_SHARE * vertical_m:
        vertical_m = math.hypot(vertical_m, height_step_m / _UNIFORM)
        warnings.append(f"the height is written in steps of {height_step_m:.2g} m")
    return PositionSigma(horizontal_m=horizontal_m, vertical_m=vertical_m), tuple(warnings)
