"""EXIF metadata: camera, time, focal length, GPS position and its stated accuracy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import Any

from PIL.ExifTags import GPS, IFD, Base
from PIL.Image import Exif

from facadelake.photos.exif_values import parse_number, parse_positive, parse_text
from facadelake.photos.gps_block import parse_gps_altitude, parse_gps_angle
from schemas.vocabulary import UtcOffset

FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)
_MM_PER_UNIT: dict[float, float] = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # EXIF FocalPlaneResolutionUnit


@dataclass(frozen=True, kw_only=True)
class ExifMetadata:
    """EXIF metadata of a photograph; NaN, empty or None where a value is missing.

    ``orientation`` (1 to 8), by which viewers turn the photograph; it is not applied to pixels.
    ``focal_length_35mm_mm`` is FocalLengthIn35mmFilm (by the diagonal, CIPA DCG-001). ``focal_plane_focal_px`` is the
    focal length times the focal plane resolution, where that refers to the stored size. ``altitude_ref``: 0 and 1 above
    and below sea level, 2 and 3 above and below the ellipsoid (EXIF 3.0). ``position_error_m`` is GPSHPositioningError,
    ``position_step_deg`` the resolution of latitude and longitude as written, ``altitude_step_m`` that of the altitude.
    ``gps_time`` is the receiver's time. ``taken_at`` is that of the camera's clock by ``utc_offset_s``, the offset from
    UTC that EXIF states (None: none, then it is taken as UTC); ``utc_offset`` is set by ``resolve_utc_offsets``.
    ``two_dimensional``: the fix has no measured height. ``void``: the receiver had no fix. ``processing_method``:
    GPS, CELLID, WLAN or MANUAL. ``unsigned_lat_deg`` and ``unsigned_lon_deg`` are stated in place of ``lat_deg``
    and ``lon_deg`` where the hemisphere is unknown; ``position_problem`` says why there is no position although
    tags of one are there. ``warnings`` says what is damaged or ambiguous, and how it is taken.
    """

    orientation: int | None = None
    make: str = ""
    model: str = ""
    body_serial: str = ""
    lens_model: str = ""
    taken_at: datetime | None = None
    utc_offset_s: float | None = None
    utc_offset: UtcOffset | None = None
    gps_time: datetime | None = None
    focal_length_mm: float = math.nan
    focal_length_35mm_mm: float = math.nan
    focal_plane_focal_px: float = math.nan
    lat_deg: float = math.nan
    lon_deg: float = math.nan
    unsigned_lat_deg: float = math.nan
    unsigned_lon_deg: float = math.nan
    position_problem: str = ""
    position_step_deg: float = math.nan
    altitude_m: float = math.nan
    altitude_ref: int | None = None
    altitude_step_m: float = math.nan
    position_error_m: float = math.nan
    dop: float = math.nan
    two_dimensional: bool = False
    void: bool = False
    processing_method: str = ""
    map_datum: str = ""
    direction_deg: float = math.nan
    direction_magnetic: bool = False
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _TimeTags:
    """A time of EXIF with its offset from UTC and its fraction of a second."""

    name: str
    time: int
    offset: int
    fraction: int


_TIMES = (
    _TimeTags(
        name="DateTimeOriginal",
        time=Base.DateTimeOriginal,
        offset=Base.OffsetTimeOriginal,
        fraction=Base.SubsecTimeOriginal,
    ),
    _TimeTags(
        name="DateTimeDigitized",
        time=Base.DateTimeDigitized,
        offset=Base.OffsetTimeDigitized,
        fraction=Base.SubsecTimeDigitized,
    ),
    _TimeTags(name="DateTime", time=Base.DateTime, offset=Base.OffsetTime, fraction=Base.SubsecTime),
)


def _parse_orientation(value: Any) -> int | None:
    return value if isinstance(value, int) and 1 <= value <= 8 else None


def _parse_offset(text: str) -> float | None:
    """The offset from UTC in seconds; None where the text is none."""
    try:
        offset = datetime.strptime(text.replace(":", ""), "%z").utcoffset()
    except ValueError:
        return None
    return None if offset is None else offset.total_seconds()


def _read_offset(block: dict[int, Any], tags: _TimeTags) -> tuple[float | None, list[str]]:
    """The offset from UTC of a time, else of the other times, which one clock gave; and a warning where it is none."""
    warnings: list[str] = []
    for tag in dict.fromkeys((tags.offset, *(other.offset for other in _TIMES))):
        text = parse_text(block.get(tag))
        offset_s = _parse_offset(text)
        if offset_s is not None:
            return offset_s, warnings
        if text.strip(": "):  # blanks: unknown
            warnings.append(f"EXIF {Base(tag).name} '{text[:20]}' is not an offset of the form +02:00; not used")
    return None, warnings


def _parse_time(block: dict[int, Any], tags: _TimeTags) -> datetime | None:
    """What the camera's clock showed, as if it were UTC."""
    text = parse_text(block.get(tags.time))
    digits = parse_text(block.get(tags.fraction))
    second = Fraction(int(digits), 10 ** len(digits)) if digits.isdecimal() and len(digits) < 10 else Fraction(0)
    try:
        taken = datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return None
    return taken.replace(microsecond=int(second * 10**6))


