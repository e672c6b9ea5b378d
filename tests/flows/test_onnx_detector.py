"""The whole flow with an ONNX detector, which processes only the parts of photographs that show the building."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from benchmarks.published_poses import write_published_poses
from facadelake.building.model import read_building
from facadelake.building.surface.raycasting import Surface
from facadelake.core.pose_table import read_posed_cameras
from facadelake.detection.tiling.plan import SCALE_RATIO_MIN
from facadelake.lake.read import read_table
from tests.flows.conftest import CAMPAIGN, SmallPortfolio
from tests.unit.detection.onnx_models import HEIGHT, WIDTH, make_card, make_output, save_model

pytestmark = pytest.mark.slow

CLI = [sys.executable, "-c", "from cli.main import main; main()"]
GSD_MM = 80.0  # about a quarter of the photographs' resolution: about eight tiles each


@pytest.fixture(scope="module")
def inspected(small: SmallPortfolio, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The lake and the output of a campaign of six photographs, one of them torn and one without a pose.

    The model returns a crack at the centre of every image, and a car beside it: rows show which tiles it processed.
    """
    root = tmp_path_factory.mktemp("inspected")
    images = root / "images"
    photographs = sorted(small.images.rglob("*.JPG"))
    for path in photographs[:: max(1, len(photographs) // 4)][:4]:
        (images / path.relative_to(small.images)).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, images / path.relative_to(small.images))
    (images / "torn.JPG").write_bytes(photographs[0].read_bytes()[:40_000])
    shutil.copy(photographs[1], images / "elsewhere.JPG")
    write_published_poses(small.truth, root / "poses.csv", noise=None)
    centre = (40, WIDTH / 2, HEIGHT / 2, 10.0, 8.0, 0.75, 0)
    beside = (50, WIDTH / 2 + 20, HEIGHT / 2, 10.0, 8.0, 0.5, 1)
    save_model(root / "everywhere.onnx", make_output("yolov8", [centre, beside]))
    content = make_card("yolov8", name="everywhere")
    content["input"]["gsd_mm"] = [GSD_MM]
    (root / "everywhere.card.yaml").write_text(yaml.safe_dump(content))
    building = {
        "id": "small",
        "name": "A small building",
        "model": str(small.registry.parent / "building" / "demo.ifc"),
        "photographs": "images",
        "campaigns": [CAMPAIGN],
        "poses": "poses.csv",
        "detector": {"kind": "onnx", "model": "everywhere.onnx"},
    }
    (root / "portfolio.yaml").write_text(yaml.safe_dump({"buildings": [building]}))
    done = subprocess.run(
        [*CLI, "inspect", "small", "--portfolio", str(root / "portfolio.yaml"), "--lake", str(root / "lake")],
        capture_output=True,
        text=True,
        env=dict(os.environ),
        timeout=900,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stdout + done.stderr
    return root / "lake", done.stdout


def test_tiles_cover_the_building_and_no_tile_of_sky_is_processed(inspected: tuple[Path, str]) -> None:
    lake, _ = inspected
    (folder,) = (path for path in (lake / "cache" / "load-model").iterdir() if path.is_dir())
    building = read_building(folder)
    surface = Surface(building)
    posed = read_posed_cameras(read_table(lake, "poses"))
    cracks = [row for row in read_table(lake, "detections").to_pylist() if row["source_class"] == "crack"]
    beside = 0
    for photo_id, camera in posed.items():
        wide, high = camera.camera.width_px, camera.camera.height_px
        depth, _ = surface.render_depth(camera, 1.0)
        shown = np.isfinite(depth)
        gain = float(np.median(depth[shown])) / camera.camera.fx_px * 1000 / GSD_MM
        if gain <= SCALE_RATIO_MIN * min(WIDTH / wide, HEIGHT / high):
            continue  # at this distance the whole photograph is one tile
        centres = np.array(
            [
                (row["box_x_px"] + row["box_width_px"] / 2, row["box_y_px"] + row["box_height_px"] / 2)
                for row in cracks
                if row["photo_id"] == photo_id
            ]
        )
        tile = np.array([WIDTH, HEIGHT]) / gain
        processed = np.zeros_like(shown)
        for x, y in centres:
            # A margin: edges of the model and of the photographed building may differ by pixels.
            half = tile / 2 + 0.03 * wide
            left, top = (int(max(0, value)) for value in (x - half[0], y - half[1]))
            part = (slice(top, int(y + half[1])), slice(left, int(x + half[0])))
            assert shown[part].any(), f"{photo_id}: sky was processed at about {x:.0f}, {y:.0f}"
            processed[part] = True
        assert processed[shown].mean() > 0.99, photo_id
        beside += len(centres) < np.ceil(wide / tile[0]) * np.ceil(high / tile[1])
    assert beside > 0  # in some photographs whole tiles show sky


def test_detections_are_registered_on_the_building(inspected: tuple[Path, str]) -> None:
    lake, _ = inspected
    detections = read_table(lake, "detections").to_pylist()
    assert {row["detector"] for row in detections} == {"onnx:everywhere"}
    cars = [row for row in detections if row["source_class"] == "car"]
    assert {row["detection_outcome"] for row in cars} == {"unknown_class"}
    observations = read_table(lake, "observations").to_pylist()
    seen = [row for row in observations if row["observation_outcome"] != "unlocalised"]
    on_it = sum(row["observation_outcome"] in ("registered", "grazing") for row in seen)
    assert on_it > 0.3 * len(seen)  # the centre of a tile that shows the building may lie beside it
    defects = read_table(lake, "defects").to_pylist()
    assert defects and {row["defect_class"] for row in defects} == {"crack"}


def test_bad_photographs_do_not_affect_the_others(inspected: tuple[Path, str]) -> None:
    lake, output = inspected
    photos = {row["photo_id"]: row["photo_outcome"] for row in read_table(lake, "photos").to_pylist()}
    assert photos["torn.JPG"] == "unreadable" and "torn.JPG" in output
    detections = read_table(lake, "detections").to_pylist()
    assert "torn.JPG" not in {row["photo_id"] for row in detections}
    # Without a pose the building's position is unknown: the whole photograph is processed, with the reason.
    lost = [row for row in detections if row["photo_id"] == "elsewhere.JPG" and row["source_class"] == "crack"]
    assert len(lost) > 30
    assert all("has no pose" in row["reason"] for row in lost)
    outcomes = {row["detection_id"]: row["observation_outcome"] for row in read_table(lake, "observations").to_pylist()}
    assert {outcomes[row["detection_id"]] for row in lost} == {"unlocalised"}
