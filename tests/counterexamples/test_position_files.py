"""Files of positions that could be misread, contradict the photographs or do not name them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.photos.ingest import ingest_photographs
from facadelake.photos.position_sigma import SIGMA_DRONE, SIGMA_RTK_FIXED
from facadelake.photos.positions_file.matching import match_positions
from facadelake.photos.positions_file.registered import list_position_remarks
from facadelake.photos.positions_file.table import PositionFileFormat
from facadelake.registry import Building
from schemas.vocabulary import HeightDatum
from tests.unit.photos.small_photographs import photograph
from tests.unit.photos.test_position_file import EMLID, PIX4D, RTKLIB, read

NO_COLUMNS = (
    " has no column of photograph and latitude and longitude; give a header such as 'name,latitude,longitude,"
    "ellipsoidal height,sigma_horizontal_m,sigma_vertical_m', or name the columns in the portfolio (positions: {file, "
    "columns})"
)


def test_the_portfolio_states_the_datum_where_the_file_does_not(tmp_path: Path) -> None:
    prior = read(tmp_path, PIX4D, PositionFileFormat(vertical="ellipsoidal")).positions["a.jpg"]
    assert prior.height_datum is HeightDatum.ELLIPSOIDAL
    with pytest.raises(InputDataError) as raised:
        read(tmp_path, EMLID, PositionFileFormat(vertical="EPSG:5773"))
    assert (
        "states that its heights are ellipsoidal, the portfolio 'vertical: EPSG:5773'; correct the one that is wrong"
    ) in str(raised.value)


def test_a_file_without_header_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        read(tmp_path, "a.jpg 8.407812345 48.940512345 180.5123")
    assert str(raised.value) == f"the positions file {tmp_path / 'ppk.csv'}" + NO_COLUMNS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (PIX4D.replace("altitude [m]", "altitude [ft]"), "column 'altitude [ft]' is in ft; give degrees and metres"),
        (PIX4D.replace("altitude [m]", "alt_ft"), "column 'alt_ft' is in ft; give degrees and metres"),
        (PIX4D.replace("altitude [m]", "altitude_feet"), "column 'altitude_feet' is in feet; give degrees and metres"),
        (PIX4D.replace("accuracy horz [m]", "height [m]"), "two columns are the height"),
        (RTKLIB.replace("%  name", "%").replace("a.jpg ", ""), "has no column of photograph"),
        (PIX4D.replace("48.9405", "x"), "has no usable line: line 2 (a.jpg,x"),
        (PIX4D.replace("48.9405", "98.9405"), "is out of range"),
        ("", "is empty"),
    ],
)
def test_a_file_that_could_be_misread_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        read(tmp_path, text)
    assert message in str(raised.value)


REFERENCES = "SourceFile,GPSLatitude,GPSLatitudeRef,GPSLongitude,GPSLongitudeRef,GPSAltitude,GPSAltitudeRef\n"


@pytest.mark.parametrize("references", [("S", "W", "1"), ("South", "West", "Below Sea Level")])
def test_references_give_the_signs(references: tuple[str, str, str], tmp_path: Path) -> None:
    south, west, below = references
    prior = read(tmp_path, REFERENCES + f"a.jpg,33.45123456,{south},70.66123456,{west},400,{below}\n").positions[
        "a.jpg"
    ]
    assert (prior.lat_deg, prior.lon_deg, prior.height_m) == (-33.45123456, -70.66123456, -400.0)


def test_references_that_say_nothing_are_told(tmp_path: Path) -> None:
    text = REFERENCES + "a.jpg,33.45123456,N,70.66123456,E,400,0\n"
    file = read(tmp_path, text + "b.jpg,33.45123456,X,70.66123456,E,400,0\nc.jpg,33.45123456,N,70.66123456,,400,0\n")
    assert list(file.positions) == ["a.jpg"]
    assert "GPSLatitudeRef is 'X', which is neither of N and S" in file.problems[0]
    assert "GPSLongitudeRef is missing, so that east or west is unknown" in file.problems[1]
    reordered = "name,lat,lon,latref,lonref\na.jpg,33.45123456,70.66123456,N,E\nb.jpg,33.45123456,70.66123456\n"
    assert list(read(tmp_path, reordered).positions) == ["a.jpg"]
    prior = read(tmp_path, text.replace("400,0", "400,unten")).positions["a.jpg"]
    assert math.isnan(prior.height_m)
    assert "GPSAltitudeRef 'unten' is neither above nor below; height 400.0 m is not used" in prior.warnings
    ellipsoidal = read(tmp_path, text.replace("400,0", "400,2"))
    assert ellipsoidal.positions["a.jpg"].height_datum is HeightDatum.ELLIPSOIDAL
    with pytest.raises(
        InputDataError, match="its height reference 2 is the ellipsoid, and the heights are orthometric"
    ):
        read(tmp_path, text.replace("400,0", "400,2"), PositionFileFormat(vertical="EPSG:5773"))


def test_a_height_that_is_not_a_number_is_told(tmp_path: Path) -> None:
    line = "{};48,940512345;8,407812345;{}\n"
    text = "name;lat;lon;height\n" + line.format("a.jpg", "180,5") + line.format("b.jpg", "1.180,2")
    file = read(tmp_path, text + line.format("c.jpg", "inf") + line.format("d.jpg", ""))
    assert list(file.positions) == ["a.jpg", "d.jpg"]  # d.jpg states no height
    assert file.problems == (
        "line 3 (b.jpg;48,940512345;8,407812345;1.180,2): height '1.180,2' is not a number",
        "line 4 (c.jpg;48,940512345;8,407812345;inf): height 'inf' is not a number",
    )


def test_accuracy_that_is_not_stated_is_told(tmp_path: Path) -> None:
    columns = ("name", "lat", "lon", "height")
    prior = read(tmp_path, "a.jpg 48.940512345 8.407812345 180.5", PositionFileFormat(columns=columns)).positions[
        "a.jpg"
    ]
    assert (prior.sigma, prior.warnings) == (SIGMA_DRONE, ("ppk.csv states no accuracy; taken as 3/5 m",))
    fixed = read(tmp_path, "name,lat,lon,Q\na.jpg,48.940512345,8.407812345,1\n").positions["a.jpg"]
    assert fixed.sigma == SIGMA_RTK_FIXED
    assert math.isnan(fixed.height_m)
    coarse = read(tmp_path, PIX4D.replace("512345", "5").replace("812345", "8")).positions["a.jpg"]
    assert coarse.warnings == ("ppk.csv: the position is written in steps of 11 m",)
    assert coarse.sigma.horizontal_m == pytest.approx(11.132 / math.sqrt(12), rel=0, abs=0.001)  # m


def test_bad_lines_and_names_are_told_and_the_others_are_used(tmp_path: Path) -> None:
    line = "{},48.940512345,8.407812345,180.5123,0.011,0.021\n"
    text = PIX4D + line.format("D:\\flight\\b.JPG") + line.format("x.jpg") + line.format("c.jpg").replace("180", "190")
    text += line.format("c.jpg") + "d.jpg,,,,,\n"
    matched = match_positions(read(tmp_path, text), ["a.jpg", "b.jpg", "c.jpg", "d.jpg"])
    assert sorted(matched.by_photo) == ["a.jpg", "b.jpg"]
    assert matched.remarks == (
        "ppk.csv: 2 lines are not used: line 7 (d.jpg,,,,,): no position; 'c.jpg' has 2 different positions",
        "ppk.csv: 1 names are no photographs of the campaign: 'x.jpg' is not among the campaign's photographs",
        "ppk.csv: 2 photographs are not in it, whose own metadata are used: c.jpg; d.jpg",
    )
    with pytest.raises(InputDataError) as raised:
        match_positions(read(tmp_path, text), ["e.jpg"])
    assert str(raised.value) == (
        f"none of the 3 names in the positions file {tmp_path / 'ppk.csv'} is a photograph of the campaign ('a.jpg' is "
        "not among the campaign's photographs); give the file of this campaign, with the photographs' file names"
    )


def test_the_positions_of_the_file_are_those_of_the_photographs(tmp_path: Path) -> None:
    root = tmp_path / "photographs"
    root.mkdir()
    rtk = (
        'drone-dji:GpsLatitude="48.94050000" drone-dji:GpsLongitude="8.40780000" drone-dji:AbsoluteAltitude="180.00" '
        'drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.010" drone-dji:RtkStdLat="0.011" drone-dji:RtkStdHgt="0.02"'
    )
    for seed, name in enumerate(("a.jpg", "b.jpg")):
        (root / name).write_bytes(photograph(xmp=rtk, seed=seed))
    file = read(tmp_path, EMLID)
    rows = {
        row["photo_id"]: row
        for row in ingest_photographs(
            root, distance_to_model_m=None, close_range_below_m=8.0, positions=file
        ).to_pylist()
    }
    named, unnamed = rows["a.jpg"], rows["b.jpg"]
    assert (named["prior_source"], named["prior_lat_deg"], named["prior_height_m"]) == ("file", 48.940512345, 180.5123)
    assert (named["prior_sigma_horizontal_m"], named["prior_height_datum"]) == (0.011, "ellipsoidal")
    assert named["prior_evidence"].startswith(
        "ppk.csv line 2, stated sigma 0.011/0.021 m; height ellipsoidal by the file"
    )
    assert named["prior_warnings"] == (
        "the position of the file (lat 48.94051235, lon 8.40781234) is 1.64 m from that of XMP (lat 48.94050000, lon "
        "8.40780000), beyond three sigmas of their difference (0.047 m); the file is used, as the portfolio says; "
        "the height of the file, 180.51 m, is 0.51 m from 180.00 m of XMP, beyond three sigmas of their difference "
        "(0.087 m); the file is used, as the portfolio says"
    )
    assert (unnamed["prior_source"], unnamed["prior_warnings"]) == ("xmp", "not in the positions file; XMP is used")


def test_the_inspection_warns_before_it_begins(tmp_path: Path) -> None:
    root = tmp_path / "photos"
    root.mkdir()
    for seed, name in enumerate(("a.jpg", "b.jpg")):
        (root / name).write_bytes(photograph(seed=seed))
    (root / "a.CR2").write_bytes(b"x")
    (tmp_path / "ppk.csv").write_text(EMLID.replace("a.jpg", "A.JPG"))
    building = Building.model_validate(
        {
            "id": "hall",
            "name": "Hall",
            "model": "as-built",
            "photographs": str(root),
            "campaigns": ["2026-04"],
            "crs": {"map": "EPSG:25832", "vertical": "ellipsoidal"},
            "positions": {"file": str(tmp_path / "ppk.csv")},
        }
    )
    assert list_position_remarks(building, "2026-04") == (
        "ppk.csv: 1 photographs are not in it, whose own metadata are used: b.jpg",
    )


PLAIN = "name,latitude,longitude,{heights}{sigmas}\na.jpg,48.940512345,8.407812345,{values}\n"
HEIGHT = {"ellipsoidal height": "180.5123"}


def text_with(heights: dict[str, str], sigmas: dict[str, str]) -> str:
    """A file with these columns of heights and accuracies."""
    return PLAIN.format(
        heights=",".join(heights) + ",", sigmas=",".join(sigmas), values=",".join([*heights.values(), *sigmas.values()])
    )


@pytest.mark.parametrize(
    ("names", "values"),
    [
        (("sigma_horizontal_mm", "sigma_vertical_mm"), ("11", "21")),
        (("accuracy horz [cm]", "accuracy vert [cm]"), ("1.1", "2.1")),
        (("sde_mm", "sdn_mm", "sdu(mm)"), ("9", "11", "21")),
        (("sigma_horizontal", "sigma_vertical"), ("0.011", "0.021")),
    ],
)
def test_accuracies_are_read_in_the_unit_of_their_column(
    names: tuple[str, ...], values: tuple[str, ...], tmp_path: Path
) -> None:
    file = read(tmp_path, text_with(HEIGHT, dict(zip(names, values, strict=True))))
    sigma = file.positions["a.jpg"].sigma
    assert (sigma.horizontal_m, sigma.vertical_m) == pytest.approx((0.011, 0.021), rel=1e-12)
    assert file.remarks == ()


def test_accuracies_that_may_be_in_another_unit_are_told_or_refused(tmp_path: Path) -> None:
    millimetres = {"sigma_horizontal": "11", "sigma_vertical": "21"}
    file = read(tmp_path, text_with(HEIGHT, millimetres))
    assert file.remarks == (
        "ppk.csv: column 'sigma_vertical' states no unit, and its median is 21; taken as m, the accuracy of a receiver "
        "without corrections; in mm this is 0.021 m, in cm 0.21 m: write the unit into its name, such as "
        "'sigma_vertical_mm', 'sigma_vertical_cm' or 'sigma_vertical_m'",
    )
    for refused, limit in (
        (text_with(HEIGHT, millimetres | {"Q": "1"}), "fixed solutions (Q 1) have less than 1 m"),
        (text_with(HEIGHT, {"sigma_horizontal": "110", "sigma_vertical": "210"}), "limit 100 m"),
    ):
        with pytest.raises(InputDataError) as raised:
            read(tmp_path, refused)
        assert f"which is no accuracy in m ({limit}); in mm this is" in str(raised.value)
    stated = text_with(HEIGHT, {"sigma_horizontal_m": "11", "sigma_vertical_m": "21"})
    assert read(tmp_path, stated).remarks == ()


@pytest.mark.parametrize("value", ["nan", "inf", "-0.011", "0"])
def test_an_accuracy_that_is_none_is_told_and_not_taken_as_that_of_rtk(value: str, tmp_path: Path) -> None:
    prior = read(tmp_path, text_with(HEIGHT, {"sigma_horizontal_m": value, "sigma_vertical_m": "0.5"})).positions[
        "a.jpg"
    ]
    assert (prior.sigma.horizontal_m, prior.sigma.vertical_m) == (3.0, 0.5)
    assert f"ppk.csv: sigma_horizontal_m '{value}' is no accuracy; taken as not stated" in prior.warnings
    fixed = text_with(HEIGHT, {"sigma_horizontal_m": "0.5", "sigma_vertical_m": value, "Q": "1"})
    assert read(tmp_path, fixed).positions["a.jpg"].sigma.vertical_m == 0.5  # not the 4 cm of a fix


@pytest.mark.parametrize("name", ["alt_msl", "Altitude MSL (m)", "orthometric_height_m", "AMSL"])
def test_heights_above_sea_level_are_read_as_such(name: str, tmp_path: Path) -> None:
    sigmas = {"sigma_horizontal_m": "0.011", "sigma_vertical_m": "0.021"}
    file = read(tmp_path, text_with({name: "132.1234"}, sigmas))
    prior = file.positions["a.jpg"]
    assert (prior.height_m, prior.height_datum, file.remarks) == (132.1234, HeightDatum.ORTHOMETRIC, ())
    both = read(tmp_path, text_with({name: "132.1234", "height": "180.5123"}, sigmas))
    assert both.positions["a.jpg"].height_m == 132.1234
    assert both.remarks == (f"ppk.csv: heights are those of column '{name}'; not used: height",)
    stated = read(tmp_path, text_with({name: "132.1234"} | HEIGHT, sigmas))
    assert (stated.positions["a.jpg"].height_m, stated.remarks) == (180.5123, ())


def test_columns_of_letters_give_the_hemisphere_and_numbers_of_satellites_do_not(tmp_path: Path) -> None:
    text = "name,lat,ns,lon,ew,sigma_horizontal_m,sigma_vertical_m\na.jpg,33.45123456,{},70.66123456,{},0.01,0.02\n"
    prior = read(tmp_path, text.format("S", "W")).positions["a.jpg"]
    assert (prior.lat_deg, prior.lon_deg) == (-33.45123456, -70.66123456)
    satellites = read(tmp_path, text.replace(",ew", ",ratio").format("17", "99.9")).positions["a.jpg"]
    assert (satellites.lat_deg, satellites.lon_deg) == (33.45123456, 70.66123456)


def test_columns_that_may_be_heights_or_accuracies_are_told(tmp_path: Path) -> None:
    file = read(tmp_path, text_with({"Hoehe_NHN": "132.1"}, {"m_accuracy_2drms": "0.011"}))
    assert file.remarks == (
        "ppk.csv: columns not recognised, and not used: Hoehe_NHN, m_accuracy_2drms; recognised are 'ellipsoidal "
        "height', 'orthometric height', 'sigma_horizontal_m', 'sigma_vertical_m' and the like",
    )
    assert match_positions(file, ["a.jpg"]).remarks == file.remarks


def test_decimals_of_the_height_enter_its_sigma(tmp_path: Path) -> None:
    file = read(tmp_path, text_with({"height": "180"}, {"sigma_horizontal_m": "0.011", "sigma_vertical_m": "0.021"}))
    prior = file.positions["a.jpg"]
    assert prior.sigma.vertical_m == pytest.approx(math.hypot(0.021, 1 / math.sqrt(12)), rel=1e-12)
    assert prior.warnings == ("ppk.csv: the height is written in steps of 1 m",)


@pytest.mark.parametrize("quality", ["1", "0.85"])
def test_a_column_quality_is_no_rtklib_solution(quality: str, tmp_path: Path) -> None:
    """In NMEA 1 is a fix without corrections, in Metashape it is the picture's: once read as a fix of 2 cm."""
    text = f"name,latitude,longitude,height,quality\na.jpg,48.940512345,8.407812345,180.5123,{quality}\n"
    file = read(tmp_path, text)
    assert file.positions["a.jpg"].sigma == SIGMA_DRONE
    assert "ppk.csv: columns not recognised, and not used: quality; " in file.remarks[0]
    solution = read(tmp_path, text.replace("quality", "Q").replace(f",{quality}\n", ",1\n"))
    assert solution.positions["a.jpg"].sigma == SIGMA_RTK_FIXED


def test_a_line_with_more_fields_than_columns_is_not_read(tmp_path: Path) -> None:
    """1.180,12 is 1,180.12 m; once its first part was a height of 1.18 m."""
    text = "name,latitude,longitude,height\na.jpg,48.940512,8.407812,180.5,\nb.jpg,48.940512,8.407812,1.180,12\n"
    file = read(tmp_path, text)
    assert list(file.positions) == ["a.jpg"]
    assert "): 5 fields for 4 columns (a decimal comma, or a blank in a name?)" in file.problems[0]


def test_an_angle_that_is_no_number_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputDataError) as raised:
        read(tmp_path, "name,latitude,longitude\na.jpg,48 deg 56' 25.80\" N,8 deg 24' 28.08\" E\n")
    assert "latitude '48 deg 56' 25.80\" N' is not a number of degrees" in str(raised.value)