def _read_time(block: dict[int, Any]) -> tuple[datetime | None, float | None, list[str]]:
    """The time of exposure by the first readable of EXIF's times, its offset from UTC (s), and warnings.

    A warning says where the time is not DateTimeOriginal.
    """
    warnings: list[str] = []
    for tags in _TIMES:
        taken = _parse_time(block, tags)
        if taken is not None:
            if tags.name == "DateTime":
                warnings.append("the time is EXIF DateTime, that of the last change, as there is no DateTimeOriginal")
            elif tags.name != "DateTimeOriginal":
                warnings.append(f"the time is EXIF {tags.name}, as there is no DateTimeOriginal")
            offset_s, of_offset = _read_offset(block, tags)
            try:
                return taken - timedelta(seconds=offset_s or 0.0), offset_s, [*warnings, *of_offset]
            except OverflowError:  # in the first or last year that there is
                return taken, None, [*warnings, *of_offset]
        text = parse_text(block.get(tags.time))
        if text.strip(": 0"):  # blanks or zeros: unknown
            warnings.append(f"EXIF {tags.name} '{text[:30]}' is not a time of the form 2026:04:14 10:00:05; not used")
    return None, None, warnings


def _parse_gps_time(gps: dict[int, Any]) -> datetime | None:
    clock = gps.get(GPS.GPSTimeStamp)
    if not isinstance(clock, tuple | list) or len(clock) != 3:
        return None
    seconds = sum(parse_number(part) * unit for part, unit in zip(clock, (3600, 60, 1), strict=True))
    try:
        day = datetime.strptime(parse_text(gps.get(GPS.GPSDateStamp)), "%Y:%m:%d").replace(tzinfo=UTC)
        return datetime.fromtimestamp(day.timestamp() + seconds, tz=UTC)
    except (ValueError, OverflowError, OSError):
        return None


def _compute_focal_plane_px(block: dict[int, Any], width_px: int) -> float:
    per_unit = parse_positive(block.get(Base.FocalPlaneXResolution))
    mm = _MM_PER_UNIT.get(parse_number(block.get(Base.FocalPlaneResolutionUnit, 2)), math.nan)
    # The resolution refers to the stored size only where EXIF states the same size (not resized since).
    if parse_number(block.get(Base.ExifImageWidth)) != width_px:
        return math.nan
    return parse_positive(parse_positive(block.get(Base.FocalLength)) * per_unit / mm)


def _read_block(exif: Exif, ifd: IFD | None) -> tuple[dict[int, Any], list[str]]:
    """The tags of a directory of EXIF (None: the first one), and the damage that hides them."""
    try:
        return dict(exif.items() if ifd is None else exif.get_ifd(ifd)), []
    except Exception as error:  # Pillow's parser of TIFF directories raises whatever damaged bytes lead to
        name = "first directory" if ifd is None else "GPS block" if ifd is IFD.GPSInfo else "Exif block"
        return {}, [f"EXIF is damaged ({error or type(error).__name__}): nothing of its {name} is used"]


