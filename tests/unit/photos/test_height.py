"""The datum of heights, and orthometric heights converted to ellipsoidal where a grid is installed."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from facadelake.photos.drone_xmp import DroneMetadata
from facadelake.photos.exif import ExifMetadata
from facadelake.photos.position_prior import derive_position_prior, infer_height_datum

PARROT = DroneMetadata(maker="Parrot", lat_deg=48.94, lon_deg=8.4, absolute_altitude_m=120.0)


@pytest.mark.parametrize(
    ("drone", "exif", "datum"),
    [
        (None, ExifMetadata(altitude_ref=0), "unknown"),  # claims sea level; Android writes ellipsoidal heights there
        (None, ExifMetadata(altitude_ref=1), "unknown"),
        (None, ExifMetadata(altitude_ref=2), "ellipsoidal"),
        (DroneMetadata(maker="DJI", rtk_flag=50), ExifMetadata(altitude_ref=0), "ellipsoidal"),
        (DroneMetadata(maker="DJI", rtk_flag=34), ExifMetadata(altitude_ref=0), "unknown"),
        (PARROT, ExifMetadata(model="ANAFI Ai"), "ellipsoidal"),
        (PARROT, ExifMetadata(model="Anafi Thermal"), "orthometric"),
        (PARROT, ExifMetadata(model="Bebop 2"), "unknown"),
    ],
)
def test_a_datum_needs_evidence(drone: DroneMetadata | None, exif: ExifMetadata, datum: str) -> None:
    assert infer_height_datum(drone, exif).datum == datum


def test_without_a_grid_a_height_above_the_geoid_stays_what_it_is() -> None:
    prior = derive_position_prior(PARROT, ExifMetadata(model="ANAFI"))
    assert (prior.height_m, prior.height_datum) == (120.0, "orthometric")
    assert prior.evidence.endswith("XMP height above EGM96 by Parrot's documentation")


def test_with_a_grid_it_is_made_ellipsoidal_and_the_grid_is_named(tmp_path: Path) -> None:
    """In a process of its own, for PROJ's folders are of the whole process; the grid is 47.25 m everywhere."""
    header = struct.pack(">ddddii", -90, -180, 10, 10, 19, 37)  # GTX: lower left, steps, rows, columns
    (tmp_path / "egm96_15.gtx").write_bytes(header + np.full((19, 37), 47.25, dtype=">f4").tobytes())
    code = (
        "import sys; from pyproj import datadir; datadir.append_data_dir(sys.argv[1])\n"
        "from tests.unit.photos.test_height import PARROT, ExifMetadata, derive_position_prior\n"
        "prior = derive_position_prior(PARROT, ExifMetadata(model='ANAFI'))\n"
        "print(prior.height_m, prior.height_datum, prior.evidence, sep='|')"
    )
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        cwd=root,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    height, datum, evidence = done.stdout.strip().split("|")
    assert float(height) == pytest.approx(167.25, rel=0, abs=1e-4)  # m
    assert datum == "ellipsoidal"
    assert evidence.endswith(
        "XMP height above EGM96 by Parrot's documentation, "
        "120.00 m converted to ellipsoidal by grid us_nga_egm96_15.tif"
    )
