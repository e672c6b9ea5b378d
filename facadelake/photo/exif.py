"""EXIF: camera, time, focal length and GPS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from PIL.ExifTags import GPS, IFD, Base
from PIL.Image import Exif

FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # EXIF FocalPlaneResolutionUnit


@dataclass(frozen=True, kw_only=True)
class ExifMetadata:
    """What EXIF says; NaN, empty or None where it says nothing.

    ``focal_length_35mm_mm`` is by the diagonal (CIPA DCG-001): from the focal plane's resolution where it is given,
    for that is exact, else the camera's own rounded figure. ``altitude_ref``: 0 and 1 above and below sea level, 2
    and 3 above and below the ellipsoid (EXIF 3.0). ``position_error_m`` is GPSHPositioningError.
    """

    make: str
    model: str
    taken_at: datetime | None
    focal_length_mm: float
    focal_length_35mm_mm: float
    lat_deg: float
    lon_deg: float
    altitude_m: float
    altitude_ref: int | None
    position_error_m: float


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return math.nan


def _positive(value: Any) -> float:
    number = _number(value)
    return number if number > 0 and math.isfinite(number) else math.nan


def _text(value: Any) -> str:
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value or "")
    return text.split("\0")[0].strip()


def _degrees(value: Any, ref: Any, negative: str) -> float:
    """Degrees, minutes, seconds as signed degrees; NaN for anything else."""
    if not isinstance(value, tuple | list) or len(value) != 3:
        return math.nan
    degrees, minutes, seconds = (_number(part) for part in value)
    magnitude = degrees + minutes / 60 + seconds / 3600
    return -magnitude if _text(ref).upper() == negative else magnitude


def _taken_at(block: dict[int, Any]) -> datetime | None:
    text = _text(block.get(Base.DateTimeOriginal))
    offset = _text(block.get(Base.OffsetTimeOriginal)).replace(":", "")
    try:
        if offset:
            return datetime.strptime(text + offset, "%Y:%m:%d %H:%M:%S%z").astimezone(UTC)
        return datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return None


def _focal_35mm(block: dict[int, Any], width_px: int, height_px: int) -> float:
    per_unit = _positive(block.get(Base.FocalPlaneXResolution))
    focal_mm = _positive(block.get(Base.FocalLength))
    mm = _MM_PER_UNIT.get(int(block.get(Base.FocalPlaneResolutionUnit, 2) or 2), math.nan)
    # The resolution is that of the stored size only where EXIF's own size agrees with it (no resizing since).
    if int(block.get(Base.ExifImageWidth, 0) or 0) == width_px:
        exact = focal_mm * per_unit / mm * FULL_FRAME_DIAGONAL_MM / math.hypot(width_px, height_px)
        if math.isfinite(exact):
            return exact
    return _positive(block.get(Base.FocalLengthIn35mmFilm))


def read_exif(exif: Exif, *, width_px: int, height_px: int) -> ExifMetadata:
    """Read the EXIF block of a photograph of the given stored size; a damaged block says nothing."""
    try:
        block: dict[int, Any] = dict(exif.get_ifd(IFD.Exif))
        gps: dict[int, Any] = dict(exif.get_ifd(IFD.GPSInfo))
    except (OSError, SyntaxError, ValueError, KeyError, TypeError):
        block, gps = {}, {}
    ref = gps.get(GPS.GPSAltitudeRef)
    altitude_ref = ref[0] if isinstance(ref, bytes) and ref else ref if isinstance(ref, int) else None
    return ExifMetadata(
        make=_text(exif.get(Base.Make)),
        model=_text(exif.get(Base.Model)),
        taken_at=_taken_at(block),
        focal_length_mm=_positive(block.get(Base.FocalLength)),
        focal_length_35mm_mm=_focal_35mm(block, width_px, height_px),
        lat_deg=_degrees(gps.get(GPS.GPSLatitude), gps.get(GPS.GPSLatitudeRef), "S"),
        lon_deg=_degrees(gps.get(GPS.GPSLongitude), gps.get(GPS.GPSLongitudeRef), "W"),
        altitude_m=_number(gps.get(GPS.GPSAltitude)) * (-1 if altitude_ref in (1, 3) else 1),
        altitude_ref=altitude_ref,
        position_error_m=_positive(gps.get(GPS.GPSHPositioningError)),
    )
