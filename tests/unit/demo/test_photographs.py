"""Rendered photographs against truth, by a projection written out here and by the pixels that a defect changes."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pyproj
import pytest
from numpy.typing import NDArray
from PIL import Image

from facadelake.demo.generate import DemoFiles
from facadelake.demo.recipe import DemoRecipe

Rows = list[dict[str, str]]


def read(path: Path) -> Rows:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def enu(rows: Rows, recipe: DemoRecipe) -> NDArray[np.float64]:
    """Geographic truth as east-north-up about the recipe's place, by PROJ's own topocentric conversion."""
    place = recipe.place
    pipeline = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=GRS80 +step "
        f"+proj=topocentric +ellps=GRS80 +lon_0={place.lon_deg} +lat_0={place.lat_deg} "
        f"+h_0={place.height_ellipsoidal_m}"
    )
    columns = [[float(r[k]) for r in rows] for k in ("lon_deg", "lat_deg", "height_ellipsoidal_m")]
    return np.column_stack(pyproj.Transformer.from_pipeline(pipeline).transform(*columns))


def project(camera: dict[str, str], centre: NDArray[np.float64], xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Brown's model, written out."""
    value = {k: float(v) for k, v in camera.items() if k != "image"}
    rotation = np.array([[value[f"cam_from_site_r{i}{j}"] for j in range(3)] for i in range(3)])
    x, y, z = rotation @ (xyz - centre)
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + value["k1"] * r2 + value["k2"] * r2**2
    xd = x * radial + 2 * value["p1"] * x * y + value["p2"] * (r2 + 2 * x * x)
    yd = y * radial + value["p1"] * (r2 + 2 * y * y) + 2 * value["p2"] * x * y
    return np.array([value["fx_px"] * xd + value["cx_px"], value["fy_px"] * yd + value["cy_px"]])


@dataclass(frozen=True, kw_only=True)
class DefectInImage:
    """A box, the check point's projection, and the centre of the pixels that the defect changed."""

    kind: str
    box_px: NDArray[np.float64]
    projected_px: NDArray[np.float64]
    changed_px: NDArray[np.float64]


@pytest.fixture(scope="module")
def visible_defects(small_demo: DemoFiles, small_recipe: DemoRecipe) -> list[DefectInImage]:
    before, after = (c.folder for c in small_demo.campaigns)
    coco: dict[str, Any] = json.loads((after / "detections.coco.json").read_text())
    names = {i["id"]: i["file_name"] for i in coco["images"]}
    cameras = read(after / "truth" / "cameras.csv")
    centres = dict(zip((c["image"] for c in cameras), enu(cameras, small_recipe), strict=True))
    by_name = {c["image"]: c for c in cameras}
    points = read(after / "truth" / "checkpoints.csv")
    places = {p["id"]: (p["class"], xyz) for p, xyz in zip(points, enu(points, small_recipe), strict=True)}
    shows = {
        int(r["annotation_id"]): r["checkpoint_id"]
        for r in read(after / "truth" / "detections.csv")
        if r["file"] == "detections.coco.json"
    }
    images = {
        name: [np.asarray(Image.open(f / "images" / name), dtype=np.float64) for f in (before, after)]
        for name in by_name
    }
    found = []
    for annotation in coco["annotations"]:
        point = shows[annotation["id"]]
        if point == "off_target":
            continue
        name, (x, y, w, h) = names[annotation["image_id"]], annotation["bbox"]
        a, b = images[name]
        # The box itself and a rim of 3 px: neighbours are further away than that.
        x0, y0 = max(0, int(x) - 3), max(0, int(y) - 3)
        window = (slice(y0, int(y + h) + 4), slice(x0, int(x + w) + 4))
        rows, columns = np.nonzero(np.abs(a[window] - b[window]).max(axis=2) > 24)
        if len(rows) < 8:
            continue
        kind, xyz = places[point]
        found.append(
            DefectInImage(
                kind=kind,
                box_px=np.array([x + w / 2, y + h / 2]),
                projected_px=project(by_name[name], centres[name], xyz),
                changed_px=np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2 + [x0, y0],
            )
        )
    return found


def test_boxes_are_centred_on_the_projected_check_points(visible_defects: list[DefectInImage]) -> None:
    off = np.array([s.box_px - s.projected_px for s in visible_defects])
    assert len(off) > 50
    np.testing.assert_allclose(off, 0.0, rtol=0, atol=0.02)  # px


def test_drawn_defects_are_where_truth_projects(visible_defects: list[DefectInImage]) -> None:
    """The middle of the pixels that a defect changes; faint tips and brick behind brick leave some a little off."""
    off = np.array([s.changed_px - s.projected_px for s in visible_defects])
    assert {s.kind for s in visible_defects} == {"crack", "spalling", "moisture"}
    assert np.abs(np.median(off, axis=0)).max() < 0.4  # px: no common shift
    assert np.median(np.linalg.norm(off, axis=1)) < 1.2  # px
    assert np.percentile(np.linalg.norm(off, axis=1), 80) < 2.2  # px


