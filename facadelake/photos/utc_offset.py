"""Offsets of camera clocks from UTC: as EXIF states them, else by GPS time, else by other photographs of the camera.

A camera's clock shows local time. EXIF states its offset from UTC since version 2.31, and many cameras do not: their
times are hours off where they are taken as UTC.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from datetime import date, timedelta
from statistics import median

import pyarrow as pa

from facadelake.photos.clock import is_clock_set, seconds_from_time
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.read import Photo
from schemas.vocabulary import UtcOffset

# Time zones are multiples of a quarter of an hour, from -12 to +14 hours.
_ZONE_STEP_S = 900.0
_LARGEST_S = 14 * 3600.0
# A camera's clock and the receiver's agree to this; a larger remainder is no time zone alone.
_CLOCK_ERROR_S = 180.0


def resolve_utc_offsets(photos: Mapping[str, Photo]) -> dict[str, Photo]:
    """The photographs of a campaign with their times in UTC, as far as anything tells the offset.

    GPS time comes first, as it is UTC by definition: it also tells a stated offset that is wrong, which is a warning.
    """
    members: dict[str, list[str]] = defaultdict(list)
    for photo_id, photo in photos.items():
        if photo.exif is not None and photo.exif.taken_at is not None and is_clock_set(photo.exif.taken_at):
            members[_name_body(photo, photo.exif)].append(photo_id)
    out = dict(photos)
    for of_body in members.values():
        exifs = {photo_id: exif for photo_id in of_body if (exif := photos[photo_id].exif) is not None}
        by_day = _find_offsets_by_gps(exifs)
        known = {exif.utc_offset_s for exif in exifs.values() if exif.utc_offset_s is not None} | set(by_day.values())
        for photo_id, exif in exifs.items():
            by_gps = by_day.get(_get_day(exif))
            if by_gps is not None:
                offset_s, evidence = by_gps, UtcOffset.GPS_TIME
                if exif.utc_offset_s == by_gps:
                    evidence = UtcOffset.STATED
            elif exif.utc_offset_s is not None:
                offset_s, evidence = exif.utc_offset_s, UtcOffset.STATED
            elif len(known) == 1:
                (offset_s,), evidence = known, UtcOffset.SAME_CAMERA
            else:
                offset_s, evidence = 0.0, UtcOffset.UNKNOWN
            out[photo_id] = _apply_offset(photos[photo_id], exif, offset_s, evidence)
    return out


def describe_unknown_offsets(photos: pa.Table) -> str:
    """A remark on the photographs of table ``photos`` whose offset from UTC nothing tells; empty without any."""
    offsets = photos.column("utc_offset").to_pylist()
    unknown = offsets.count(UtcOffset.UNKNOWN)
    if not unknown:
        return ""
    return (
        f"{unknown} of {len(offsets)} photographs state no offset of their clock from UTC, and nothing else tells it: "
        "their times are taken as UTC, also those of observations and defects, and may be hours off (limit 14 h); set "
        "the camera to write OffsetTimeOriginal, or GPS time"
    )


def _name_body(photo: Photo, exif: ExifMetadata) -> str:
    return (photo.drone.body if photo.drone else "") or exif.body_serial or f"{exif.make} {exif.model}"


def _get_local_s(exif: ExifMetadata) -> float:
    """What the camera's clock showed, in seconds since 1970."""
    return seconds_from_time(exif.taken_at) + (exif.utc_offset_s or 0.0)


def _get_day(exif: ExifMetadata) -> date | None:
    """The day that the camera's clock showed."""
    return None if exif.taken_at is None else (exif.taken_at + timedelta(seconds=exif.utc_offset_s or 0.0)).date()


def _find_offsets_by_gps(exifs: Mapping[str, ExifMetadata]) -> dict[date | None, float]:
    """The offset of a camera's clock on each day on which GPS time tells it, seconds."""
    differences: dict[date | None, list[float]] = defaultdict(list)
    for exif in exifs.values():
        if exif.gps_time is not None:
            differences[_get_day(exif)].append(_get_local_s(exif) - seconds_from_time(exif.gps_time))
    found = {}
    for day, seconds in differences.items():
        difference_s = median(seconds)
        zone_s = round(difference_s / _ZONE_STEP_S) * _ZONE_STEP_S
        if abs(difference_s - zone_s) <= _CLOCK_ERROR_S and abs(zone_s) <= _LARGEST_S:
            found[day] = zone_s
    return found


def _apply_offset(photo: Photo, exif: ExifMetadata, offset_s: float, evidence: UtcOffset) -> Photo:
    """The photograph with its time in UTC, and a warning where that contradicts the offset that EXIF states.

    Args:
        photo: the photograph.
        exif: its EXIF.
        offset_s: offset of its clock from UTC, seconds.
        evidence: what tells it.

    Returns:
        the photograph.
    """
    assert exif.taken_at is not None
    shift_s = offset_s - (exif.utc_offset_s or 0.0)
    warnings = photo.metadata_warnings
    if shift_s and exif.utc_offset_s is not None:
        warnings += (
            f"EXIF states the offset {_format_offset(exif.utc_offset_s)} from UTC, GPS time gives "
            f"{_format_offset(offset_s)}; GPS time is used",
        )
    resolved = replace(exif, taken_at=exif.taken_at - timedelta(seconds=shift_s), utc_offset=evidence)
    return replace(photo, exif=resolved, metadata_warnings=warnings)


def _format_offset(seconds: float) -> str:
    minutes = round(abs(seconds) / 60)
    return f"{'-' if seconds < 0 else '+'}{minutes // 60:02d}:{minutes % 60:02d}"
