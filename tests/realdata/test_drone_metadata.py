"""Metadata of photographs that real drones and phones wrote."""

from pathlib import Path
from typing import Any

import pytest

from facadelake.photos.ingest import ingest_photographs

pytestmark = pytest.mark.realdata


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """Rows of table `photos`."""
    return ingest_photographs(folder, distance_to_model_m=None, close_range_below_m=10.0).to_pylist()


def test_full_xmp_without_position_takes_the_position_from_exif(shared_data: Path) -> None:
    """FC300S: attitude and altitude in XMP, latitude and longitude (west) in EXIF alone; the file is an MPO."""
    first = rows_of(shared_data / "drone" / "brighton_beach")[0]
    assert (first["photo_outcome"], first["prior_source"], first["camera_model"]) == ("accepted", "exif", "FC300S")
    assert first["prior_lat_deg"] == pytest.approx(46 + 50 / 60 + 33.3855 / 3600, rel=0, abs=1e-9)  # deg
    assert first["prior_lon_deg"] == pytest.approx(-(91 + 59 / 60 + 40.4156 / 3600), rel=0, abs=1e-9)  # deg
    assert (first["prior_height_m"], first["prior_height_datum"]) == (198.31, "unknown")
    assert (first["prior_yaw_deg"], first["prior_pitch_deg"], first["prior_roll_deg"]) == (45.0, -89.9, 0.0)
    assert (first["prior_sigma_horizontal_m"], first["rtk_flag"]) == (3.0, None)
    assert (first["flight"], first["prior_height_relative_m"], first["prior_warnings"]) == (1, 39.8, None)
    assert first["prior_evidence"] == (
        "EXIF position, a drone's receiver without corrections; XMP height of unknown datum; XMP Gimbal*Degree"
    )


def test_rtk_fix_brings_its_own_sigma_and_an_ellipsoidal_height(shared_data: Path) -> None:
    by_name = {row["photo_id"]: row for row in rows_of(shared_data / "drone" / "mirafiori_rtk")}
    row = by_name["DJI_0020.JPG"]
    assert (row["rtk_flag"], row["prior_source"], row["prior_height_datum"]) == (50, "xmp", "ellipsoidal")
    assert (row["prior_sigma_horizontal_m"], row["prior_sigma_vertical_m"]) == (0.0141, 0.02096)
    assert (row["prior_lat_deg"], row["prior_lon_deg"], row["prior_height_m"]) == (45.03158591, 7.62050179, 349.59)
    assert row["prior_evidence"] == (
        "XMP position, RtkFlag 50 (fixed), RtkStd 0.0108/0.0141/0.02096 m; XMP height ellipsoidal by the RTK fix; "
        "XMP Gimbal*Degree"
    )
    assert {row["rtk_flag"] for row in by_name.values()} == {50}
    assert {row["flight"] for row in by_name.values()} == {1}
    assert {row["prior_warnings"] for row in by_name.values()} == {None}
    assert {row["camera_serial"] for row in by_name.values()} == {"7d2ed18fec733f57faa2ea5415a75c9f"}
    # looking down: which way is up in the photograph is not known, the plumb line is
    assert (row["prior_pitch_deg"], row["prior_sigma_yaw_deg"], row["prior_sigma_tilt_deg"]) == (-89.9, 180.0, 1.0)


def test_dewarp_data_is_the_calibration_of_the_single_camera(shared_data: Path) -> None:
    """P4 Multispectral: 1913.3 px designed, fx 1973.09 and fy 1955.65 px calibrated, centre from the photograph's."""
    row = rows_of(shared_data / "drone" / "mirafiori_rtk")[1]
    assert row["prior_focal_px"] == pytest.approx((1973.0899658 + 1955.6500244) / 2, rel=0, abs=1e-6)  # px
    assert row["prior_sigma_focal_px"] == pytest.approx(5.9, rel=0, abs=0.1)  # px
    # 1600 x 1300 px: 1964.37 * 43.2666 / 2061.55
    assert row["focal_length_35mm_mm"] == pytest.approx(41.227, rel=0, abs=0.001)  # mm
    numbers = [float(number) for number in row["prior_calibration"].split(",")]
    wanted = [1973.0899658, 1955.6500244, 800 - 19.0419922, 650 - 11.4249878, -0.42275, 0.369101, 0.0040638, 0.0040638]
    assert numbers == pytest.approx([*wanted, -0.264306], rel=0, abs=1e-6)  # px and none


def test_handheld_street_photographs_have_a_position_and_no_attitude(shared_data: Path) -> None:
    rows = rows_of(shared_data / "drone" / "lund_street")
    assert len(rows) == 29
    assert {(row["photo_outcome"], row["prior_source"], row["prior_height_datum"]) for row in rows} == {
        ("accepted", "exif", "unknown")
    }
    assert all(row["prior_yaw_deg"] is None for row in rows)
    assert all(55.6 < row["prior_lat_deg"] < 55.8 and 13.1 < row["prior_lon_deg"] < 13.3 for row in rows)
    # an iPhone 4S through an app that writes GPSDOP 5 or 10, in steps of 0.1 seconds of arc or finer
    assert {row["prior_sigma_horizontal_m"] for row in rows} == {15.0, 30.0}
    assert {row["prior_evidence"].split(";")[0] for row in rows} == {
        "EXIF position, GPSDOP 5 of 3 m",
        "EXIF position, GPSDOP 10 of 3 m",
    }
    assert {(row["flight"], row["taken_at"], row["prior_warnings"]) for row in rows} == {(1, None, None)}


def test_an_oblique_view_looks_at_the_horizon(shared_data: Path) -> None:
    (row,) = rows_of(shared_data / "drone" / "mmd_oblique")
    assert (row["prior_yaw_deg"], row["prior_pitch_deg"], row["prior_roll_deg"]) == (47.8, 0.0, 0.0)
    # 14.4 m "above sea level" and 25.4 m above take-off, by the Baltic: a barometer's height
    said = (row["prior_height_m"], row["prior_height_relative_m"], row["prior_height_datum"])
    assert said == (14.4, 25.4, "unknown")
    assert (row["prior_sigma_yaw_deg"], row["prior_sigma_tilt_deg"]) == (5.0, 1.0)
    # calibrated for the 16:9 crop, where EXIF's 26 mm are the whole sensor's (2757 px)
    assert (row["prior_focal_px"], row["prior_focal_evidence"]) == (3051.613037, "XMP CalibratedFocalLength")