def test_tags_state_the_position_with_the_injected_errors(small_demo: DemoFiles, small_recipe: DemoRecipe) -> None:
    folder, flight = small_demo.campaigns[0].folder, small_recipe.campaigns[0].flight
    cameras = read(folder / "truth" / "cameras.csv")
    tags: Rows = []
    yaw_errors = []
    for camera in cameras:
        with Image.open(folder / "images" / camera["image"]) as image:
            exif, xmp = image.getexif(), image.info["xmp"].decode()
        gps, detail = exif.get_ifd(0x8825), exif.get_ifd(0x8769)
        assert (exif[0x010F], gps[1], gps[3], gps[5]) == ("DJI", "N", "E", b"\x00")
        assert detail[0x9003].startswith("2026:04:14 10:2")
        assert detail[0xA002] == small_recipe.optics.width_px
        lat, lon = (float(d) + float(m) / 60 + float(s) / 3600 for d, m, s in (gps[2], gps[4]))
        dji = {
            key.split("}")[1]: value
            for node in ElementTree.fromstring(xmp).iter()
            for key, value in node.attrib.items()
            if "drone-dji" in key
        }
        assert abs(lat - float(dji["GpsLatitude"])) < 2e-8  # deg, 2 mm
        assert abs(lon - float(dji["GpsLongitude"])) < 2e-8  # deg
        assert abs(float(gps[6]) - float(dji["AbsoluteAltitude"])) < 0.002  # m
        assert float(dji["AbsoluteAltitude"]) - float(dji["RelativeAltitude"]) == pytest.approx(
            small_recipe.place.height_ellipsoidal_m, rel=0, abs=0.002
        )
        tags.append({"lon_deg": str(lon), "lat_deg": str(lat), "height_ellipsoidal_m": str(float(gps[6]))})
        forward = [float(camera[f"cam_from_site_r2{j}"]) for j in range(3)]
        yaw = np.degrees(np.arctan2(forward[0], forward[1]))
        yaw_errors.append((float(dji["GimbalYawDegree"]) - yaw + 180) % 360 - 180)
        pitch = np.degrees(np.arcsin(forward[2]))
        assert abs(float(dji["GimbalPitchDegree"]) - pitch - flight.attitude_bias_deg[1]) < 4 * 0.8  # deg
    error = enu(tags, small_recipe) - enu(cameras, small_recipe)
    tolerance = 3.5 * np.array(flight.gps_noise_m) / np.sqrt(len(error))
    assert (np.abs(error.mean(axis=0) - flight.gps_bias_m) < tolerance).all()
    assert (error.std(axis=0) > 0.3 * np.array(flight.gps_noise_m)).all()
    assert (error.std(axis=0) < 2.2 * np.array(flight.gps_noise_m)).all()
    assert abs(np.mean(yaw_errors) - flight.attitude_bias_deg[0]) < 3.5 * 0.8 / np.sqrt(len(yaw_errors))  # deg


def test_control_points_project_onto_their_marks(small_demo: DemoFiles, small_recipe: DemoRecipe) -> None:
    """Survey and clicking errors are there, and no larger than stated."""
    folder = small_demo.campaigns[1].folder
    head, *lines = (folder / "gcp_list.txt").read_text().splitlines()
    cameras = {c["image"]: c for c in read(folder / "truth" / "cameras.csv")}
    centres = dict(zip(cameras, enu(list(cameras.values()), small_recipe), strict=True))
    grid = pyproj.Transformer.from_crs(pyproj.CRS(head).to_3d(), "EPSG:4979", always_xy=True)
    clicked, drawn = [], []
    for line in lines:
        east, north, height, x, y, name, _ = line.split()
        lon, lat, up = grid.transform(float(east), float(north), float(height))
        row = {"lon_deg": str(lon), "lat_deg": str(lat), "height_ellipsoidal_m": str(up)}
        pixel = project(cameras[name], centres[name], enu([row], small_recipe)[0])
        clicked.append(np.array([float(x), float(y)]) - pixel)
        grey = np.asarray(Image.open(folder / "images" / name).convert("L"))
        start = np.array([[pixel - 0.5]], dtype=np.float32)  # OpenCV counts from a pixel's centre
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3)
        drawn.append(cv2.cornerSubPix(grey, start, (3, 3), (-1, -1), criteria)[0, 0] + 0.5 - pixel)
    assert len(clicked) >= 5
    assert 0.1 < np.sqrt(np.mean(np.square(clicked))) < 0.8  # px
    assert np.abs(np.mean(drawn, axis=0)).max() < 0.45  # px
    assert np.sqrt(np.mean(np.square(drawn))) < 1.0  # px
