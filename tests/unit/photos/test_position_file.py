"""Files of positions as RTKLIB, Emlid, Pix4D and others write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.photos.ingest import ingest_photographs
from facadelake.photos.position_sigma import PositionSigma
from facadelake.photos.positions_file.table import PositionFile, PositionFileFormat, read_position_file
from schemas.vocabulary import HeightDatum, PositionSource
from tests.unit.photos.small_photographs import photograph

# Latitude, longitude, height and sigmas of one photograph, in the form of each program.
RTKLIB = """% program   : RTKPOST ver.2.4.3
% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)
%  name      GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)
a.jpg 2026/04/14 10:00:05.000   48.940512345    8.407812345   180.5123   1  17   0.0110   0.0090   0.0210
"""
EMLID = """\
Name,Code,Easting,Northing,Elevation,Longitude,Latitude,Ellipsoidal height,Easting RMS,Northing RMS,Elevation RMS
"a.jpg",,456789.1,5421033.2,132.1,8.407812345,48.940512345,180.5123,0.009,0.011,0.021
"""
PIX4D = """\
imagename,latitude [decimal degrees],longitude [decimal degrees],altitude [m],accuracy horz [m],accuracy vert [m]
a.jpg,48.940512345,8.407812345,180.5123,0.011,0.021
"""
GERMAN = """Name;Latitude;Longitude;Height;sigma_horizontal_m;sigma_vertical_m
a.jpg;48,940512345;8,407812345;180,5123;0,011;0,021
"""
TABS = "#image\tlon\tlat\tz\tsde\tsdn\tsdu\na.jpg\t8.407812345\t48.940512345\t180.5123\t0.009\t0.011\t0.021\n"
PLAIN = "a.jpg 8.407812345 48.940512345 180.5123\n"
AS_WRITTEN = PositionFileFormat()
SIGMA = PositionSigma(horizontal_m=0.011, vertical_m=0.021)


def read(folder: Path, text: str, layout: PositionFileFormat = AS_WRITTEN) -> PositionFile:
    """The file of this text."""
    path = folder / "ppk.csv"
    path.write_text(text, encoding="utf-8")
    return read_position_file(path, layout)


@pytest.mark.parametrize(
    ("text", "datum"),
    [
        (RTKLIB, HeightDatum.ELLIPSOIDAL),
        (RTKLIB.replace("WGS84/ellipsoidal", "WGS84/geodetic"), HeightDatum.ORTHOMETRIC),
        (EMLID, HeightDatum.ELLIPSOIDAL),
        (PIX4D, HeightDatum.UNKNOWN),
        (GERMAN, HeightDatum.UNKNOWN),
        (TABS, HeightDatum.UNKNOWN),
        ("\ufeff" + PIX4D.replace("\n", "\r\n"), HeightDatum.UNKNOWN),
    ],
)
def test_the_columns_of_the_programs_are_recognised(text: str, datum: HeightDatum, tmp_path: Path) -> None:
    prior = read(tmp_path, text).positions["a.jpg"]
    assert (prior.source, prior.lat_deg, prior.lon_deg) == (PositionSource.FILE, 48.940512345, 8.407812345)
    assert (prior.height_m, prior.height_datum, prior.sigma) == (180.5123, datum, SIGMA)


def test_a_file_without_header_needs_the_names_of_its_columns(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="has no column of photograph and latitude and longitude; give a header"):
        read(tmp_path, PLAIN + PLAIN.replace("a.jpg", "b.jpg"))
    layout = PositionFileFormat(columns=("name", "lon", "lat", "height"), sigma=SIGMA)
    prior = read(tmp_path, PLAIN, layout).positions["a.jpg"]
    assert (prior.lat_deg, prior.sigma) == (48.940512345, SIGMA)


def test_exif_counts_where_the_portfolio_says_so(tmp_path: Path) -> None:
    """Positions of PPK in EXIF: with their own accuracy where it is stated, never with that of the fix in XMP."""
    rtk = (
        'drone-dji:GpsLatitude="48.94050000" drone-dji:GpsLongitude="8.40780000" drone-dji:AbsoluteAltitude="180.00" '
        'drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.010" drone-dji:RtkStdLat="0.011" drone-dji:RtkStdHgt="0.02"'
    )
    (tmp_path / "a.jpg").write_bytes(photograph(lat=48.94053, lon=8.4078, xmp=rtk))

    def prior(positions: PositionSource | None) -> tuple[object, ...]:
        (row,) = ingest_photographs(
            tmp_path, distance_to_model_m=None, close_range_below_m=8.0, positions=positions
        ).to_pylist()
        assert "the positions disagree by 3.34 m" in row["prior_warnings"]
        return tuple(row[f"prior_{name}"] for name in ("source", "lat_deg", "height_m", "sigma_horizontal_m"))

    assert prior(PositionSource.EXIF) == ("exif", pytest.approx(48.94053), 180.5, 3.0)
    assert prior(PositionSource.XMP) == ("xmp", 48.9405, 180.0, 0.011)
    assert prior(None) == ("xmp", 48.9405, 180.0, pytest.approx(3.34, rel=0, abs=0.01))
