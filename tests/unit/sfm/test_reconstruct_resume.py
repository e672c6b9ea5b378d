"""A reconstruction that is killed repeatedly resumes where it stopped."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.errors import FacadelakeError, InputDataError
from facadelake.core.frames import estimate_similarity
from facadelake.core.processes import parent as process_parent
from facadelake.core.progress import listen_to_progress
from facadelake.sfm.reconstruction import read_descriptors, read_reconstruction
from facadelake.sfm.reconstruction_job import reconstruct
from facadelake.sfm.settings import ReconstructionSettings
from facadelake.sfm.worker_process import open_work_folder

WIDTH, HEIGHT, FOCAL = 640, 480, 620.0
PHOTOS, PAIRS = 8, 28
SETTINGS = ReconstructionSettings(threads=1)

# The worker, killed by itself when the named step has advanced so far: as sudden as any kill, at a place that is known.
WORKER = """
import os, signal, sys, pathlib
from facadelake.sfm.worker import __main__ as main, features, report
features._PAIRS_PER_BATCH = 6
label, after = sys.argv[2], int(sys.argv[3])
step, advance = report.ProgressReport.step, report.ProgressReport.advance
now, done = [""], [0]
def watched_step(self, name, total):
    now[0], done[0] = name, 0
    return step(self, name, total)
def watched_advance(self, steps=1):
    advance(self, steps)
    done[0] += steps
    if now[0] == label and done[0] >= after:
        os.kill(os.getpid(), signal.SIGKILL)
report.ProgressReport.step, report.ProgressReport.advance = watched_step, watched_advance
sys.exit(main.main(pathlib.Path(sys.argv[1])))
"""


class ProgressRecorder:
    """The first advance of each step: what was done before."""

    def __init__(self) -> None:
        self.labels: list[str] = []
        self.first: dict[str, int] = {}

    def begin(self, label: str, total: int | None) -> int:
        self.labels.append(label)
        return len(self.labels) - 1

    def advance(self, handle: int, steps: int) -> None:
        self.first.setdefault(self.labels[handle], steps)

    def end(self, handle: int) -> None:
        pass


def centre(k: int) -> np.ndarray:
    """Photographs on an arc before a corner of two walls, 5 m away."""
    angle = np.radians(-35 + 10 * k)
    return np.array([5 * np.sin(angle), 0.3 * np.sin(2.0 * k), -5 * np.cos(angle)])


def photograph(k: int, walls: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Two textured walls that meet at x = 0, seen from ``centre(k)``."""
    forward = -centre(k) / np.linalg.norm(centre(k))
    right = np.cross([0.0, 1, 0], forward)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    matrix = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    seen = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    for texture, along in walls:
        # Texture pixel (u, v) lies at (u along the wall, v downwards), 200 px a metre.
        plane = np.column_stack([along / 200, [0, 1 / 200, 0], [0, -texture.shape[0] / 400, 0] - centre(k)])
        homography = matrix @ rotation @ plane
        warped = cv2.warpPerspective(texture, homography, (WIDTH, HEIGHT), flags=cv2.INTER_AREA)
        seen = np.maximum(seen, warped)
    return seen


