"""The whole flow on a small building: what a user runs, runs again, changes and asks."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import geopandas as gpd
import numpy as np
import pytest

from facadelake.coverage import find_nearest_cells
from facadelake.lake.read import list_versions, read_table
from tests.flows.conftest import CAMPAIGN, SmallPortfolio
from tests.unit.severity.rule_headers import read_severities

pytestmark = pytest.mark.slow

CLI = [sys.executable, "-c", "from cli.main import main; main()"]
NOISE = ("Traceback", "Warning", "WARNING", "ERROR", "database is locked")


def run(*words: str, expect: int = 0) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own, as a user starts it."""
    done = subprocess.run([*CLI, *words], capture_output=True, text=True, env=dict(os.environ), timeout=900)
    assert done.returncode == expect, f"{done.stdout}\n{done.stderr}"
    return done


def inspect(small: SmallPortfolio, *more: str) -> str:
    """Inspect the small building; a good run's output has no library's chatter in it."""
    done = run("inspect", "small", CAMPAIGN, "--portfolio", str(small.registry), "--lake", str(small.lake), *more)
    assert not [word for word in NOISE if word in done.stdout + done.stderr], done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def first_run(small: SmallPortfolio) -> str:
    """The output of the first inspection, with two unusable files among the photographs."""
    photographs = sorted(small.images.rglob("*.JPG"))
    (small.images / "multiview" / "broken.JPG").write_bytes(photographs[0].read_bytes()[:40_000])
    shutil.copy(photographs[1], small.images / "multiview" / "twice.JPG")
    return inspect(small)


def rows(small: SmallPortfolio, name: str, as_of: int | None = None) -> list[dict[str, Any]]:
    """A table of the lake."""
    return read_table(small.lake, name, as_of=as_of).to_pylist()


def test_a_campaign_becomes_tables(small: SmallPortfolio, first_run: str) -> None:
    photos = {row["photo_id"]: row for row in rows(small, "photos")}
    assert photos["multiview/broken.JPG"]["photo_outcome"] == "unreadable"
    assert photos["multiview/twice.JPG"]["photo_outcome"] == "duplicate"
    accepted = [row for row in photos.values() if row["photo_outcome"] == "accepted"]
    localised = [row for row in rows(small, "poses") if row["qw"] is not None]
    assert len(localised) == len(accepted) == len(photos) - 2
    observations, defects = rows(small, "observations"), rows(small, "defects")
    assert {row["defect_id"] for row in observations} - {None} == {row["defect_id"] for row in defects}
    assert len(defects) >= 25
    assert all(row["severity"] in read_severities("width_and_extent_v1") for row in defects)
    assert all(row["passed"] for row in rows(small, "checks"))
    coverage = read_table(small.lake, "coverage")
    cells = find_nearest_cells(coverage, np.array([[row[f"{axis}_site_m"] for axis in "xyz"] for row in defects]))
    assert (cells >= 0).all()
    for row, cell in zip(defects, coverage.take(cells).to_pylist(), strict=True):
        assert cell["facade"] == row["facade"]  # one frame for both
        assert cell["imaged_count"] > 0  # where a defect was seen, coverage says that it could be
    for said in (
        "of facades imaged",
        "2 rejected",
        "broken.JPG",
        "georeference",
        "gcp",
        "by storey",
        "Ground floor",
        "published/small",
    ):
        assert said in first_run


def test_what_is_published_opens_elsewhere(small: SmallPortfolio, first_run: str) -> None:
    latest = small.lake / "published" / "small" / CAMPAIGN / "latest"
    in_lake = rows(small, "defects")
    parquet, package = gpd.read_parquet(latest / "defects.parquet"), gpd.read_file(latest / "defects.gpkg")
    assert len(parquet) == len(package) == len(in_lake)
    assert parquet.crs.to_epsg() == 4979
    cells = gpd.read_parquet(latest / "coverage.parquet")
    assert cells.area_m2.sum() > 500  # m2
    assert {"coverage_3d", "coverage_SE"} <= set(gpd.list_layers(latest / "defects.gpkg")["name"])
    report = (latest / "report.html").read_text()
    elevations = list(latest.glob("elevation_*.png"))
    assert elevations and all(elevation.name in report for elevation in elevations)
    assert all(layer.name in report for layer in latest.glob("coverage_*.png"))
    assert "broken.JPG" in report


