"""gcp_list.txt: what is read, and which photograph a name means; bad files are in tests/counterexamples."""

from pathlib import Path

import numpy as np
import pytest

from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.gcp.control_points import (
    SurveyedPoints,
    add_vertical_datum,
    match_photo_names,
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


def test_a_name_means_its_path_or_the_only_file_of_that_end() -> None:
    ids = ["multiview/a.JPG", "closerange/a.JPG", "closerange/b.jpg"]
    found = match_photo_names(["a.JPG", "closerange/a.jpg", "B.JPG", "multiview/a.JPG", "c.jpg"], ids)
    assert found == {
        "closerange/a.jpg": "closerange/a.JPG",
        "B.JPG": "closerange/b.jpg",
        "multiview/a.JPG": "multiview/a.JPG",
    }


def test_coordinates_reach_the_site(tmp_path: Path) -> None:
    """A point 10 m east, 20 m north, 3 m up, in the map's CRS; and heights of a datum whose grid is missing."""
    origin = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)
    east, north, height = origin.map_from_site(np.array([[10.0, 20.0, 3.0]]), "EPSG:25832")[0]
    points = read(tmp_path, f"EPSG:25832\n{east:.6f} {north:.6f} {height:.6f} 1 2 a.jpg\n")
    site = transform_to_site(points, origin=origin, vertical_datum="ellipsoidal")
    np.testing.assert_allclose(site, [[10, 20, 3]], rtol=0, atol=1e-4)  # m
    with pytest.raises(GeoreferenceError, match="grid"):
        transform_to_site(points, origin=origin, vertical_datum="EPSG:7837")
    assert "DHHN2016" in add_vertical_datum("EPSG:25832", "EPSG:7837")
    assert add_vertical_datum("EPSG:4979", "EPSG:7837") == "EPSG:4979"
