"""Imported poses meet photographs by name, and are refused where they cannot be right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.errors import GeoreferenceError, InputDataError
from facadelake.core.pose_table import read_posed_cameras
from facadelake.georeferencing.gcp.control_points import ImageMark, SurveyedPoint, SurveyedPoints
from facadelake.georeferencing.imported.placement import SIGMA_POSITION_M, ImportedPlacement, place_imported_poses
from facadelake.georeferencing.imported.pose_files import read_poses
from tests.unit.georeferencing.imported_wall import (
    CENTRES,
    NAMES,
    ORIGIN,
    PLACE,
    build_photos,
    build_wall,
    format_geo,
    write,
    write_geo_csv,
)


def place(path: Path, of: pa.Table | None = None, limit_m: float = 0.5) -> ImportedPlacement:
    return place_imported_poses(
        read_poses(path), of or build_photos(), site_frame=PLACE, surface=build_wall(), placement_sigma_max_m=limit_m
    )


def test_every_photograph_has_its_pose(tmp_path: Path) -> None:
    found = place(write_geo_csv(tmp_path))
    cameras = read_posed_cameras(found.poses)
    assert sorted(cameras) == NAMES and found.localised == 4
    for name, centre in zip(NAMES, CENTRES, strict=True):
        np.testing.assert_allclose(cameras[name].centre_site_m, centre, rtol=0, atol=1e-4)  # m
        # The wall's foot straight ahead: 14 to 15.5 m away, below the principal point, by hand.
        x, y = cameras[name].project_site(np.array([[centre[0], 0.0, 0.0]]))[0]
        expected = (2010.5, 1490.5 + 2810 * centre[2] / -centre[1])
        assert (x, y) == pytest.approx(expected, rel=0, abs=0.05)  # px: 1e-4 m at 15 m
    row = found.georeference.to_pylist()[0]
    assert (row["control"], row["points_used"], row["residual_mean_m"]) == ("imported", 4, None)
    assert row["sigma_east_m"] == SIGMA_POSITION_M and "4 of 4 poses state no sigma" in row["remarks"]
    assert len(found.georeference_points) == 0


def test_names_that_fail(tmp_path: Path) -> None:
    """One photograph without a line, one with two, one with a bad line, one line of no photograph: the rest goes on."""
    path = write_geo_csv(tmp_path)
    lines = path.read_text().splitlines()
    lines[3] = lines[3].replace(",0,0,", ",0,9,")  # the second camera's quaternion
    lines[4] = lines[4].replace("IMG_2", "IMG_9")
    path.write_text("\n".join([*lines, lines[2]]))
    found = place(path)
    rows = {row["photo_id"]: row for row in found.poses.to_pylist()}
    assert [rows[name]["pose_source"] for name in NAMES] == ["unlocalised"] * 3 + ["imported"]
    assert "2 poses for it" in rows[NAMES[0]]["reason"]
    assert "quaternion" in rows[NAMES[1]]["reason"]
    assert "has no pose for it" in rows[NAMES[2]]["reason"]
    remarks = found.georeference.to_pylist()[0]["remarks"]
    assert "1 poses belong to no photograph of this campaign" in remarks and "IMG_9" in remarks


def test_one_pose_off_the_globe_is_its_own_reason(tmp_path: Path) -> None:
    path = write_geo_csv(tmp_path)
    lines = path.read_text().splitlines()
    name, lon, _, *rest = lines[3].split(",")
    path.write_text("\n".join([*lines[:3], ",".join([name, lon, "1e9", *rest]), *lines[4:]]))
    found = place(path)
    rows = {row["photo_id"]: row for row in found.poses.to_pylist()}
    assert found.localised == 3 and rows[NAMES[1]]["pose_source"] == "unlocalised"
    assert "outside the domain" in rows[NAMES[1]]["reason"]


def test_poses_that_are_all_off_the_globe_are_refused(tmp_path: Path) -> None:
    path = write_geo_csv(tmp_path)
    head, *lines = path.read_text().splitlines()[1:]
    off = [",".join([name, lon, "1e9", *rest]) for name, lon, _, *rest in (line.split(",") for line in lines)]
    path.write_text("\n".join([head, *off]))
    with pytest.raises(GeoreferenceError, match="outside the domain"):
        place(path)


def test_poses_of_another_campaign_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"none of the 4 poses of poses\.csv .*not among"):
        place(write_geo_csv(tmp_path), build_photos(["other/a.jpg"]))


def test_swapped_coordinates_are_told(tmp_path: Path) -> None:
    path = write_geo_csv(tmp_path)
    path.write_text(path.read_text().replace("lon_deg,lat_deg", "lat_deg,lon_deg"))
    with pytest.raises(GeoreferenceError, match=r"km from the building model.*swapped"):
        place(path)


@pytest.mark.parametrize(
    ("head", "turn", "remedy"),
    [
        # The same numbers, read the other way: the cameras look south, away from the wall, or to the sky.
        ("# camera_axes: right_up_backward\n", None, "or the other value of camera_axes .*, 4 would"),
        ("# rotation: cam_from_world\n", "0.5,-0.5,0.5,-0.5", "none of 4 photographs shows"),
    ],
)
def test_a_convention_by_which_nothing_is_seen(tmp_path: Path, head: str, turn: str | None, remedy: str) -> None:
    with pytest.raises(GeoreferenceError, match=remedy):
        place(write_geo_csv(tmp_path, head=head, turn=turn))


def test_rotations_that_contradict_the_metadata_are_refused(tmp_path: Path) -> None:
    """A gimbal that looks north 6 degrees beside the poses is taken; one that is on its side against them is not."""
    priors = {
        "prior_source": "xmp",
        "prior_pitch_deg": 0.0,
        "prior_yaw_deg": 6.0,
        "prior_lon_deg": 8.4,
        "prior_lat_deg": 48.9,
    }
    assert place(write_geo_csv(tmp_path), build_photos(**priors, prior_roll_deg=0.0)).localised == 4
    with pytest.raises(GeoreferenceError, match=r"rotated by 90 deg \(median, limit 45 deg\)"):
        place(write_geo_csv(tmp_path), build_photos(**priors, prior_roll_deg=90.0))
    upside_down = write_geo_csv(tmp_path, head="# rotation: cam_from_world\n")
    with pytest.raises(GeoreferenceError, match=r"with the other value of rotation .*4 would"):
        place(upside_down, build_photos(**priors, prior_roll_deg=0.0))


def mark_points(points_m: dict[str, np.ndarray]) -> SurveyedPoints:
    """Points of the wall in EPSG:25832, marked where a pinhole of the wall's lens sees them from the true cameras."""
    surveyed = []
    for name, (x, y, z) in points_m.items():
        east, north, height = ORIGIN.map_from_site(np.array([[x, y, z]]), "EPSG:25832")[0]
        marks = tuple(
            ImageMark(
                photo_name=photo, x_px=2010.5 + 2800 * (x - cx) / (y - cy), y_px=1490.5 - 2810 * (z - cz) / (y - cy)
            )
            for photo, (cx, cy, cz) in zip(NAMES, CENTRES, strict=True)
        )
        surveyed.append(SurveyedPoint(name=name, x=east, y=north, z=height, marks=marks))
    return SurveyedPoints(source="gcp_list.txt", crs="EPSG:25832", points=tuple(surveyed))


