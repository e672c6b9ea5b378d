"""COLMAP's text files, against its own documentation's example and by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest

from facadelake.core.errors import InputDataError
from facadelake.georeferencing.imported.colmap import read_colmap_text
from facadelake.georeferencing.imported.pose_files import read_poses
from tests.unit.georeferencing.imported_wall import CENTRES, LOOKS_NORTH, NAMES, ORIGIN, PLACE, write

CAMERAS = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 5
1 SIMPLE_RADIAL 3072 2304 2559.81 1536 1152 -0.0218531
2 PINHOLE 3072 2304 2560.56 2561 1536 1152
3 SIMPLE_PINHOLE 3072 2304 2559.69 1536 1152
4 RADIAL 3072 2304 2559.69 1536 1152 -0.02 0.003
5 OPENCV 3072 2304 2559.7 2560.1 1536 1152 -0.02 0.003 0.0004 -0.0005
6 OPENCV_FISHEYE 3072 2304 1000 1000 1536 1152 0 0 0 0
"""
# The example of https://colmap.github.io/format.html, images.txt.
IMAGES = """# Image list with two lines of data per image:
#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME
#   POINTS2D[] as (X, Y, POINT3D_ID)
# Number of images: 2, mean observations per image: 2
1 0.851773 0.0165051 0.503764 -0.142941 -0.737434 1.02973 3.74354 1 P1180141.JPG
2362.39 248.498 58396 1784.7 268.254 59027 1784.7 268.254 -1
2 0.851773 0.0165051 0.503764 -0.142941 -0.737434 1.02973 3.74354 1 P1180142.JPG
1190.83 663.957 23056 1258.77 640.354 59070
"""


def test_the_documentations_example(tmp_path: Path) -> None:
    """The centre is -R^T t, R from the quaternion by the textbook's formula; the camera looks along R's last row."""
    write(tmp_path / "cameras.txt", CAMERAS)
    write(tmp_path / "images.txt", IMAGES)
    found = read_poses(tmp_path)
    assert [pose.image for pose in found.poses] == ["P1180141.JPG", "P1180142.JPG"]
    w, x, y, z = 0.851773, 0.0165051, 0.503764, -0.142941
    cam_from_world = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    pose = found.poses[0]
    translation = np.array([-0.737434, 1.02973, 3.74354])
    np.testing.assert_allclose(pose.xyz_world, -cam_from_world.T @ translation, rtol=0, atol=5e-6)  # its six digits
    np.testing.assert_allclose(pose.world_from_cam[:, 2], cam_from_world[2], rtol=0, atol=5e-6)
    assert (pose.lens.fx_px, pose.lens.fy_px, pose.lens.k1, pose.lens.width_px) == (2559.81, 2559.81, -0.0218531, 3072)


@pytest.mark.parametrize(
    ("camera", "fy", "distortion"),
    [
        (2, 2561.0, (0.0, 0.0, 0.0, 0.0)),
        (3, 2559.69, (0.0, 0.0, 0.0, 0.0)),
        (4, 2559.69, (-0.02, 0.003, 0.0, 0.0)),
        (5, 2560.1, (-0.02, 0.003, 0.0004, -0.0005)),
    ],
)
def test_camera_models(tmp_path: Path, camera: int, fy: float, distortion: tuple[float, ...]) -> None:
    write(tmp_path / "cameras.txt", CAMERAS)
    write(tmp_path / "images.txt", f"1 1 0 0 0 0 0 0 {camera} a b.jpg\n\n")
    pose = read_colmap_text(tmp_path).poses[0]
    lens = pose.lens
    assert pose.image == "a b.jpg"
    assert (lens.fy_px, (lens.k1, lens.k2, lens.p1, lens.p2)) == (fy, distortion)