@pytest.fixture
def photos(tmp_path: Path) -> pa.Table:
    rng = np.random.default_rng(4)
    walls = []
    for along in (np.array([0.94, 0, 0.34]), np.array([-0.94, 0, 0.34])):
        noise = sum(cv2.resize(rng.random((600 // s, 800 // s)), (800, 600)) * s for s in (4, 8, 16, 40))
        walls.append((cv2.normalize(noise, None, 20, 250, cv2.NORM_MINMAX).astype(np.uint8), along))
    rows = []
    for k in range(PHOTOS):
        (tmp_path / "images").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "images" / f"{k}.jpg"), photograph(k, walls))
        empty = ("camera_make", "camera_model", "focal_length_mm", "focal_length_35mm_mm", "taken_at", "prior_yaw_deg")
        empty += ("prior_lon_deg", "prior_lat_deg", "prior_height_m", "prior_pitch_deg")
        empty += ("prior_sigma_horizontal_m", "prior_sigma_vertical_m")
        row: dict[str, Any] = {
            "photo_id": f"{k}.jpg",
            "sha256": str(k),
            "photo_outcome": "accepted",
            "role": "multiview",
        }
        row |= {"image_width_px": WIDTH, "image_height_px": HEIGHT, "prior_focal_px": FOCAL}
        rows.append(row | dict.fromkeys(empty))
    return pa.Table.from_pylist(rows)


def counts(folder: Path, table: str) -> set[int]:
    (path,) = folder.glob(".work-*/features.db")
    column = "image_id" if table == "descriptors" else "pair_id"
    with sqlite3.connect(path) as connection:
        return {row[0] for row in connection.execute(f"SELECT {column} FROM {table}")}


def test_a_killed_reconstruction_is_resumed(photos: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = subprocess.Popen
    folder = tmp_path / "cache"

    def run(label: str, after: int, recorder: ProgressRecorder) -> None:
        worker = [sys.executable, "-c", WORKER]
        monkeypatch.setattr(
            process_parent.subprocess,
            "Popen",
            lambda command, **how: real([*worker, command[-1], label, str(after)], **how),
        )
        part = folder / "part"
        with listen_to_progress(recorder):
            try:
                reconstruct(photos, tmp_path / "images", part, SETTINGS)
            finally:
                shutil.rmtree(part / "sparse", ignore_errors=True)

    with pytest.raises(FacadelakeError, match=r"SIGKILL.* a new run resumes where it stopped"):
        run("Extracting features", 4, ProgressRecorder())
    found = counts(folder, "descriptors")
    assert 4 <= len(found) < PHOTOS
    for image_id in found:  # what is done needs its photographs no more
        (tmp_path / "images" / f"{image_id - 1}.jpg").unlink()

    second = ProgressRecorder()
    with pytest.raises(FacadelakeError, match="SIGKILL"):
        run("Matching features", 6, second)
    assert second.first["Extracting features"] == len(found)
    assert len(counts(folder, "descriptors")) == PHOTOS
    compared = counts(folder, "two_view_geometries")
    assert 6 <= len(compared) < PAIRS
    (path,) = folder.glob(".work-*/features.db")
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE written (pair_id INTEGER)")
        connection.execute(
            "CREATE TRIGGER noted AFTER INSERT ON matches BEGIN INSERT INTO written VALUES (NEW.pair_id); END"
        )

    with pytest.raises(FacadelakeError, match="SIGKILL"):
        run("Mapping photographs", 7, ProgressRecorder())
    assert len(counts(folder, "two_view_geometries")) == PAIRS
    assert counts(folder, "written") == counts(folder, "two_view_geometries") - compared

    (snapshots,) = folder.glob(".work-*/snapshots-0")
    (snapshots / "99999999999999").mkdir()  # one that the kill cut off
    recorder = ProgressRecorder()
    run("nothing", 0, recorder)
    assert recorder.first["Extracting features"] == PHOTOS
    assert recorder.first["Matching features"] == PAIRS
    assert 3 <= recorder.first["Mapping photographs"] < PHOTOS
    assert [path.name for path in folder.iterdir() if path.is_dir()] == ["part"]

    block = read_reconstruction(folder / "part")
    assert len(block.photos) == PHOTOS
    assert read_descriptors(folder / "part").shape == (len(block.xyz_sfm), 128)
    truth = np.array([centre(int(photo.photo_id[0])) for photo in block.photos])
    placed = estimate_similarity(block.centres_sfm, truth).apply(block.centres_sfm)
    error_m = np.linalg.norm(placed - truth, axis=1).mean()
    assert 0.0005 < error_m < 0.05  # of 5 m, in photographs of 640 px


def test_work_of_refused_and_abandoned_jobs_is_removed(tmp_path: Path) -> None:
    with pytest.raises(InputDataError), open_work_folder(tmp_path, "refused"):
        raise InputDataError("no overlap")
    with pytest.raises(KeyboardInterrupt), open_work_folder(tmp_path, "stopped"):
        raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt), open_work_folder(tmp_path, "old") as old:
        raise KeyboardInterrupt
    os.utime(old, (0, 0))
    (tmp_path / ".work-removed.removed").mkdir()  # a kill came while it was being removed
    with open_work_folder(tmp_path, "new") as new:
        assert new.is_dir()
        assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == [".work-new", ".work-stopped"]