def test_sigmas_contain_what_surveyed_points_contradict(tmp_path: Path) -> None:
    """Poses 40 cm too high at a stated 1 cm, within the accuracy that a campaign must have: once committed at 1 cm."""
    points = {"P1": np.array([-4.0, 0.0, 1.0]), "P2": np.array([4.0, 0.0, 6.0]), "P3": np.array([0.0, 0.0, 3.0])}
    path = write_geo_csv(tmp_path, head="# sigma_position_m: 0.01\n# sigma_attitude_deg: 0.02\n")
    high = path.read_text()
    for xyz in CENTRES:
        high = high.replace(format_geo(xyz), format_geo(xyz + np.array([0, 0, 0.4])))
    path.write_text(high)
    found = place_imported_poses(
        read_poses(path), build_photos(), site_frame=PLACE, surface=build_wall(), placement_sigma_max_m=0.5,
        surveyed=[mark_points(points)],
    )  # fmt: skip
    (row,) = found.georeference.to_pylist()
    assert row["sigma_up_m"] == pytest.approx(np.hypot(0.01, 0.4), rel=0, abs=1e-3)  # m
    assert row["sigma_east_m"] == pytest.approx(0.01, rel=0, abs=1e-3)  # m
    assert "; the sigmas contain the mean deviation of the check points" in row["remarks"]
    for pose in found.poses.to_pylist():
        assert pose["sigma_up_m"] == pytest.approx(np.hypot(0.01, 0.4), rel=0, abs=1e-3)  # m
        assert pose["covariance"][14] == pytest.approx(pose["sigma_up_m"] ** 2, rel=1e-9)


