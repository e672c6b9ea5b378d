"""A made campaign: one wall that faces south, cameras before it, and errors of known size put into every table."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from facadelake.core.geodesy import SiteOrigin
from facadelake.core.tables import table_from_rows
from facadelake.evaluation.campaigns.comparison import compare_with_truth
from facadelake.evaluation.campaigns.evaluate import compute_figures
from facadelake.evaluation.campaigns.figures import CampaignFigures

Array = NDArray[np.float64]
CRS = "EPSG:25832"
ORIGIN = SiteOrigin(lon_deg=8.4083, lat_deg=48.9409, height_ellipsoidal_m=171.5)
FOCAL, WIDTH, HEIGHT = 2800.0, 4000, 3000
# Columns: camera x is east, camera y is down, camera z is north.
QUATERNION = {"qw": np.sqrt(0.5), "qx": -np.sqrt(0.5), "qy": 0.0, "qz": 0.0}
OUTWARD = (0.0, -1.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class MadeObservation:
    """A box: which photograph, which check point it shows (None: nothing), where it was registered, in which defect."""

    photo: str
    shows: str | None
    xyz_site_m: Array
    box_centre_px: tuple[float, float]
    defect: str | None = None
    outcome: str = "registered"
    element: str = "wall"
    detection_outcome: str = "accepted"
    covariance_m2: Array | None = None


@dataclass(frozen=True, kw_only=True)
class Made:
    """What a test needs to say; everything else of the tables is filler."""

    centres_true_m: Mapping[str, Array]
    centres_found_m: Mapping[str, Array]
    points_true_m: Mapping[str, Array]
    observations: Sequence[MadeObservation] = ()
    defects_m: Mapping[str, Array] = field(default_factory=dict)
    unlocalised: Sequence[str] = ()
    covariance_m2: Mapping[str, Array] = field(default_factory=dict)  # of a camera's centre or a defect, (3, 3)
    detector: str = "coco:boxes.json"


def pixel(centre_m: Array, point_m: Array) -> tuple[float, float]:
    """A pinhole by hand: looks north, no distortion."""
    east, north, up = point_m - centre_m
    return WIDTH / 2 + FOCAL * east / north, HEIGHT / 2 - FOCAL * up / north


def _place(xyz: Array) -> dict[str, float]:
    lon, lat, height = ORIGIN.geo_from_site(xyz[None])[0]
    east, north, height_map = ORIGIN.map_from_site(xyz[None], CRS)[0]
    return {
        "x_site_m": xyz[0], "y_site_m": xyz[1], "z_site_m": xyz[2], "lon_deg": lon, "lat_deg": lat,
        "height_ellipsoidal_m": height, "east_map_m": east, "north_map_m": north, "height_map_m": height_map,
        "normal_x": OUTWARD[0], "normal_y": OUTWARD[1], "normal_z": OUTWARD[2],
    }  # fmt: skip


def tables(made: Made) -> dict[str, pa.Table]:
    """The five tables that evaluation reads."""
    photos, poses = [], []
    for name in made.centres_true_m:
        photos.append(
            {
                "photo_id": name, "sha256": name, "bytes": 1, "photo_outcome": "accepted", "image_width_px": WIDTH,
                "image_height_px": HEIGHT, "prior_source": "none", "prior_height_datum": "unknown",
            }
        )  # fmt: skip
        pose: dict[str, Any] = {
            "photo_id": name, "pose_source": "unlocalised", "image_width_px": WIDTH, "image_height_px": HEIGHT,
            "tie_points": 0,
        }  # fmt: skip
        if name not in made.unlocalised:
            x, y, z = made.centres_found_m[name]
            pose |= {"pose_source": "sfm", "x_site_m": x, "y_site_m": y, "z_site_m": z, **QUATERNION}
            pose |= {"fx_px": FOCAL, "fy_px": FOCAL, "cx_px": WIDTH / 2, "cy_px": HEIGHT / 2}
            pose |= dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
            if name in made.covariance_m2:
                whole = np.eye(6)  # an attitude known to a radian, which is not to be taken for the centre's metres
                whole[:3, :3] = made.covariance_m2[name]
                pose["covariance"] = whole.ravel().tolist()
        poses.append(pose)
    detections, observations = [], []
    for i, made_one in enumerate(made.observations):
        detection_id = f"{made_one.photo}#{i}"
        x, y = made_one.box_centre_px
        detections.append(
            {
                "detection_id": detection_id, "photo_id": made_one.photo, "source_annotation": str(i),
                "detection_outcome": made_one.detection_outcome, "defect_class": "crack", "source_class": "crack",
                "score": 1.0, "box_x_px": x - 20, "box_y_px": y - 15, "box_width_px": 40.0, "box_height_px": 30.0,
                "detector": made.detector, "detector_sha256": "0",
            }
        )  # fmt: skip
        observation: dict[str, Any] = {
            "detection_id": detection_id, "photo_id": made_one.photo, "observation_outcome": made_one.outcome,
            "defect_class": "crack", "target_share": 1.0,
        }  # fmt: skip
        if made_one.outcome == "registered":
            observation |= _place(made_one.xyz_site_m)
            observation |= {"gsd_mm": 5.0, "incidence_deg": 10.0 + i % 5, "distance_m": 15.0 + i % 7}
            observation |= {"element_guid": made_one.element, "defect_id": made_one.defect}
            if made_one.covariance_m2 is not None:
                observation["covariance_site"] = made_one.covariance_m2.ravel().tolist()
        observations.append(observation)
    defects = [
        {
            "defect_id": name, "defect_class": "crack", "severity": "low", "severity_rule": "test",
            **_place(xyz), "width_m": 0.2, "height_m": 0.2, "area_m2": 0.04, "spread_m": 0.0, "photo_count": 1,
            "score": 1.0, "best_photo_id": "a", "element_guid": "wall", "ifc_class": "IfcWall", "facade": "S",
            "geometry": b"",
            "covariance_site": made.covariance_m2[name].ravel().tolist() if name in made.covariance_m2 else None,
        }
        for name, xyz in made.defects_m.items()
    ]  # fmt: skip
    rows = {
        "photos": photos,
        "poses": poses,
        "detections": detections,
        "observations": observations,
        "defects": defects,
    }
    return {name: table_from_rows(name, content) for name, content in rows.items()}


def write_truth(folder: Path, made: Made) -> Path:
    """A truth folder whose site columns are of another origin: only EPSG:4979 may be read."""
    folder.mkdir(exist_ok=True)

    def geo(xyz: Array) -> list[Any]:
        elsewhere = [value + 40.0 for value in xyz]
        return [*elsewhere, *(repr(float(value)) for value in ORIGIN.geo_from_site(xyz[None])[0])]

    position = ["x_site_m", "y_site_m", "z_site_m", "lon_deg", "lat_deg", "height_ellipsoidal_m"]
    write_csv(folder / "cameras.csv", ["image", *position], [[n, *geo(xyz)] for n, xyz in made.centres_true_m.items()])
    points = [[n, *geo(xyz), "wall"] for n, xyz in made.points_true_m.items()]
    write_csv(folder / "checkpoints.csv", ["id", *position, "element_guid"], points)
    shown = [["boxes.json", i, s.shows or "off_target"] for i, s in enumerate(made.observations)]
    write_csv(folder / "detections.csv", ["file", "annotation_id", "checkpoint_id"], shown)
    return folder


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(rows)


def evaluate_tables(**arguments: Any) -> CampaignFigures:
    """The figures of a campaign's tables against a truth folder; arguments of ``compare_with_truth``."""
    return compute_figures(compare_with_truth(**arguments))
