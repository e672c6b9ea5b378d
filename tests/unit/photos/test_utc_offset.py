"""Times of cameras whose EXIF states no offset from UTC."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from PIL.TiffImagePlugin import IFDRational

from benchmarks.exif_bytes import Value
from facadelake.photos.ingest import ingest_photographs
from facadelake.photos.utc_offset import describe_unknown_offsets
from tests.unit.photos.small_photographs import dms, photograph_with

PLACE: dict[int, Value] = {1: "N", 2: dms(48.9405), 3: "E", 4: dms(8.4078)}
UNKNOWN = (
    "2 of 2 photographs state no offset of their clock from UTC, and nothing else tells it: their times are taken as "
    "UTC, also those of observations and defects, and may be hours off (limit 14 h); set the camera to write "
    "OffsetTimeOriginal, or GPS time"
)


def gps_time(hour: int, minute: int, second: int = 5, day: str = "2026:04:14") -> dict[int, Value]:
    """GPSTimeStamp and GPSDateStamp."""
    return {7: (IFDRational(hour, 1), IFDRational(minute, 1), IFDRational(second, 1)), 29: day}


def rows_of(folder: Path, *photographs: tuple[dict[int, Value], dict[int, Value]]) -> list[dict[str, Any]]:
    """Rows of table `photos` of photographs with these GPS and Exif blocks."""
    for k, (gps, detail) in enumerate(photographs):
        block = {36867: f"2026:04:14 10:00:{5 + k:02d}", 37500: f"{k}"} | detail
        (folder / f"{k}.jpg").write_bytes(photograph_with(PLACE | gps, detail=block))
    table = ingest_photographs(folder, distance_to_model_m=None, close_range_below_m=8.0)
    return table.to_pylist()


@pytest.mark.parametrize(
    ("gps", "detail", "hour", "minute", "evidence"),
    [
        ({}, {36881: "+02:00"}, 8, 0, "stated"),
        ({}, {36880: "-03:30"}, 13, 30, "stated"),  # OffsetTime, of the same clock
        (gps_time(8, 0), {}, 8, 0, "gps_time"),
        (gps_time(4, 15), {}, 4, 15, "gps_time"),  # Nepal, +05:45
        (gps_time(8, 1), {}, 8, 0, "gps_time"),  # the clock is a minute off
        (gps_time(8, 0), {36881: "+02:00"}, 8, 0, "stated"),
        ({}, {}, 10, 0, "unknown"),
        ({}, {36881: "   :  "}, 10, 0, "unknown"),  # blanks: unknown, by the standard
        (gps_time(8, 7, 30), {}, 10, 0, "unknown"),  # no time zone: a clock that is wrong
        (gps_time(8, 0, day="2026:03:01"), {}, 10, 0, "unknown"),
    ],
)
def test_what_tells_the_offset(
    gps: dict[int, Value], detail: dict[int, Value], hour: int, minute: int, evidence: str, tmp_path: Path
) -> None:
    (row,) = rows_of(tmp_path, (gps, detail))
    assert (row["taken_at"], row["utc_offset"]) == (datetime(2026, 4, 14, hour, minute, 5, tzinfo=UTC), evidence)


def test_other_photographs_of_the_camera_tell_it(tmp_path: Path) -> None:
    """Else the photograph without an offset would be two hours from its neighbours, in a flight of its own."""
    rows = rows_of(tmp_path, ({}, {36881: "+02:00"}), ({}, {}))
    assert [row["utc_offset"] for row in rows] == ["stated", "same_camera"]
    assert [row["taken_at"].hour for row in rows] == [8, 8]
    assert [row["flight"] for row in rows] == [1, 1]


def test_an_unknown_offset_is_told_once_for_the_campaign(tmp_path: Path) -> None:
    rows_of(tmp_path, ({}, {}), ({}, {}))
    table = ingest_photographs(tmp_path, distance_to_model_m=None, close_range_below_m=8.0)
    assert describe_unknown_offsets(table) == UNKNOWN
    assert [row["prior_warnings"] for row in table.to_pylist()] == [None, None]


def test_an_offset_that_gps_time_contradicts_is_told(tmp_path: Path) -> None:
    """The clock shows local time, and EXIF says that it is UTC."""
    (row,) = rows_of(tmp_path, (gps_time(8, 0), {36881: "+00:00"}))
    assert (row["taken_at"].hour, row["utc_offset"]) == (8, "gps_time")
    assert row["prior_warnings"] == ("EXIF states the offset +00:00 from UTC, GPS time gives +02:00; GPS time is used")


def test_an_offset_that_is_none_is_told_and_the_time_is_kept(tmp_path: Path) -> None:
    (row,) = rows_of(tmp_path, ({}, {36881: "CEST"}))
    assert (row["taken_at"].hour, row["utc_offset"]) == (10, "unknown")
    assert row["prior_warnings"] == "EXIF OffsetTimeOriginal 'CEST' is not an offset of the form +02:00; not used"