def test_surveyed_points_and_gps_judge_the_poses(tmp_path: Path) -> None:
    """Poses 5 cm too high see every point 5 cm too high; GPS 30 m above them is outvoted by the surveyed points."""
    points = {"P1": np.array([-4.0, 0.0, 1.0]), "P2": np.array([4.0, 0.0, 6.0]), "P3": np.array([0.0, 0.0, 3.0])}
    path = write_geo_csv(tmp_path)
    high = path.read_text()
    for xyz in CENTRES:
        high = high.replace(format_geo(xyz), format_geo(xyz + np.array([0, 0, 0.05])))
    path.write_text(high)
    lon, lat, height = ORIGIN.geo_from_site(CENTRES[1][None])[0]
    said = {
        "prior_source": "exif", "prior_lon_deg": lon, "prior_lat_deg": lat, "prior_height_m": height + 30.0,
        "prior_sigma_horizontal_m": 3.0, "prior_sigma_vertical_m": 5.0, "prior_height_datum": "ellipsoidal",
    }  # fmt: skip
    found = place_imported_poses(
        read_poses(path), build_photos(**said), site_frame=PLACE, surface=build_wall(), placement_sigma_max_m=0.5,
        surveyed=[mark_points(points)],
    )  # fmt: skip
    row = found.georeference.to_pylist()[0]
    assert (row["check_points"], row["control"]) == (3, "imported")
    assert row["check_residual_mean_m"] == pytest.approx(0.05, rel=0, abs=5e-4)  # m
    checks = [point for point in found.georeference_points.to_pylist() if point["point_kind"] == "check"]
    assert [point["residual_up_m"] for point in checks] == pytest.approx([-0.05] * 3, rel=0, abs=5e-4)  # given - found
    assert not any(point["point_used"] for point in found.georeference_points.to_pylist())
    # The cameras stand 3, 4, 3.5 and 5 m high and one GPS place is given for all: the median is 0.25 m beside it.
    assert row["gps_offset_up_m"] == pytest.approx(30.0 + 4.0 - 3.75 - 0.05, rel=0, abs=5e-4)
    assert (
        "disagreement: GPS of 4 photographs (flight 1) deviates from the placed cameras by +30.20 m" in row["remarks"]
    )
    outcomes = {check["statement"]: check["placement_check_outcome"] for check in found.placement_checks.to_pylist()}
    assert outcomes["gps_height"] == "disagrees"
    assert outcomes["surveyed_points"] == "agrees"
    off = {name: point + np.array([0.0, 0.0, 2.0]) for name, point in points.items()}
    shifted = mark_points(points)
    wrong = SurveyedPoints(source="g", crs=shifted.crs, points=tuple(
        SurveyedPoint(name=p.name, x=q.x, y=q.y, z=q.z, marks=p.marks)
        for p, q in zip(shifted.points, mark_points(off).points, strict=True)
    ))  # fmt: skip
    with pytest.raises(GeoreferenceError, match=r"held-out points lie 1\.95 m"):
        place_imported_poses(
            read_poses(path),
            build_photos(),
            site_frame=PLACE,
            surface=build_wall(),
            placement_sigma_max_m=0.5,
            surveyed=[wrong],
        )


def test_metres_are_not_good_enough(tmp_path: Path) -> None:
    head = "# sigma_position_m: 2\n# sigma_attitude_deg: 1\n"
    with pytest.raises(GeoreferenceError, match=r"known to 2\.00 m east"):
        place(write_geo_csv(tmp_path, head=head))
    assert place(write_geo_csv(tmp_path, head=head), limit_m=3.0).localised == 4


def test_a_lens_of_another_shape_costs_its_photograph(tmp_path: Path) -> None:
    folder = tmp_path / "colmap"
    write(folder / "cameras.txt", "1 PINHOLE 3000 4000 2800 2810 1500 2000\n2 PINHOLE 2000 1500 1400 1405 1000 750\n")
    turn = f"{np.sqrt(0.5)} {np.sqrt(0.5)} 0 0"
    lines = [
        f"{i} {turn} {-x} {z} {-y} {min(i, 2)} {name}\n"
        for i, (name, (x, y, z)) in enumerate(zip(NAMES, CENTRES, strict=True), start=1)
    ]
    write(folder / "images.txt", "\n".join(lines))
    write(folder / "georeference.txt", "crs: site\n")
    found = place(folder)
    rows = {row["photo_id"]: row for row in found.poses.to_pylist()}
    assert "aspect ratios differ" in rows[NAMES[0]]["reason"] and found.localised == 3
    centre = [rows[NAMES[1]][f"{axis}_site_m"] for axis in "xyz"]
    np.testing.assert_allclose(centre, CENTRES[1], rtol=0, atol=1e-9)
    assert rows[NAMES[1]]["fx_px"] == 2800.0  # of the photograph twice as wide