def test_bad_lines_and_missing_lines_of_points(tmp_path: Path) -> None:
    """Some writers leave the empty second lines out; a camera model that is not known costs its photographs alone."""
    write(tmp_path / "cameras.txt", CAMERAS)
    lines = ["1 1 0 0 0 0 0 0 1 a.jpg", "2 1 0 0 0 0 0 0 6 b.jpg", "3 1 1 0 0 0 0 0 1 c.jpg", "4 1 0 0 0 0 0 0 9 d.jpg"]
    write(tmp_path / "images.txt", "\n".join([*lines, "5 1 0 0"]))
    found = read_colmap_text(tmp_path)
    assert [pose.image for pose in found.poses] == ["a.jpg"]
    reasons = {line.image: line.reason for line in found.unusable}
    assert "OPENCV_FISHEYE; supported are" in reasons["b.jpg"]
    assert "length is 1.414" in reasons["c.jpg"]
    assert "camera 9 is not in cameras.txt" in reasons["d.jpg"]
    assert "neither IMAGE_ID" in reasons[""]


def write_colmap_files(folder: Path, georeference: str, from_map: np.ndarray, *, scale: float = 1.0) -> Path:
    """The wall's first camera in a world that is ``(map - from_map) / scale``, its axes the grid's."""
    lon, lat, height = ORIGIN.geo_from_site(CENTRES[:1])[0]
    east, north = pyproj.Proj("EPSG:25832")(lon, lat)
    world = (np.array([east, north, height]) - from_map) / scale
    tx, ty, tz = -LOOKS_NORTH.T @ world
    write(folder / "cameras.txt", "1 PINHOLE 4000 3000 2800 2810 2000 1500\n")
    # cam_from_world is the inverse of a turn by -90 degrees about east.
    write(folder / "images.txt", f"1 {np.sqrt(0.5)} {np.sqrt(0.5)} 0 0 {tx:.9f} {ty:.9f} {tz:.9f} 1 {NAMES[0]}\n\n")
    if georeference:
        write(folder / "georeference.txt", georeference)
    return folder


@pytest.mark.parametrize(
    ("georeference", "from_map", "scale"),
    [
        ("", (0.0, 0.0, 0.0), 1.0),
        ("crs: EPSG:25832\noffset: 456000 5421000 100\n", (456000.0, 5421000.0, 100.0), 1.0),
        (
            "# where it lies\ncrs: EPSG:25832\ntransform: 2.5 1 0 0 0 456000 5421000 0\n",
            (456000.0, 5421000.0, 0.0),
            2.5,
        ),
    ],
)
def test_worlds(tmp_path: Path, georeference: str, from_map: tuple[float, float, float], scale: float) -> None:
    found = read_colmap_text(write_colmap_files(tmp_path, georeference, np.array(from_map), scale=scale))
    pose = found.poses[0]
    centres, rotations = found.world.transform_to_site(pose.xyz_world[None], pose.world_from_cam[None], PLACE)
    np.testing.assert_allclose(centres[0], CENTRES[0], rtol=0, atol=1e-4)  # m
    convergence = np.radians(pyproj.Proj("EPSG:25832").get_factors(ORIGIN.lon_deg, ORIGIN.lat_deg).meridian_convergence)
    looks = [np.sin(convergence), np.cos(convergence), 0.0]
    np.testing.assert_allclose(rotations[0][:, 2], looks, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        "offset: 1 2 3\n", "crs: EPSG:25832\noffset: 1 2\n", "crs: EPSG:25832\nshift: 1 2 3\n",
        "crs: EPSG:25832\ntransform: 1 0 0 0 0 1 2 3\n", "crs: EPSG:25832\ntransform: 0 1 0 0 0 1 2 3\n",
    ],
)  # fmt: skip
def test_a_georeference_that_cannot_be_read(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputDataError, match=r"georeference\.txt"):
        read_colmap_text(write_colmap_files(tmp_path, text, np.zeros(3)))


def test_binary_models_are_told_how_to_become_text(tmp_path: Path) -> None:
    (tmp_path / "images.bin").write_bytes(b"\0")
    with pytest.raises(InputDataError, match="model_converter"):
        read_poses(tmp_path)
