"""gcp_list.txt: what is read, and which photograph a name means; bad files are in tests/counterexamples."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.georeferencing import SiteFrame
from facadelake.georeferencing.gcp.control_points import (
    SurveyedPoints,
    add_vertical_datum,
    describe_doubtful_marks,
    match_marks,
    read_surveyed_points,
    transform_to_site,
)

ROW = "456630.3296 5421032.8544 182.1937 662.29 1415.99 multiview/IMG_0005.JPG"


def read(tmp_path: Path, text: str) -> SurveyedPoints:
    """The points of a file with this text."""
    path = tmp_path / "gcp_list.txt"
    path.write_text(text, encoding="utf-8")
    return read_surveyed_points(path)


@pytest.mark.parametrize(
    ("header", "crs"),
    [
        ("EPSG:25832", "EPSG:25832"),
        ("WGS84 UTM 32N", "EPSG:32632"),
        ("WGS84 UTM 7S", "EPSG:32707"),
        ("+proj=utm +zone=11 +ellps=WGS84 +datum=WGS84 +units=m +no_defs", None),
    ],
)
def test_headers(tmp_path: Path, header: str, crs: str | None) -> None:
    assert read(tmp_path, f"{header}\n{ROW} G1\n").crs == (crs or header)


def test_blanks_tabs_comments_and_names(tmp_path: Path) -> None:
    text = (
        f"\ufeff# a comment\nEPSG:25832\n\n{ROW} G1\n"
        "456630.3296\t5421032.8544\t182.1937\t616.35\t1375.87\tIMG 6.JPG\tG1\textra\n"
        "1 2 3 4 5 a.jpg\n1 2 3 6 7 b.jpg\n1 2 4 6 7 b.jpg\n"
    )
    points = read(tmp_path, text).points
    assert [(point.name, len(point.marks)) for point in points] == [("G1", 2), ("point 1", 2), ("point 2", 1)]
    first = points[0]
    assert (first.x, first.y, first.z) == (456630.3296, 5421032.8544, 182.1937)
    assert [(s.photo_name, s.x_px, s.y_px) for s in first.marks] == [
        ("multiview/IMG_0005.JPG", 662.29, 1415.99),
        ("IMG 6.JPG", 616.35, 1375.87),
    ]


CASES = Path("../shared/data/cases/gcp")
HEAD = "EPSG:25832\n"


@pytest.mark.parametrize(
    ("text", "points"),
    [
        (  # cases/gcp/spaces_in_filename.txt
            "456613.2 5421051.8 180.0 10 20 DJI 0001.JPG\n456613.2 5421051.8 180.0 11 21 DJI 0002.JPG\n"
            "456618.2 5421051.8 181.0 11 21 DJI 0001.JPG\n",
            {"point 1": ["DJI 0001.JPG", "DJI 0002.JPG"], "point 2": ["DJI 0001.JPG"]},
        ),
        (  # cases/gcp/name_with_space.txt
            "456613.2 5421051.8 180.0 10 20 a.JPG GCP 1\n456613.2 5421051.8 180.0 11 21 b.JPG GCP 1\n"
            "456618.2 5421051.8 181.0 11 21 a.JPG GCP 2\n",
            {"GCP 1": ["a.JPG", "b.JPG"], "GCP 2": ["a.JPG"]},
        ),
        ('1 2 3 10 20 "a b.JPG" "G 1"\n1 2 3 10 20 \'c\' G 1\n', {"G 1": ["a b.JPG", "c"]}),
        ("1 2 3 10 20 a G1\n1 2 3 10 20 B.jpg G1\n", {"G1": ["a", "B.jpg"]}),
        ("1 2 3 10 20 D:\\Flug 7\\a.JPG G1\n", {"G1": [r"D:\Flug 7\a.JPG"]}),
        ("1 2 3 1 2 a.JPG G1 one\n1 2 3 1 2 b.JPG G1 two\n", {"G1": ["a.JPG", "b.JPG"]}),
        ("1 2 3 1 2 a.JPG G 1\n1 2 3 1 2 b.JPG G 1\n", {"G 1": ["a.JPG", "b.JPG"]}),
    ],
    ids=["blanks", "blank in a point's name", "quotes", "no suffix", "Windows", "more columns", "one point, blank"],
)  # fmt: skip
def test_names_of_photographs_and_points(tmp_path: Path, text: str, points: dict[str, list[str]]) -> None:
    found = read(tmp_path, HEAD + text)
    assert {point.name: [mark.photo_name for mark in point.marks] for point in found.points} == points
    assert found.remarks == ()


def test_blanks_that_may_be_split_in_two_ways(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"line 2: 'a b GCP 1' may be split .* quote names with blanks"):
        read(tmp_path, HEAD + "1 2 3 4 5 a b GCP 1\n")


def test_coordinates_rounded_differently_are_one_point_by_the_most_digits(tmp_path: Path) -> None:
    text = HEAD + "456613.25 5421051.8 180 1 2 a.JPG G1\n456613.2487 5421051.7913 180.0 3 4 b.JPG G1\n"
    found = read(tmp_path, text)
    assert [(p.name, p.x, p.y, p.z) for p in found.points] == [("G1", 456613.2487, 5421051.7913, 180.0)]
    assert found.remarks == ("coordinates are rounded differently in the lines of G1; those with most digits count",)
    unnamed = read(tmp_path, text.replace(" G1", ""))
    assert [(p.name, p.x, len(p.marks)) for p in unnamed.points] == [("point 1", 456613.2487, 2)]
    for typo in ("456613.26", "456613.3", "456614"):  # 1 cm, 5 cm and 0.75 m: no rounding of 456613.2487
        with pytest.raises(InputDataError, match="use one name for one point"):
            read(tmp_path, f"{HEAD}456613.2487 2 3 1 2 a.JPG G1\n{typo} 2 3 3 4 b.JPG G1\n")
    geographic = "EPSG:4979\n8.4078123 48.9405 180 1 2 a.JPG G1\n8.40781234 48.9405 180 1 2 b.JPG G1\n"
    assert read(tmp_path, geographic).points[0].x == 8.40781234
    with pytest.raises(InputDataError, match="use one name for one point"):  # 3 m on the ground
        read(tmp_path, geographic.replace("8.4078123 ", "8.4078 "))


def test_marks_name_photographs(tmp_path: Path) -> None:
    """All photographs of the campaign count, and what is not used is told with both candidates."""
    text = HEAD + (
        "1 2 3 10 20 a.JPG G1\n1 2 3 11 21 D:\\x\\multiview\\b.jpg G1\n1 2 3 12 22 multiview/B.JPG G1\n"
        "1 2 3 1 2 c.JPG G1\n"
        "4 5 6 100 200 closerange/d.JPG G2\n4 5 6 300 200 closerange/d.JPG G2\n4 5 6 7 8 closerange/a G2\n"
    )
    ids = ["multiview/a.JPG", "closerange/a.JPG", "multiview/b.JPG", "closerange/d.JPG"]
    found = match_marks(read(tmp_path, text), ids)
    assert {p.name: [m.photo_name for m in p.marks] for p in found.points} == {"G1": [], "G2": ["closerange/a.JPG"]}
    assert found.remarks == (
        "4 marks of gcp_list.txt are not used: 'a.JPG' matches closerange/a.JPG, multiview/a.JPG; give its folder, "
        "too; 'D:\\x\\multiview\\b.jpg', 'multiview/B.JPG' match the same photograph multiview/b.JPG; write its path "
        "in one way, as the campaign has it; 'c.JPG' is not among the campaign's photographs",
        "G2 is marked in closerange/d.JPG at 100, 200 and at 300, 200 px (limit 3 px apart): none of these marks is "
        "used",
    )


def test_marks_outside_and_in_photographs_that_exif_turns_are_told(tmp_path: Path) -> None:
    text = HEAD + "1 2 3 10 20 a.JPG G1\n1 2 3 3500 3900 b.JPG G1\n1 2 3 11 21 c.JPG G1\n"
    common = {"sha256": "0", "bytes": 1, "photo_outcome": "accepted", "image_width_px": 4000, "image_height_px": 3000}
    common |= {"prior_source": "none", "prior_height_datum": "unknown"}
    rows = [
        common | {"photo_id": f"{name}.JPG", "exif_orientation": k} for name, k in (("a", 1), ("b", None), ("c", 6))
    ]
    photos = table_from_rows("photos", rows)
    found = match_marks(read(tmp_path, text), photos["photo_id"].to_pylist())
    assert describe_doubtful_marks(found, photos) == (
        "marks outside their photographs: G1 in b.JPG at 3500, 3900 px; check x and y, and for which size",
        "EXIF turns c.JPG: marks there are taken in the pixels as stored; store photographs upright",
    )


@pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not on this machine")
@pytest.mark.parametrize("case", ["windows_full_path", "images_prefix"])
def test_cases_with_paths_of_other_programs(case: str) -> None:
    surveyed = read_surveyed_points(CASES / f"{case}.txt")
    names = {mark.photo_name for point in surveyed.points for mark in point.marks}
    ids = {"/".join(name.replace("\\", "/").split("/")[-2:]) for name in names}
    found = match_marks(surveyed, [*ids, "other/DJI_0001.JPG"])
    assert found.remarks == ()
    assert {mark.photo_name for point in found.points for mark in point.marks} == ids


def test_coordinates_reach_the_site(tmp_path: Path) -> None:
    """A point 10 m east, 20 m north, 3 m up, in the map's CRS; and heights of a datum whose grid is missing."""
    origin = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)
    east, north, height = origin.map_from_site(np.array([[10.0, 20.0, 3.0]]), "EPSG:25832")[0]
    points = read(tmp_path, f"EPSG:25832\n{east:.6f} {north:.6f} {height:.6f} 1 2 a.jpg\n")
    frame = SiteFrame(origin=origin, map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50")
    site = transform_to_site(points, frame)
    np.testing.assert_allclose(site, [[10, 20, 3]], rtol=0, atol=1e-4)  # m
    with pytest.raises(GeoreferenceError, match="grid"):
        transform_to_site(points, replace(frame, vertical_datum="EPSG:7837"))
    assert add_vertical_datum("EPSG:25832", "EPSG:7837") == "EPSG:25832+7837"
    assert add_vertical_datum("EPSG:4979", "EPSG:7837") == "EPSG:4979"
