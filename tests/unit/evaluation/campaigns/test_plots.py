"""Pictures of an evaluation: those that have samples are written, and they show them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from facadelake.evaluation.campaigns.comparison import compare_with_truth
from facadelake.evaluation.campaigns.plots import write_plots
from tests.unit.evaluation.campaigns.campaigns import CRS, ORIGIN, Made, MadeObservation, pixel, tables, write_truth

CAMERA = np.array([0.0, -15.0, 3.0])


def written(made: Made, folder: Path) -> list[Path]:
    compared = compare_with_truth(**tables(made), truth=write_truth(folder / "truth", made), origin=ORIGIN, map_crs=CRS)
    return write_plots(compared, folder / "plots", "hall 2026-04")


def campaign(count: int, error_m: float) -> Made:
    rng = np.random.default_rng(2)
    points = {f"C{i}": np.array([rng.uniform(-8, 8), 0.0, rng.uniform(0, 8)]) for i in range(count)}
    found = {name: point + rng.normal(0, error_m, 3) for name, point in points.items()}
    covariance = np.eye(3) * error_m**2
    return Made(
        centres_true_m={"a.jpg": CAMERA},
        centres_found_m={"a.jpg": CAMERA + 0.01},
        points_true_m=points,
        observations=[
            MadeObservation(
                photo="a.jpg", shows=name, xyz_site_m=found[name], box_centre_px=pixel(CAMERA, points[name]),
                defect=f"D{name}", covariance_m2=covariance,
            )
            for name in points
        ],
        defects_m={f"D{name}": found[name] for name in points},
        covariance_m2={"a.jpg": covariance, **{f"D{name}": covariance for name in points}},
    )  # fmt: skip


def test_every_picture_is_drawn(tmp_path: Path) -> None:
    pictures = written(campaign(30, 0.01), tmp_path)
    assert [path.name for path in pictures] == ["errors.png", "vectors.png", "deviation.png", "sigmas.png", "views.png"]
    for path in pictures:
        image = cv2.imread(str(path))
        assert image is not None and min(image.shape[:2]) > 400
        coloured = np.ptp(image.astype(int), axis=2) > 60  # everything but the samples is grey
        assert coloured.sum() > 200, path.name


def test_a_campaign_without_detections_has_errors_of_cameras_alone(tmp_path: Path) -> None:
    made = Made(centres_true_m={"a.jpg": CAMERA}, centres_found_m={"a.jpg": CAMERA + 0.01}, points_true_m={})
    assert [path.name for path in written(made, tmp_path)] == ["errors.png"]
