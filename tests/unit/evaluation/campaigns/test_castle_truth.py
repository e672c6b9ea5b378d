"""The published cameras of the castle, given as if a run had found them, make the figures that the benchmark's have."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.detection.coco.import_detections import import_coco
from tests.unit.evaluation.campaigns.campaigns import evaluate_tables

pytestmark = pytest.mark.realdata
# Not truth's own origin: 30 m off, so that positions must come through EPSG:4979.
ORIGIN = SiteOrigin(lon_deg=8.4081, lat_deg=48.9403, height_ellipsoidal_m=150.0)
TRUTH_ORIGIN = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)


@pytest.mark.parametrize(("boxes", "shown"), [("detections.coco.json", 925), ("detections_noisy.coco.json", 842)])
def test_published_cameras(shared_data: Path, boxes: str, shown: int) -> None:
    castle = shared_data / "castle"
    with (castle / "truth" / "cameras.csv").open() as stream:
        cameras = list(csv.DictReader(stream))
    # East-north-up of one origin in the other's: a turn of some seconds of arc.
    turn = (ORIGIN.ecef_from_site().invert() @ TRUTH_ORIGIN.ecef_from_site()).rotation
    photos, poses = [], []
    for row in cameras:
        name = {"photo_id": row["image"]}
        size = {"image_width_px": 3072, "image_height_px": 2048}
        photos.append(
            {**name, **size, "sha256": "0", "bytes": 1, "photo_outcome": "accepted", "prior_source": "none",
             "prior_height_datum": "unknown"}
        )  # fmt: skip
        cam_from_site = np.array([[float(row[f"cam_from_site_r{i}{j}"]) for j in range(3)] for i in range(3)])
        qx, qy, qz, qw = Rotation.from_matrix(turn @ cam_from_site.T).as_quat()
        geo = np.array([[float(row[c]) for c in ("lon_deg", "lat_deg", "height_ellipsoidal_m")]])
        x, y, z = ORIGIN.site_from_geo(geo)[0]
        poses.append(
            {**name, **size, "pose_source": "sfm", "tie_points": 0, "x_site_m": x, "y_site_m": y, "z_site_m": z,
             "qw": qw, "qx": qx, "qy": qy, "qz": qz, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
             **{k: float(row[k]) for k in ("fx_px", "fy_px", "cx_px", "cy_px")}}
        )  # fmt: skip
    photo_table = table_from_rows("photos", photos)
    figures = evaluate_tables(
        photos=photo_table,
        poses=table_from_rows("poses", poses),
        detections=import_coco(castle / boxes, photo_table, class_names={}),
        observations=table_from_rows("observations", []),
        defects=table_from_rows("defects", []),
        truth=castle / "truth",
        origin=ORIGIN,
        map_crs="EPSG:25832",
    )
    assert (figures.photographs_total, figures.photographs_localised, figures.camera_error.n) == (29, 29, 29)
    assert figures.camera_error.mae == pytest.approx(0.0, rel=0, abs=1e-4)  # m
    assert figures.ray_error.n == shown
    if boxes == "detections.coco.json":
        # methods.md: rays of the published cameras miss by 0.4 cm on average, the measurement of the check points.
        assert 0.003 < (figures.ray_error.mean or 0) < 0.005
    else:
        assert 0.006 < (figures.ray_error.mean or 0) < 0.04  # jittered boxes
    assert figures.registered_without_check_point == 0
