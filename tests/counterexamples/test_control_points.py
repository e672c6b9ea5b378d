"""Control points with typos, and control that puts the photographs far from the building: each with its words."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.georeferencing.available_control import Control
from facadelake.georeferencing.gcp.control_points import SurveyedPoint, SurveyedPoints, read_surveyed_points
from facadelake.georeferencing.georeference import georeference_reconstruction
from facadelake.georeferencing.georeferenced_campaign import GeoreferencedCampaign
from facadelake.georeferencing.site_frame import SiteFrame
from schemas.vocabulary import ControlKind, PositionSource
from tests.synthetic.test_georeference import ORIGIN, Scene, build_ring

ROW = "456630.3296 5421032.8544 182.1937 662.29 1415.99 multiview/IMG_0005.JPG"
WANTED = "expected x y z pixel_x pixel_y photograph [name]"
HEADER = (
    "write an EPSG code (EPSG:25832), a PROJ string (+proj=utm ...) or 'WGS84 UTM 32N' in the first line"
)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "control points {path}: the file is empty; its first line must be a CRS (EPSG:25832)"),
        (ROW, "{path}, line 1: '" + ROW + "' is not a CRS; " + HEADER),
        ("EPSG:999999\n" + ROW, "{path}, line 1: 'EPSG:999999' is not a CRS; " + HEADER),
        ("EPSG:25832\n1 2 3 4 a.jpg\n", "{path}, line 2: 5 columns in '1 2 3 4 a.jpg'; " + WANTED),
        ("EPSG:25832\n\n1 2,5 3 4 5 a.jpg\n", "{path}, line 3: y is '2,5'; expected a finite number"),
        ("EPSG:25832\n1 2 NaN 4 5 a.jpg\n", "{path}, line 2: z is 'NaN'; expected a finite number"),
        (
            "EPSG:25832\n1 2 3 4 5 a b GCP 1\n",
            "{path}, line 2: 'a b GCP 1' may be split into a photograph and a point in more than one way; "
            "quote names with blanks, or separate the columns by tabs",
        ),
        (
            "EPSG:25832\n1 2 3 4 5 a.jpg G1\n1 2 9 4 5 b.jpg G1\n",
            "{path}, line 3: G1 is at (1.0, 2.0, 9.0), but in line 2 at (1.0, 2.0, 3.0); use one name for one point",
        ),
    ],
    ids=[
        "empty",
        "no header",
        "unknown CRS",
        "a column missing",
        "decimal comma",
        "NaN",
        "blanks",
        "one name, two places",
    ],
)
def test_a_typo_is_named_with_file_line_and_value(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(text)
    with pytest.raises(InputDataError) as raised:
        read_surveyed_points(path)
    assert str(raised.value) == message.replace("{path}", str(path))


def test_a_missing_file(tmp_path: Path) -> None:
    path = tmp_path / "nowhere.txt"
    with pytest.raises(InputDataError) as raised:
        read_surveyed_points(path)
    assert str(raised.value) == (f"control points {path} cannot be read: [Errno 2] No such file or directory: '{path}'")


SCENE = Scene(poses=build_ring())
CONTROL = SCENE.build_control()


def misname_photographs(point: SurveyedPoint) -> SurveyedPoint:
    """The point marked in photographs that the campaign does not have."""
    return replace(point, marks=tuple(replace(s, photo_name=f"DJI_{s.photo_name}") for s in point.marks))


def georeference(
    control: ControlKind | None,
    points: SurveyedPoints | None,
    photos: pa.Table | None = None,
    *,
    limit_m: float = 60.0,  # GPS heights of an unknown datum are known to 50 m
) -> GeoreferencedCampaign:
    return georeference_reconstruction(
        SCENE.build_reconstruction(),
        SCENE.build_photos() if photos is None else photos,
        site_frame=SiteFrame(
            origin=ORIGIN, map_crs="EPSG:25832", vertical_datum="ellipsoidal", georeference_level="50"
        ),
        control=Control(kind=control, points=points, placement_sigma_max_m=limit_m),
    )


def compute_camera_errors_m(found: GeoreferencedCampaign) -> np.ndarray:
    truth = {name: centre for name, (centre, _) in zip(SCENE.list_ids(), SCENE.poses, strict=True)}
    return np.array([np.linalg.norm(posed.centre_site_m - truth[name]) for name, posed in found.cameras.items()])


@pytest.mark.parametrize(
    ("first", "remark"),
    [
        (replace(CONTROL.points[0], x=CONTROL.points[0].x + 100), "control points left out as gross errors: G1"),
        (
            misname_photographs(replace(CONTROL.points[0], marks=CONTROL.points[0].marks[:2])),
            "2 marks of gcp_list.txt are not used: 'DJI_p02.jpg' is not among the campaign's photographs; "
            "'DJI_p03.jpg' is not among the campaign's photographs; "
            "control points not usable (fewer than 2 agreeing marks): G1",
        ),
    ],
    ids=["easting mistyped by 100 m", "photographs' names mistyped"],
)
def test_one_bad_control_point_is_named_and_the_others_carry_the_block(first: SurveyedPoint, remark: str) -> None:
    found = georeference(None, replace(CONTROL, points=(first, *CONTROL.points[1:])))
    assert (found.control, found.row["points_used"], found.row["points_total"]) == ("gcp", 5, 6)
    assert remark in found.row["remarks"]
    assert 0.001 < compute_camera_errors_m(found).max() < 0.1  # m: survey and marks have errors of centimetres


def test_control_points_of_other_photographs(tmp_path: Path) -> None:
    points = replace(CONTROL, points=tuple(misname_photographs(point) for point in CONTROL.points))
    with pytest.raises(GeoreferenceError) as raised:
        georeference(ControlKind.GCP, points)
    assert str(raised.value) == (
        "0 of 6 control points of gcp_list.txt can be used, 3 are needed; each must be marked in 2 or more localised "
        "photographs whose names match the files (not usable: G1, G2, G3, G4, G5, G6); "
        "30 marks of gcp_list.txt are not used: 'DJI_p02.jpg' is not among the campaign's photographs; "
        "'DJI_p03.jpg' is not among the campaign's photographs; 'DJI_p04.jpg' is not among the campaign's photographs; "
        "and 17 more names"
    )
    automatic = georeference(None, points)  # without a request for control points, GPS is the control, with a remark
    assert automatic.control == "gps"
    assert automatic.row["remarks"].startswith(
        "chosen automatically: gps; 0 of 6 control points of gcp_list.txt can be used (3 are needed); "
    )


def test_neither_control_points_nor_gps() -> None:
    rows = [row | {"prior_source": PositionSource.NONE} for row in SCENE.build_photos().to_pylist()]
    photos = pa.Table.from_pylist(rows, schema=SCENE.build_photos().schema)
    with pytest.raises(GeoreferenceError) as raised:
        georeference(None, None, photos)
    assert str(raised.value) == (
        "0 localised photographs have a GPS position with height; 3 or more are needed: "
        "give control points (gcp_list.txt), or photographs with GPS"
    )
    with pytest.raises(GeoreferenceError) as raised:
        georeference(ControlKind.GCP, None, photos)
    assert str(raised.value) == (
        "georeferencing by control points was requested, but none are given; add a gcp_list.txt"
    )


def swap_gps() -> pa.Table:
    """Table `photos` with latitude and longitude exchanged."""
    rows = SCENE.build_photos().to_pylist()
    for row in rows:
        row["prior_lon_deg"], row["prior_lat_deg"] = row["prior_lat_deg"], row["prior_lon_deg"]
    return pa.Table.from_pylist(rows, schema=SCENE.build_photos().schema)


@pytest.mark.parametrize(
    ("points", "photos", "message"),
    [
        (
            CONTROL,
            swap_gps(),
            "placed by control points, the block is rotated or scaled against its GPS positions: the median "
            "photograph is … sigmas off (limit 1); check the control points or the model, "
            "or the photographs' GPS (latitude and longitude swapped?)",
        ),
        (
            replace(CONTROL, points=tuple(replace(p, x=p.y, y=p.x) for p in CONTROL.points)),
            SCENE.build_photos(),
            "control points gcp_list.txt: the point 5416518.845, 456027.0838 of ETRS89 / UTM zone 32N (east, north) "
            "lies outside the area of use of that CRS (Europe between 6°E and 12°E: longitude 6 to 12.01, latitude "
            "36.53 to 84.01); exchanged (456027.0838, 5416518.845) it would lie in it; check the axis order, the unit "
            "and the CRS",
        ),
    ],
    ids=["GPS has latitude and longitude swapped", "control points have east and north swapped"],
)
def test_control_that_contradicts_itself(points: SurveyedPoints, photos: pa.Table, message: str) -> None:
    with pytest.raises(GeoreferenceError) as raised:
        georeference(None, points, photos)
    assert re.sub(r"\d+\.\d(?= sigmas)", "…", str(raised.value)) == message


FAR = (
    "placed by {control}, the photographs lie {km} km from the building model (limit 10 km), "
    "near lon {lon}, lat {lat}; are latitude and longitude (or east and north) swapped, is a CRS or UTM zone wrong, "
    "or do photographs and model belong to different buildings?"
)


@pytest.mark.parametrize(
    ("points", "photos", "message"),
    [
        (None, swap_gps(), FAR.format(km="5660", control="gps", lon="48.900", lat="8.400")),
        (
            replace(CONTROL, crs="EPSG:25833"),
            SCENE.build_photos(),
            FAR.format(km="440", control="gcp", lon="14.400", lat="48.900"),
        ),
    ],
    ids=["latitude and longitude swapped", "control points of the wrong UTM zone"],
)
def test_control_that_puts_the_photographs_far_from_the_building(
    points: SurveyedPoints | None, photos: pa.Table, message: str
) -> None:
    with pytest.raises(GeoreferenceError) as raised:
        georeference(None, points, photos)
    assert str(raised.value) == message
