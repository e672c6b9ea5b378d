"""Two positions of one photograph that cannot both be, numbers that are rounded, and accuracies that are none."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL.TiffImagePlugin import IFDRational

from facadelake.core.arrays import Float64N, Float64Nx2
from facadelake.photos.ingest import ingest_photographs
from schemas.vocabulary import PositionSource
from tests.unit.photos.small_photographs import XMP, dms, photograph_with

LAT, LON = 48.9405, 8.4078  # deg
METRES_PER_DEGREE = 111_320.0


def packet(lat: str = "+48.94050000", lon: str = "+8.40780000", height: str = "+180.000", std: str = "0.011") -> bytes:
    """The XMP packet of a photograph with a fixed solution of RTK."""
    return XMP.format(
        f'drone-dji:GpsLatitude="{lat}" drone-dji:GpsLongitude="{lon}" drone-dji:AbsoluteAltitude="{height}" '
        f'drone-dji:RtkFlag="50" drone-dji:RtkStdLon="{std}" drone-dji:RtkStdLat="{std}" drone-dji:RtkStdHgt="0.02"'
    ).encode()


def position(lat: float = LAT, lon: float = LON) -> dict[int, Any]:
    """The GPS block of EXIF."""
    return {
        1: "S" if lat < 0 else "N",
        2: dms(lat),
        3: "W" if lon < 0 else "E",
        4: dms(lon),
        5: b"\0",
        6: IFDRational(180000, 1000),
    }


def distance_to_building(lon_lat_deg: Float64Nx2) -> Float64N:
    """Distance of positions to a building at LON, LAT, m."""
    east = (lon_lat_deg[:, 0] - LON) * math.cos(math.radians(LAT))
    metres: Float64N = METRES_PER_DEGREE * np.hypot(east, lon_lat_deg[:, 1] - LAT)
    return metres


def rows_of(
    folder: Path, photographs: dict[str, bytes], distance: Any = None, positions: PositionSource | None = None
) -> dict[str, dict[str, Any]]:
    """Rows of table `photos` by photograph."""
    for name, content in photographs.items():
        (folder / name).write_bytes(content)
    table = ingest_photographs(folder, distance_to_model_m=distance, close_range_below_m=8.0, positions=positions)
    return {row["photo_id"]: row for row in table.to_pylist()}


MISTAKES = {
    "the sign of the latitude (N/S) changed": {"lat": "-48.94050000"},
    "the sign of the longitude (E/W) changed": {"lon": "-8.40780000"},
    "both signs changed": {"lat": "-48.94050000", "lon": "-8.40780000"},
    "latitude and longitude swapped": {"lat": "+8.40780000", "lon": "+48.94050000"},
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_of_writing_in_xmp_is_named_and_the_position_in_exif_used(mistake: str, tmp_path: Path) -> None:
    """The building decides; the fix is the same one, so that its accuracy and height hold."""
    content = {"a.jpg": photograph_with(position(), xmp=packet(**MISTAKES[mistake]))}
    row = rows_of(tmp_path, content, distance_to_building)["a.jpg"]
    assert (row["prior_source"], row["prior_height_m"], row["prior_sigma_horizontal_m"]) == ("exif", 180.0, 0.011)
    assert row["prior_lat_deg"] == pytest.approx(LAT, rel=0, abs=1e-8)  # deg
    assert f"apart (as with {mistake}); EXIF is used, which lies near the building" in row["prior_warnings"]


def test_a_mistake_of_writing_in_exif_leaves_the_position_in_xmp(tmp_path: Path) -> None:
    row = rows_of(tmp_path, {"a.jpg": photograph_with(position(lon=-LON), xmp=packet())}, distance_to_building)["a.jpg"]
    assert (row["prior_source"], row["prior_lon_deg"], row["prior_sigma_horizontal_m"]) == ("xmp", LON, 0.011)
    assert (
        "XMP lat 48.94050000, lon 8.40780000 and EXIF lat 48.94050000, lon -8.40780000 are 1,230 km apart (as with the "
        "sign of the longitude (E/W) changed); XMP is used, which lies near the building: correct the position in EXIF"
    ) in row["prior_warnings"]


def test_the_other_photographs_decide_where_there_is_no_building(tmp_path: Path) -> None:
    good = {f"{k}.jpg": photograph_with(position(LAT + k * 1e-5), xmp=packet(f"+{LAT + k * 1e-5:.8f}")) for k in (1, 2)}
    row = rows_of(tmp_path, good | {"a.jpg": photograph_with(position(), xmp=packet(lat="-48.94050000"))})["a.jpg"]
    assert (row["prior_source"], row["prior_sigma_horizontal_m"]) == ("exif", 0.011)
    assert "EXIF is used, which lies near the other photographs" in row["prior_warnings"]


def test_neither_is_used_where_nothing_decides(tmp_path: Path) -> None:
    content = {"a.jpg": photograph_with(position(), xmp=packet(lat="-48.94050000"))}
    row = rows_of(tmp_path, content)["a.jpg"]
    assert (row["prior_source"], row["prior_sigma_horizontal_m"], row["photo_outcome"]) == ("none", None, "accepted")
    assert "and nothing decides which one is right; neither is used: correct them, or set" in row["prior_warnings"]
    assert row["reason"].startswith("no position prior (XMP: its position is contradicted by EXIF; EXIF: its position ")
    row = rows_of(tmp_path, content, positions=PositionSource.EXIF)["a.jpg"]
    assert (row["prior_source"], row["prior_sigma_horizontal_m"]) == ("exif", 3.0)


def test_a_position_of_another_place_has_neither_accuracy_nor_height_for_this_one(tmp_path: Path) -> None:
    """XMP of another site (no mistake of writing): its fix says nothing of the position in EXIF."""
    content = {"a.jpg": photograph_with(position(), xmp=packet(lat="+52.50000000", lon="+13.40000000"))}
    row = rows_of(tmp_path, content, distance_to_building)["a.jpg"]
    assert (row["prior_source"], row["prior_sigma_horizontal_m"]) == ("exif", 3.0)
    assert (row["prior_height_m"], row["prior_height_datum"]) == (180.0, "unknown")


@pytest.mark.parametrize(("decimals", "step_m"), [(5, 1.1132), (6, 0.11132), (8, 0.0011132)])
def test_decimals_of_xmp_enter_the_sigma(decimals: int, step_m: float, tmp_path: Path) -> None:
    """RTK of 1.1 cm, written with a resolution of a metre: the sigma is that of a uniform distribution over a step."""
    content = photograph_with({}, xmp=packet(f"{LAT:.{decimals}f}", f"{LON:.{decimals}f}"))
    row = rows_of(tmp_path, {"a.jpg": content})["a.jpg"]
    expected_m = math.hypot(0.011, step_m / math.sqrt(12)) if decimals < 8 else 0.011
    assert row["prior_sigma_horizontal_m"] == pytest.approx(expected_m, rel=1e-9)
    told = row["prior_warnings"] or ""
    assert ("the position is written in steps of" in told) == (decimals < 8)


def test_the_finest_number_of_a_camera_is_its_resolution(tmp_path: Path) -> None:
    """Trailing zeros may be left out in single photographs."""
    lats = ("48.9405", "48.94051234", "48.94052345")
    rows = rows_of(
        tmp_path, {f"{k}.jpg": photograph_with({}, xmp=packet(lat, "8.40781234")) for k, lat in enumerate(lats)}
    )
    assert {row["prior_sigma_horizontal_m"] for row in rows.values()} == {0.011}


@pytest.mark.parametrize("height", ["+180", "+180.0"])
def test_decimals_of_the_height_enter_its_sigma(height: str, tmp_path: Path) -> None:
    row = rows_of(tmp_path, {"a.jpg": photograph_with({}, xmp=packet(height=height))})["a.jpg"]
    step_m = 10.0 ** -len(height.partition(".")[2])
    assert row["prior_sigma_vertical_m"] == pytest.approx(math.hypot(0.02, step_m / math.sqrt(12)), rel=1e-9)
    assert f"the height is written in steps of {step_m:.2g} m" in row["prior_warnings"]


def test_whole_metres_of_exif_enter_the_sigma_of_the_height(tmp_path: Path) -> None:
    """An accuracy of 0.5 m is stated of the position, and so 1 m of the height."""
    gps = position() | {6: IFDRational(180, 1), 31: IFDRational(1, 2)}
    row = rows_of(tmp_path, {"a.jpg": photograph_with(gps)})["a.jpg"]
    assert row["prior_sigma_vertical_m"] == pytest.approx(math.hypot(1.0, 1 / math.sqrt(12)), rel=1e-9)


@pytest.mark.parametrize("std", ["nan", "inf", "-0.01", "0", "0.0"])
def test_an_accuracy_of_rtk_that_is_none_is_told(std: str, tmp_path: Path) -> None:
    row = rows_of(tmp_path, {"a.jpg": photograph_with(position(), xmp=packet(std=std))})["a.jpg"]
    assert (row["prior_sigma_horizontal_m"], row["prior_sigma_vertical_m"]) == (0.02, 0.04)
    assert f"XMP RtkStdLon '{std}' is no accuracy; taken as not stated" in row["prior_warnings"]


def test_an_accuracy_of_exif_that_is_none_is_told(tmp_path: Path) -> None:
    row = rows_of(tmp_path, {"a.jpg": photograph_with(position() | {31: IFDRational(0, 1)})})["a.jpg"]
    assert row["prior_sigma_horizontal_m"] == 5.0
    assert "EXIF GPSHPositioningError 0.0 is no accuracy; taken as not stated" in row["prior_warnings"]
