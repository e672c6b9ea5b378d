"""poses.csv: one camera written in every way it may be written comes to stand at one place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest

from facadelake.core.errors import InputDataError
from facadelake.georeferencing.imported.pose_files import read_poses
from facadelake.georeferencing.imported.poses_csv import read_poses_csv
from tests.unit.georeferencing.imported_wall import (
    CENTRES,
    LENS,
    LOOKS_NORTH,
    ORIGIN,
    PLACE,
    format_geo,
    format_quaternion,
    write,
    write_geo_csv,
)

LENS_COLUMNS = "fx_px,fy_px,cx_px,cy_px"
MATRIX = ",".join(f"r{i}{j}" for i in range(3) for j in range(3))


def read_one_pose(tmp_path: Path, head: str, columns: str, values: str) -> tuple[np.ndarray, np.ndarray]:
    """Centre and rotation in site of the only pose of a file."""
    path = write(tmp_path / "poses.csv", f"{head}image,{columns},{LENS_COLUMNS}\na.jpg,{values},{LENS}\n")
    found = read_poses_csv(path)
    assert not found.unusable
    pose = found.poses[0]
    centres, rotations = found.world.transform_to_site(pose.xyz_world[None], pose.world_from_cam[None], PLACE)
    return centres[0], rotations[0]


def transform_to_map(xyz_site_m: np.ndarray) -> tuple[float, float, float]:
    """By pyproj alone: lon and lat in zone 32."""
    lon, lat, height = ORIGIN.geo_from_site(xyz_site_m[None])[0]
    east, north = pyproj.Proj("EPSG:25832")(lon, lat)
    return east, north, height


def compute_convergence_deg() -> float:
    """Angle from true north to grid north, clockwise, at the building."""
    factors = pyproj.Proj("EPSG:25832").get_factors(ORIGIN.lon_deg, ORIGIN.lat_deg)
    return float(factors.meridian_convergence)


def test_positions_in_every_frame(tmp_path: Path) -> None:
    xyz = CENTRES[0]
    east, north, height = transform_to_map(xyz)
    turn = format_quaternion()
    site = ",".join(str(value) for value in xyz)
    q = "qw,qx,qy,qz"
    for head, columns, values in (
        ("", f"lon_deg,lat_deg,height_ellipsoidal_m,{q}", f"{format_geo(xyz)},{turn}"),
        ("", f"x_site_m,y_site_m,z_site_m,{q}", f"{site},{turn}"),
        ("# north: true\n", f"x,y,z,{q}", f"{east},{north},{height},{turn}"),
        ("# crs: EPSG:25832\n# north: true\n", f"x,y,z,{q}", f"{east},{north},{height},{turn}"),
        ("# crs: site\n", f"x,y,z,{q}", f"{site},{turn}"),
    ):
        centre, rotation = read_one_pose(tmp_path, head, columns, values)
        np.testing.assert_allclose(centre, xyz, rtol=0, atol=1e-4)  # m
        np.testing.assert_allclose(rotation, LOOKS_NORTH, rtol=0, atol=1e-9)


def test_a_site_of_another_origin(tmp_path: Path) -> None:
    """100 m east and 50 m north of ours: positions move, directions turn by the seconds of arc between the two."""
    lon, lat, height = ORIGIN.geo_from_site(np.array([[100.0, 50.0, 2.0]]))[0]
    head = f"# site_origin: {lon:.10f} {lat:.10f} {height:.4f}\n"
    centre, rotation = read_one_pose(
        tmp_path, head, "x_site_m,y_site_m,z_site_m,qw,qx,qy,qz", f"-100,-65,1,{format_quaternion()}"
    )
    np.testing.assert_allclose(centre, [0.0, -15.0, 3.0], rtol=0, atol=0.005)  # m
    assert 0 < np.abs(rotation - LOOKS_NORTH).max() < 5e-5  # 100 m of an earth of 6371 km, times tan(lat)


def test_grid_north_is_turned_by_the_convergence(tmp_path: Path) -> None:
    """A camera that looks to grid north looks the meridian convergence beside true north (PROJ's own factor)."""
    east, north, height = transform_to_map(CENTRES[0])
    _, rotation = read_one_pose(
        tmp_path, "# crs: EPSG:25832\n", "x,y,z,qw,qx,qy,qz", f"{east},{north},{height},{format_quaternion()}"
    )
    looks = rotation[:, 2]
    azimuth_deg = np.degrees(np.arctan2(looks[0], looks[1]))
    assert abs(compute_convergence_deg()) > 0.3  # 0.6 deg west of the zone's meridian: the test can tell
    assert azimuth_deg == pytest.approx(compute_convergence_deg(), rel=0, abs=1e-4)  # deg


def test_attitudes_in_every_way(tmp_path: Path) -> None:
    where = f"{format_geo(CENTRES[0])}"
    columns = "lon_deg,lat_deg,height_ellipsoidal_m"
    rows = ",".join(str(value) for value in LOOKS_NORTH.ravel())
    inverse = ",".join(str(value) for value in LOOKS_NORTH.T.ravel())
    graphics = ",".join(str(value) for value in (LOOKS_NORTH * [1, -1, -1]).ravel())
    for head, names, values in (
        ("# rotation: world_from_cam\n", MATRIX, rows),
        ("# rotation: cam_from_world\n", MATRIX, inverse),
        ("# rotation: world_from_cam\n# camera_axes: right_up_backward\n", MATRIX, graphics),
        ("", "yaw_deg,pitch_deg,roll_deg", "0,0,0"),
        ("# pitch_zero: nadir\n", "yaw_deg,pitch_deg,roll_deg", "0,90,0"),
        ("", "omega_deg,phi_deg,kappa_deg", "90,0,0"),
    ):
        _, rotation = read_one_pose(tmp_path, head, f"{columns},{names}", f"{where},{values}")
        np.testing.assert_allclose(rotation, LOOKS_NORTH, rtol=0, atol=1e-9)


def test_lens_sigmas_and_covariance(tmp_path: Path) -> None:
    numbers = np.diag([1e-4, 4e-4, 9e-4, 1e-6, 1e-6, 4e-6])
    numbers[0, 1] = numbers[1, 0] = 5e-5
    quoted = '"' + " ".join(str(value) for value in numbers.ravel()) + '"'
    head = "# top_left_pixel: 0\n# sigma_position_m: 0.03\n# sigma_attitude_deg: 0.1\n"
    columns = f"image,lon_deg,lat_deg,height_ellipsoidal_m,qw,qx,qy,qz,{LENS_COLUMNS},k1,covariance"
    common = f"{format_geo(CENTRES[0])},{format_quaternion()},{LENS}"
    path = write(tmp_path / "p.csv", f"{head}{columns}\na.jpg,{common},-0.05,{quoted}\nb.jpg,{common},,\n")
    own, of_head = read_poses_csv(path).poses
    assert own.covariance is not None and of_head.covariance is not None
    np.testing.assert_allclose(own.covariance, numbers, rtol=1e-12)
    expected = [9e-4] * 3 + [np.radians(0.1) ** 2] * 3
    np.testing.assert_allclose(of_head.covariance, np.diag(expected), rtol=1e-12)
    assert (own.lens.cx_px, own.lens.cy_px, own.lens.k1, of_head.lens.k1) == (2011.0, 1491.0, -0.05, 0.0)


def test_a_reduced_photograph_has_its_lens_scaled(tmp_path: Path) -> None:
    columns = f"image,x,y,z,yaw_deg,pitch_deg,roll_deg,{LENS_COLUMNS},image_width_px,image_height_px"
    path = write(tmp_path / "p.csv", f"{columns}\na.jpg,1,2,3,0,0,0,{LENS},4000,3000\n")
    lens = read_poses_csv(path).poses[0].lens
    half = lens.scale_to(2000, 1500)
    assert (half.fx_px, half.cx_px, half.cy_px, half.width_px) == (1400.0, 1005.25, 745.25, 2000)
    with pytest.raises(InputDataError, match="aspect ratios differ"):
        lens.scale_to(3000, 4000)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("1,2,three,1,0,0,0", "column z: 'three' is not a number"),
        ("1,2,nan,1,0,0,0", "not finite"),
        ("1,2,3,0,0,0,7", "quaternion's length is 7"),
    ],
)
def test_a_bad_line_makes_its_photograph_unusable(tmp_path: Path, values: str, message: str) -> None:
    columns = f"image,x,y,z,qw,qx,qy,qz,{LENS_COLUMNS}"
    path = write(tmp_path / "p.csv", f"{columns}\na.jpg,{values},{LENS}\nb.jpg,1,2,3,1,0,0,0,{LENS}\n")
    found = read_poses_csv(path)
    assert [pose.image for pose in found.poses] == ["b.jpg"]
    assert found.unusable[0].image == "a.jpg" and message in found.unusable[0].reason


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# rotatoin: cam_from_world\nimage\n", "did you mean 'rotation'"),
        (
            "# rotation: camera_to_world\nimage,x,y,z,qw,qx,qy,qz,fx_px,fy_px,cx_px,cy_px\n",
            "allowed are world_from_cam",
        ),
        ("# north: true\n# north: grid\nimage\n", "stated twice"),
        ("image,x,y,z,qw,qx,qy,qz\n", "no column fx_px"),
        ("image,x,y,fx_px,fy_px,cx_px,cy_px\n", "position in no known way"),
        ("image,x,y,z,qw,qx,qy,qz,yaw_deg,pitch_deg,roll_deg,fx_px,fy_px,cx_px,cy_px\n", "attitude in several ways"),
        (
            "# crs: EPSG:25832\nimage,lon_deg,lat_deg,height_ellipsoidal_m,qw,qx,qy,qz,fx_px,fy_px,cx_px,cy_px\n",
            "are in EPSG:4979",
        ),
    ],
)
def test_a_contradictory_header_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputDataError, match=message):
        read_poses_csv(write(tmp_path / "poses.csv", text))


def test_comments_other_delimiters_and_the_folder(tmp_path: Path) -> None:
    path = write_geo_csv(tmp_path, head="# Exported on a Tuesday, at 10:30\n# rotation: world_from_cam\n")
    path.write_text(path.read_text().replace(",", ";").replace("Tuesday;", "Tuesday,"))
    assert len(read_poses(tmp_path).poses) == 4
    with pytest.raises(InputDataError, match=r"no poses at .*docs/poses-csv\.md"):
        read_poses(tmp_path / "nothing")


def test_a_covariance_beyond_all_numbers_is_one_bad_line(tmp_path: Path) -> None:
    lines = write_geo_csv(tmp_path).read_text().splitlines()
    whole = " ".join("1e999" if row == column else "0" for row in range(6) for column in range(6))
    lines[1] += ",covariance"
    lines[2] += f",{whole}"
    found = read_poses_csv(write(tmp_path / "poses.csv", "\n".join([*lines[:3], *(f"{line}," for line in lines[3:])])))
    assert len(found.poses) == 3 and "not finite" in found.unusable[0].reason