def _check_accuracies(gps: dict[int, Any]) -> list[str]:
    """Warnings about accuracies that are none: not above zero, or infinite. 0/0 is how EXIF writes an unknown one."""
    return [
        f"EXIF {tag.name} {parse_text(gps[tag])[:40]} is no accuracy; taken as not stated"
        for tag in (GPS.GPSHPositioningError, GPS.GPSDOP)
        if tag in gps and not math.isnan(parse_number(gps[tag])) and math.isnan(parse_positive(gps[tag]))
    ]


def _parse_encoded_text(value: Any) -> str:
    """A text of EXIF after the 8 bytes that name its character code."""
    is_coded = isinstance(value, bytes) and value[:5] in (b"ASCII", b"UNICO", b"JIS\0\0", b"\0\0\0\0\0")
    return parse_text(value[8:].replace(b"\0", b"") if is_coded else value)


def read_exif(exif: Exif, *, width_px: int) -> ExifMetadata:
    """Read the EXIF block of a photograph of the given stored width; what is damaged is empty, with a warning."""
    head, head_damage = _read_block(exif, None)
    block, block_damage = _read_block(exif, IFD.Exif)
    gps, gps_damage = _read_block(exif, IFD.GPSInfo)
    damage = (*head_damage, *block_damage, *gps_damage)
    lat = parse_gps_angle(gps.get(GPS.GPSLatitude), gps.get(GPS.GPSLatitudeRef), "latitude")
    lon = parse_gps_angle(gps.get(GPS.GPSLongitude), gps.get(GPS.GPSLongitudeRef), "longitude")
    altitude = parse_gps_altitude(gps.get(GPS.GPSAltitude), gps.get(GPS.GPSAltitudeRef))
    has_position = GPS.GPSLatitude in gps or GPS.GPSLongitude in gps
    unsigned = [math.isnan(angle.angle_deg) and math.isfinite(angle.magnitude_deg) for angle in (lat, lon)]
    taken_at, utc_offset_s, time_warnings = _read_time(head | block)
    return ExifMetadata(
        orientation=_parse_orientation(head.get(Base.Orientation)),
        make=parse_text(head.get(Base.Make)),
        model=parse_text(head.get(Base.Model)),
        body_serial=parse_text(block.get(Base.BodySerialNumber)),
        lens_model=parse_text(block.get(Base.LensModel)),
        taken_at=taken_at,
        utc_offset_s=utc_offset_s,
        gps_time=_parse_gps_time(gps),
        focal_length_mm=parse_positive(block.get(Base.FocalLength)),
        focal_length_35mm_mm=parse_positive(block.get(Base.FocalLengthIn35mmFilm)),
        focal_plane_focal_px=_compute_focal_plane_px(block, width_px),
        lat_deg=lat.angle_deg,
        lon_deg=lon.angle_deg,
        unsigned_lat_deg=lat.magnitude_deg if unsigned[0] else math.nan,
        unsigned_lon_deg=lon.magnitude_deg if unsigned[1] else math.nan,
        position_problem="; ".join(filter(None, (lat.problem, lon.problem))) if has_position else "",
        position_step_deg=min(filter(math.isfinite, (lat.step_deg, lon.step_deg)), default=math.nan),
        altitude_m=altitude.altitude_m,
        altitude_ref=altitude.ref,
        altitude_step_m=altitude.step_m,
        position_error_m=parse_positive(gps.get(GPS.GPSHPositioningError)),
        dop=parse_positive(gps.get(GPS.GPSDOP)),
        two_dimensional=parse_text(gps.get(GPS.GPSMeasureMode)) == "2",
        void=parse_text(gps.get(GPS.GPSStatus)).upper() == "V",
        processing_method=_parse_encoded_text(gps.get(GPS.GPSProcessingMethod)),
        map_datum=parse_text(gps.get(GPS.GPSMapDatum)),
        direction_deg=parse_number(gps.get(GPS.GPSImgDirection)),
        direction_magnetic=parse_text(gps.get(GPS.GPSImgDirectionRef)).upper() == "M",
        warnings=tuple(
            filter(
                None,
                (
                    *(*damage, lat.warning, lon.warning, altitude.warning, *time_warnings),
                    *_check_accuracies(gps),
                ),
            )
        ),
    )