def test_the_figures_against_truth_are_those_of_a_good_run(small: SmallPortfolio, first_run: str) -> None:
    done = run(
        "evaluate", "small", CAMPAIGN, "--truth", str(small.truth), "--json",
        "--portfolio", str(small.registry), "--lake", str(small.lake),
    )  # fmt: skip
    figures = json.loads(done.stdout)
    assert figures["photographs"]["localised"] == figures["photographs"]["total"] - 2
    assert 0.001 < figures["camera_error_m"]["mean"] < 0.10  # m; 800 px photographs, similarity to control points
    assert 0.001 < figures["defect_error_m"]["mae"] < 0.05  # m
    assert figures["merge"]["f1"] > 0.97
    assert figures["element_correct_share"] > 0.97
    assert figures["off_truth"] == 0


def test_a_photograph_is_shown_beside_the_model(small: SmallPortfolio, first_run: str, tmp_path: Path) -> None:
    photo_id = min(row["photo_id"] for row in rows(small, "observations") if row["defect_id"])
    place = ("--portfolio", str(small.registry), "--lake", str(small.lake))
    done = run("view", "small", CAMPAIGN, Path(photo_id).name, "--output", str(tmp_path / "view.png"), *place)
    assert photo_id in done.stdout
    sheet = cv2.imread(str(tmp_path / "view.png"))
    with np.load(tmp_path / "view.npz") as archive:
        depth_m, target = archive["depth_m"], archive["target"]
    assert sheet.shape[1] > 2 * depth_m.shape[1]
    # What the run registered lies in these images where the photograph shows it, as deep and on the same element.
    detections = {row["detection_id"]: row for row in rows(small, "detections")}
    scale = depth_m.shape[1] / 800
    for row in rows(small, "observations"):
        if row["photo_id"] == photo_id and row["defect_id"]:
            box = detections[row["detection_id"]]
            x = (box["box_x_px"] + box["box_width_px"] / 2) * scale
            y = (box["box_y_px"] + box["box_height_px"] / 2) * scale
            assert target[int(y), int(x)]
            assert 0.7 * row["distance_m"] < depth_m[int(y), int(x)] < row["distance_m"] + 0.5
    missing = run("view", "small", CAMPAIGN, "nothing.JPG", *place, expect=1)
    assert "'nothing.JPG' is not among the campaign's photographs" in missing.stderr


def test_pictures_are_drawn_from_the_lake_by_name(small: SmallPortfolio, first_run: str, tmp_path: Path) -> None:
    place = ("--portfolio", str(small.registry), "--lake", str(small.lake))
    seen = next(row for row in rows(small, "defects") if row["photo_count"] > 1)
    photo = Path(seen["best_photo_id"])
    done = run(
        "pictures", "small", CAMPAIGN, "--defect", seen["defect_id"], "--photo", photo.name, "--output", str(tmp_path),
        *place,
    )  # fmt: skip
    assert "card_" in done.stdout
    (card,), (overlay,) = tmp_path.glob("cards/*.png"), tmp_path.glob("overlays/*.jpg")
    assert photo.stem in overlay.name
    assert cv2.imread(str(card)).shape[1] == 1980
    unknown = run("pictures", "small", CAMPAIGN, "--defect", "D9999", *place, expect=1)
    assert "unknown defect 'D9999' in this campaign; similar names:" in " ".join(unknown.stderr.split())


def test_the_same_inputs_make_no_second_copy_and_changed_ones_a_version(small: SmallPortfolio, first_run: str) -> None:
    before = list_versions(small.lake).to_pylist()
    again = inspect(small)
    assert "unchanged" in again and "from the cache" in again
    assert list_versions(small.lake).to_pylist() == before
    count = len(rows(small, "detections"))
    inspect(small, "--detections", "noisy")
    after = list_versions(small.lake).to_pylist()
    assert len(after) == len(before) + 1
    assert len(rows(small, "detections")) != count
    assert len(rows(small, "detections", as_of=before[-1]["version"])) == count


def test_a_refused_input_is_a_message_and_commits_nothing(
    small: SmallPortfolio, first_run: str, tmp_path: Path
) -> None:
    before = list_versions(small.lake).to_pylist()
    done = run(
        "inspect", "small", CAMPAIGN, "--detections", str(tmp_path / "none.json"),
        "--portfolio", str(small.registry), "--lake", str(small.lake), expect=1,
    )  # fmt: skip
    assert "neither a file nor one of building 'small's alternatives (noisy)" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stdout + done.stderr
    assert list_versions(small.lake).to_pylist() == before
