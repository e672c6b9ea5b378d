"""EXIF metadata: camera, time, focal length, GPS position and its stated accuracy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from typing import Any

from PIL.ExifTags import GPS, IFD, Base
from PIL.Image import Exif

FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # EXIF FocalPlaneResolutionUnit


@dataclass(frozen=True, kw_only=True)
class ExifMetadata:
    """EXIF metadata of a photograph; NaN, empty or None where a value is missing.

    ``focal_length_35mm_mm`` is FocalLengthIn35mmFilm (by the diagonal, CIPA DCG-001). ``focal_plane_focal_px`` is the
    focal length times the focal plane resolution, where that refers to the stored size. ``altitude_ref``: 0 and 1 above
    and below sea level, 2 and 3 above and below the ellipsoid (EXIF 3.0). ``position_error_m`` is GPSHPositioningError,
    ``position_step_deg`` the resolution of latitude and longitude as written. ``gps_time`` is the receiver's time.
    ``two_dimensional``: the fix has no measured height. ``void``: the receiver had no fix.
    """

    make: str = ""
    model: str = ""
    body_serial: str = ""
    lens_model: str = ""
    taken_at: datetime | None = None
    gps_time: datetime | None = None
    focal_length_mm: float = math.nan
    focal_length_35mm_mm: float = math.nan
    focal_plane_focal_px: float = math.nan
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    position_step_deg: float = math.nan
    altitude_m: float = math.nan
    altitude_ref: int | None = None
    position_error_m: float = math.nan
    dop: float = math.nan
    two_dimensional: bool = False
    void: bool = False
    map_datum: str = ""
    direction_deg: float = math.nan
    direction_magnetic: bool = False


def _parse_number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return math.nan


def _parse_positive(value: Any) -> float:
    number = _parse_number(value)
    return number if number > 0 and math.isfinite(number) else math.nan


def _parse_text(value: Any) -> str:
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value or "")
    return text.split("\0")[0].strip()


def _parse_degrees(value: Any, ref: Any, negative: str) -> float:
    """Signed degrees of degrees, minutes, seconds; NaN for other values."""
    if not isinstance(value, tuple | list) or len(value) != 3:
        return math.nan
    degrees, minutes, seconds = (_parse_number(part) for part in value)
    magnitude = degrees + minutes / 60 + seconds / 3600
    return -magnitude if _parse_text(ref).upper() == negative else magnitude


def _find_step(*angles: Any) -> float:
    """The resolution of degrees, minutes, seconds in degrees, by the denominators of their (reduced) fractions."""
    steps = [
        1 / (unit * part.denominator)
        for angle in angles
        if isinstance(angle, tuple | list) and len(angle) == 3
        for part, unit in zip(angle, (1, 60, 3600), strict=True)
        if getattr(part, "denominator", 0) > 0
    ]
    return min(steps, default=math.nan)


def _parse_time(block: dict[int, Any]) -> datetime | None:
    text = _parse_text(block.get(Base.DateTimeOriginal))
    offset = _parse_text(block.get(Base.OffsetTimeOriginal)).replace(":", "")
    digits = _parse_text(block.get(Base.SubsecTimeOriginal))
    second = Fraction(int(digits), 10 ** len(digits)) if digits.isdecimal() and len(digits) < 10 else Fraction(0)
    try:
        if offset:
            taken = datetime.strptime(text + offset, "%Y:%m:%d %H:%M:%S%z").astimezone(UTC)
        else:
            taken = datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    return taken.replace(microsecond=int(second * 10**6))


def _parse_gps_time(gps: dict[int, Any]) -> datetime | None:
    clock = gps.get(GPS.GPSTimeStamp)
    if not isinstance(clock, tuple | list) or len(clock) != 3:
        return None
    seconds = sum(_parse_number(part) * unit for part, unit in zip(clock, (3600, 60, 1), strict=True))
    try:
        day = datetime.strptime(_parse_text(gps.get(GPS.GPSDateStamp)), "%Y:%m:%d").replace(tzinfo=UTC)
        return datetime.fromtimestamp(day.timestamp() + seconds, tz=UTC)
    except (ValueError, OverflowError, OSError):
        return None


def _compute_focal_plane_px(block: dict[int, Any], width_px: int) -> float:
    per_unit = _parse_positive(block.get(Base.FocalPlaneXResolution))
    mm = _MM_PER_UNIT.get(int(_parse_positive(block.get(Base.FocalPlaneResolutionUnit, 2)) or 2), math.nan)
    # The resolution refers to the stored size only where EXIF states the same size (not resized since).
    if _parse_number(block.get(Base.ExifImageWidth)) != width_px:
        return math.nan
    return _parse_positive(_parse_positive(block.get(Base.FocalLength)) * per_unit / mm)


def read_exif(exif: Exif, *, width_px: int) -> ExifMetadata:
    """Read the EXIF block of a photograph of the given stored width; a damaged block gives empty values."""
    try:
        block: dict[int, Any] = dict(exif.get_ifd(IFD.Exif))
        gps: dict[int, Any] = dict(exif.get_ifd(IFD.GPSInfo))
    except (OSError, SyntaxError, ValueError, KeyError, TypeError):
        block, gps = {}, {}
    ref = gps.get(GPS.GPSAltitudeRef)
    altitude_ref = ref[0] if isinstance(ref, bytes) and ref else ref if isinstance(ref, int) else None
    return ExifMetadata(
        make=_parse_text(exif.get(Base.Make)),
        model=_parse_text(exif.get(Base.Model)),
        body_serial=_parse_text(block.get(Base.BodySerialNumber)),
        lens_model=_parse_text(block.get(Base.LensModel)),
        taken_at=_parse_time(block),
        gps_time=_parse_gps_time(gps),
        focal_length_mm=_parse_positive(block.get(Base.FocalLength)),
        focal_length_35mm_mm=_parse_positive(block.get(Base.FocalLengthIn35mmFilm)),
        focal_plane_focal_px=_compute_focal_plane_px(block, width_px),
        lat_deg=_parse_degrees(gps.get(GPS.GPSLatitude), gps.get(GPS.GPSLatitudeRef), "S"),
        lon_deg=_parse_degrees(gps.get(GPS.GPSLongitude), gps.get(GPS.GPSLongitudeRef), "W"),
        position_step_deg=_find_step(gps.get(GPS.GPSLatitude), gps.get(GPS.GPSLongitude)),
        altitude_m=_parse_number(gps.get(GPS.GPSAltitude)) * (-1 if altitude_ref in (1, 3) else 1),
        altitude_ref=altitude_ref,
        position_error_m=_parse_positive(gps.get(GPS.GPSHPositioningError)),
        dop=_parse_positive(gps.get(GPS.GPSDOP)),
        two_dimensional=_parse_text(gps.get(GPS.GPSMeasureMode)) == "2",
        void=_parse_text(gps.get(GPS.GPSStatus)).upper() == "V",
        map_datum=_parse_text(gps.get(GPS.GPSMapDatum)),
        direction_deg=_parse_number(gps.get(GPS.GPSImgDirection)),
        direction_magnetic=_parse_text(gps.get(GPS.GPSImgDirectionRef)).upper() == "M",
    )
