"""Metadata that are damaged, ambiguous or contradict each other: read with a warning, or refused; never guessed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL.TiffImagePlugin import IFDRational

from benchmarks.exif_bytes import Value
from facadelake.core.arrays import Float64N, Float64Nx2
from facadelake.photos.ingest import ingest_photographs
from tests.unit.photos.small_photographs import XMP, dms, photograph_with

LAT, LON = 48.9405, 8.4078  # deg
RTK = (
    'drone-dji:GpsLatitude="+48.94050000" drone-dji:GpsLongitude="+8.40780000" drone-dji:AbsoluteAltitude="+180.00" '
    'drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.010" drone-dji:RtkStdLat="0.011" drone-dji:RtkStdHgt="0.02"'
)
GPS: dict[int, Value] = {1: "N", 2: dms(LAT), 3: "E", 4: dms(LON), 5: b"\0", 6: IFDRational(18000, 100)}
ASKED = "XMP is used, its sigma covers both; set 'positions: exif' or 'positions: xmp' in the portfolio"


def row_of(folder: Path, content: bytes, distance: object = None) -> dict[str, Any]:
    """The row of one photograph."""
    (folder / "a.jpg").write_bytes(content)
    return {row["photo_id"]: row for row in rows_of(folder, distance)}["a.jpg"]


def rows_of(folder: Path, distance: object = None) -> list[dict[str, Any]]:
    """Rows of table `photos`."""
    return ingest_photographs(folder, distance_to_model_m=distance, close_range_below_m=8.0).to_pylist()  # type: ignore[arg-type]


DAMAGED = {
    "a control character": (RTK + ' drone-dji:SelfData="ab\x01c"').encode(),
    "a bare ampersand": (RTK + ' drone-dji:SelfData="a & b"').encode(),
    "a NUL": (RTK + ' drone-dji:SelfData="a\0"').encode(),
    "an attribute twice": (RTK + ' drone-dji:RtkFlag="50"').encode(),
    "bytes of Latin-1": (RTK + ' drone-dji:SelfData="').encode() + b'\xb0\xc3"',
    "a bracket": (RTK + ' drone-dji:SelfData="a<b"').encode(),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_packet_is_recovered_with_a_warning(name: str, tmp_path: Path) -> None:
    head, tail = XMP.split("{}")
    row = row_of(tmp_path, photograph_with(GPS, xmp=head.encode() + DAMAGED[name] + tail.encode()))
    assert (row["prior_source"], row["prior_sigma_horizontal_m"], row["prior_sigma_vertical_m"]) == ("xmp", 0.011, 0.02)
    assert row["prior_warnings"].startswith("the XMP packet is damaged (")
    assert row["prior_warnings"].endswith(
        " of its properties were recovered: download the photograph from the camera's card again"
    )


def test_a_packet_that_is_cut_off_gives_what_is_whole_of_it(tmp_path: Path) -> None:
    elements = (
        XMP.format("")
        .replace("/></rdf", ">{}</rdf:Description></rdf")
        .format(
            "<drone-dji:GpsLatitude>48.9405</drone-dji:GpsLatitude><drone-dji:GpsLongitude>8.4078</drone-dji:GpsLongitude>"
            "<drone-dji:AbsoluteAltitude>180.00</drone-dji:AbsoluteAltitude>"
        )
    )
    end = elements.index("180.00") + 2  # 18, not 180 m
    row = row_of(tmp_path, photograph_with({}, xmp=elements[:end].encode()))
    assert (row["prior_source"], row["prior_lat_deg"], row["prior_height_m"]) == ("xmp", 48.9405, None)
    assert "the XMP packet is damaged (" in row["prior_warnings"]


def test_a_packet_of_which_nothing_is_left_is_told(tmp_path: Path) -> None:
    row = row_of(tmp_path, photograph_with(GPS, xmp=b"\1\2\3 no packet"))
    assert (row["prior_source"], row["prior_sigma_horizontal_m"]) == ("exif", 5.0)
    assert row["prior_warnings"] == (
        "the XMP packet is damaged (it has no x:xmpmeta); nothing could be recovered from it"
    )
    bomb = b'<x:xmpmeta><!DOCTYPE x [<!ENTITY a "aaaa">]>&a;</x:xmpmeta>'
    assert "nothing could be recovered from it" in row_of(tmp_path, photograph_with(GPS, xmp=bomb))["prior_warnings"]
    blank = b'<?xpacket begin="\xef\xbb\xbf" id="W5M0MpCehiHzreSzNTczkc9d"?>  <?xpacket end="w"?>'
    assert row_of(tmp_path, photograph_with(GPS, xmp=blank))["prior_warnings"] is None


def test_a_packet_without_its_beginning_is_told(tmp_path: Path) -> None:
    """The wrapper is cut off within the processing instruction before it, whose end then is that of the packet."""
    xmp = b"<?xpacket begin='' id='W5M0'?ttp://www.w3.org/1999/02/22-rdf-syntax-ns#\"><rdf:Description " + RTK.encode()
    row = row_of(tmp_path, photograph_with(GPS, xmp=xmp + b"/></rdf:RDF></x:xmpmeta><?xpacket end='w'?>"))
    assert row["prior_source"] == "exif" and "the XMP packet is damaged (" in row["prior_warnings"]
    padding = row_of(tmp_path, photograph_with(GPS, xmp=b"<?xpacket begin='' id='W5M0'?>  \n<?xpacket end='w'?>"))
    assert "XMP" not in (padding["prior_warnings"] or "")


def test_a_position_of_xmp_that_is_none_is_told_where_exif_is_used(tmp_path: Path) -> None:
    xmp = XMP.format('drone-dji:GpsLatitude="0.080193" drone-dji:GpsLongitude="-181.0"').encode()
    row = row_of(tmp_path, photograph_with(GPS, xmp=xmp))
    assert row["prior_source"] == "exif"
    assert row["prior_warnings"].endswith(
        "XMP position lon -181.000000, lat 0.080193 is out of range (lon -180..180, lat -90..90); EXIF is used"
    )


def test_a_value_that_damage_has_changed_is_not_used(tmp_path: Path) -> None:
    """4&8.9405 must not become 48.9405, nor 0.0<11 become 0.0."""
    broken = RTK.replace("+48.94050000", "+4&8.9405")
    row = row_of(tmp_path, photograph_with(GPS, xmp=XMP.format(broken).encode()))
    assert row["prior_source"] == "exif"
    assert "XMP GpsLatitude '+4&8.9405' is not a number; not used" in row["prior_warnings"]


def test_a_property_stated_twice_and_differently_is_not_used(tmp_path: Path) -> None:
    for xmp in (
        XMP.format(RTK + ' drone-dji:RtkFlag="16"'),  # one element, which is not well-formed
        XMP.format(RTK).replace(
            "</rdf:RDF>",
            '<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:RtkFlag="16"/>'
            "</rdf:RDF>",
        ),
    ):
        row = row_of(tmp_path, photograph_with(GPS, xmp=xmp.encode()))
        assert (row["rtk_flag"], row["prior_sigma_horizontal_m"]) == (None, 3.0)
        assert "XMP states RtkFlag as '16' and '50'; not used" in row["prior_warnings"]


def test_positions_of_xmp_and_exif_that_disagree_beyond_their_sigmas(tmp_path: Path) -> None:
    """Positions of post-processing in EXIF, 3.3 m from those of the flight in XMP (1.1 cm) and 0.5 m higher."""
    newer = GPS | {
        2: (IFDRational(48, 1), IFDRational(56, 1), IFDRational(25908000, 1000000)),
        6: IFDRational(18050, 100),
    }
    row = row_of(tmp_path, photograph_with(newer, xmp=XMP.format(RTK).encode()))
    assert row["prior_warnings"] == (
        "the positions disagree by 3.34 m, beyond their sigmas (0.017 m): XMP lat 48.94050000, lon 8.40780000; "
        f"EXIF lat 48.94053000, lon 8.40780000; {ASKED}; "
        f"the heights disagree by 0.50 m, beyond their sigmas (0.048 m): XMP 180.00 m; EXIF 180.50 m; {ASKED}"
    )
    assert row["prior_sigma_horizontal_m"] == pytest.approx(3.34, rel=0, abs=0.01)  # m
    assert row["prior_sigma_vertical_m"] == pytest.approx(0.5, rel=0, abs=0.001)  # m
    agreed = row_of(tmp_path, photograph_with(GPS, xmp=XMP.format(RTK).encode()))
    assert (agreed["prior_warnings"], agreed["prior_sigma_horizontal_m"]) == (None, 0.011)


NO_REFERENCE = (
    "GPSLatitudeRef is missing, so that north or south is unknown; "
    "GPSLongitudeRef is missing, so that east or west is unknown"
)
UNDECIDED = f"{NO_REFERENCE}, and nothing else decides it; write the reference into EXIF"
SANTIAGO: dict[int, Value] = {2: dms(33.45), 4: dms(70.66)}


def test_a_missing_reference_is_not_north_or_east(tmp_path: Path) -> None:
    row = row_of(tmp_path, photograph_with(SANTIAGO))
    assert (row["prior_source"], row["prior_lat_deg"], row["prior_lon_deg"]) == ("none", None, None)
    assert row["reason"] == f"no position prior (EXIF: {UNDECIDED}); the photograph is used without one"
    assert row["prior_warnings"] == f"EXIF position not used: {UNDECIDED}"


def distance_to_santiago(lon_lat_deg: Float64Nx2) -> Float64N:
    distance: Float64N = 111_320 * np.hypot(*(lon_lat_deg - [-70.66, -33.45]).T)
    return distance


def test_a_missing_reference_is_that_of_the_building_or_of_the_other_photographs(tmp_path: Path) -> None:
    row = row_of(tmp_path, photograph_with(SANTIAGO), distance_to_santiago)
    assert (row["prior_lat_deg"], row["prior_lon_deg"]) == pytest.approx((-33.45, -70.66), rel=0, abs=1e-9)  # deg
    assert row["prior_warnings"] == f"{NO_REFERENCE}; taken as S, W by the position of the building"
    for name in ("b.jpg", "c.jpg"):
        (tmp_path / name).write_bytes(photograph_with(SANTIAGO | {1: "S", 3: "W", 29: name}))
    row = row_of(tmp_path, photograph_with(SANTIAGO))
    assert row["prior_warnings"] == f"{NO_REFERENCE}; taken as S, W by the positions of the other photographs"
    near_equator = row_of(tmp_path, photograph_with(SANTIAGO | {2: dms(0.001), 3: "W"}))
    assert near_equator["prior_source"] == "none"


@pytest.mark.parametrize(
    ("lat", "lon"),
    [("South", "West"), ("s", "w"), ("S\0", "W"), (b"S", b"W")],
)
def test_references_in_words_or_lower_case_are_read(lat: str, lon: str, tmp_path: Path) -> None:
    row = row_of(tmp_path, photograph_with(SANTIAGO | {1: lat, 3: lon}))
    assert (row["prior_lat_deg"], row["prior_lon_deg"]) == pytest.approx((-33.45, -70.66), rel=0, abs=1e-9)  # deg


def negative(angle_deg: float) -> tuple[IFDRational, ...]:
    """Signed rationals, as converters write them."""
    return tuple(IFDRational(-part.numerator, part.denominator) for part in dms(angle_deg))


def test_signs_are_read_or_refused(tmp_path: Path) -> None:
    row = row_of(tmp_path, photograph_with({1: "S", 2: negative(33.45), 4: negative(70.66)}))
    assert (row["prior_lat_deg"], row["prior_lon_deg"]) == pytest.approx((-33.45, -70.66), rel=0, abs=1e-9)  # deg
    assert row["prior_warnings"] == (
        "GPSLatitude is negative and its reference is S; taken as S; "
        "GPSLongitude is negative and has no reference; taken as W"
    )
    row = row_of(tmp_path, photograph_with({1: "N", 2: negative(33.45), 3: "W", 4: dms(70.66)}))
    assert row["prior_source"] == "none"
    assert "GPSLatitude is negative and its reference is N, and nothing else decides it" in row["reason"]
    row = row_of(tmp_path, photograph_with({1: "Ost", 2: dms(33.45), 3: "W", 4: dms(70.66)}))
    assert "GPSLatitudeRef is 'Ost', which is neither of N and S" in row["reason"]


DEAD_SEA: dict[int, Value] = {1: "N", 2: dms(31.5), 3: "E", 4: dms(35.47), 6: IFDRational(400, 1)}


@pytest.mark.parametrize("ref", [b"\1", "1", b"1", "Below Sea Level"])
def test_an_altitude_below_the_sea_is_negative_however_it_is_written(ref: object, tmp_path: Path) -> None:
    assert row_of(tmp_path, photograph_with(DEAD_SEA | {5: ref}))["prior_height_m"] == -400.0


def test_an_altitude_of_ambiguous_sign_is_not_used(tmp_path: Path) -> None:
    row = row_of(tmp_path, photograph_with(DEAD_SEA | {5: b"\1", 6: IFDRational(-400, 1)}))
    assert (row["prior_height_m"], row["prior_warnings"]) == (
        None,
        "GPSAltitude is -400.0 m and its reference is 'below'; the height is not used",
    )
    row = row_of(tmp_path, photograph_with(DEAD_SEA | {5: "unten"}))
    assert (row["prior_height_m"], row["prior_warnings"]) == (
        None,
        "GPSAltitudeRef 'unten' is neither above nor below; height 400.0 m is not used",
    )
    row = row_of(tmp_path, photograph_with(DEAD_SEA | {5: b"\0", 6: IFDRational(-400, 1)}))
    assert (row["prior_height_m"], row["prior_warnings"]) == (
        -400.0,
        "GPSAltitude is -400.0 m and its reference is 'above'; taken as below",
    )


UNUSED = IFDRational(0, 0)
OTHER_FORMS = {
    "decimal degrees": (IFDRational(489405, 10000), IFDRational(84078, 10000)),
    "degrees and decimal minutes": (
        (IFDRational(48, 1), IFDRational(56430, 1000)),
        (IFDRational(8, 1), IFDRational(24468, 1000)),
    ),
    "seconds 0/0": (
        (IFDRational(48, 1), IFDRational(56430, 1000), UNUSED),
        (IFDRational(8, 1), IFDRational(24468, 1000), UNUSED),
    ),
    "minutes and seconds 0/0": (
        (IFDRational(489405, 10000), UNUSED, UNUSED),
        (IFDRational(84078, 10000), UNUSED, UNUSED),
    ),
}


@pytest.mark.parametrize("form", OTHER_FORMS)
def test_other_forms_of_an_angle_are_read(form: str, tmp_path: Path) -> None:
    lat, lon = OTHER_FORMS[form]
    row = row_of(tmp_path, photograph_with({1: "N", 2: lat, 3: "E", 4: lon}))
    assert (row["prior_lat_deg"], row["prior_lon_deg"]) == pytest.approx((LAT, LON), rel=0, abs=1e-9)  # deg
    assert row["prior_sigma_horizontal_m"] == pytest.approx(5.5, rel=0, abs=0.5)  # m, with the rounding
    if "0/0" in form:
        assert "GPSLatitude has 0/0 in place of its last part; taken as 48.940500 degrees" in row["prior_warnings"]


REFUSED_ANGLES = {
    "has whole minutes and no seconds": (IFDRational(48, 1), IFDRational(56, 1), UNUSED),
    "has 75 minutes, above 60": (IFDRational(48, 1), IFDRational(75, 1), IFDRational(1, 1)),
    "has a fraction of degrees beside minutes or seconds": (
        IFDRational(489405, 10000), IFDRational(56, 1), IFDRational(25, 1),
    ),
    "has parts of different signs": (IFDRational(48, 1), IFDRational(-56, 1), IFDRational(0, 1)),
    "has a part that is no number": (UNUSED, IFDRational(56, 1), IFDRational(0, 1)),
    "is not degrees, minutes and seconds": "48 56 25",
}  # fmt: skip


@pytest.mark.parametrize("problem", REFUSED_ANGLES)
def test_an_angle_with_two_meanings_is_refused(problem: str, tmp_path: Path) -> None:
    row = row_of(tmp_path, photograph_with(GPS | {2: REFUSED_ANGLES[problem]}))
    assert row["prior_source"] == "none"
    assert "GPSLatitude" in row["reason"] and problem in row["reason"]


def test_the_time_is_that_of_the_last_change_where_there_is_no_other(tmp_path: Path) -> None:
    for detail, said in (
        (
            {306: "2026:04:01 10:00:00"},
            "the time is EXIF DateTime, that of the last change, as there is no DateTimeOriginal",
        ),
        ({36868: "2026:04:01 10:00:00"}, "the time is EXIF DateTimeDigitized, as there is no DateTimeOriginal"),
    ):
        row = row_of(tmp_path, photograph_with(GPS, detail=detail))
        assert (f"{row['taken_at']:%Y-%m-%d %H:%M}", row["prior_warnings"]) == ("2026-04-01 10:00", said)
    row = row_of(tmp_path, photograph_with(GPS, detail={36867: "1 April 2026"}))
    assert (row["taken_at"], row["prior_warnings"]) == (
        None,
        "EXIF DateTimeOriginal '1 April 2026' is not a time of the form 2026:04:14 10:00:05; not used",
    )


def test_a_damaged_exif_block_is_told(tmp_path: Path) -> None:
    """The offset of the GPS block points behind the end of EXIF."""
    content = bytearray(photograph_with(GPS))
    start = content.index(b"Exif\0\0") + 6
    pointer = content.index(b"\x25\x88" if content[start : start + 2] == b"II" else b"\x88\x25", start)
    content[pointer + 8 : pointer + 12] = b"\xff" * 4
    row = row_of(tmp_path, bytes(content))
    assert (row["photo_outcome"], row["prior_source"]) == ("accepted", "none")
    assert "EXIF is damaged (" in row["prior_warnings"]
    assert "): what is damaged of it is not used" in row["prior_warnings"]


def test_a_datum_far_from_wgs_84_is_not_taken_for_it_unless_the_portfolio_names_it(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(photograph_with(GPS | {18: "TOKYO"}))
    (row,) = rows_of(tmp_path)
    assert row["prior_sigma_horizontal_m"] == 500  # m; Tokyo lies 450 m from WGS 84
    assert row["prior_warnings"] == (
        "EXIF GPSMapDatum is TOKYO, read as WGS 84 with a sigma of 500 m: name the CRS of the positions in crs.gnss"
    )
    (named,) = ingest_photographs(
        tmp_path, distance_to_model_m=None, close_range_below_m=8.0, gnss_crs="EPSG:4301"
    ).to_pylist()
    assert named["prior_sigma_horizontal_m"] < 10 and "GPSMapDatum" not in (named["prior_warnings"] or "")


@pytest.mark.parametrize(("method", "sigma_m"), [("CELLID", 1000), ("WLAN", 50), ("MANUAL", 50)])
def test_a_position_that_is_no_receivers(method: str, sigma_m: float, tmp_path: Path) -> None:
    """The cell of a mobile network was taken for a receiver of 5 m."""
    (tmp_path / "a.jpg").write_bytes(photograph_with(GPS | {27: b"ASCII\0\0\0" + method.encode()}))
    (row,) = rows_of(tmp_path)
    assert row["prior_sigma_horizontal_m"] == sigma_m
    assert row["prior_warnings"] == (
        f"EXIF GPSProcessingMethod is {method}: no position of a receiver; its sigma is taken as {sigma_m} m"
    )
    (tmp_path / "a.jpg").write_bytes(photograph_with(GPS | {27: b"ASCII\0\0\0GPS"}))
    (row,) = rows_of(tmp_path)
    assert row["prior_sigma_horizontal_m"] == 5 and not row["prior_warnings"]
