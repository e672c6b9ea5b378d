"""The stage that lets a model look: where poses and masks say the building is, and anew when they change."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.pose_table import columns_from_camera
from facadelake.core.tables import read_table, table_from_rows, write_table
from facadelake.registration.target_view import WITHOUT_POSE
from facadelake.registry import Building
from tasks.detect import detect
from tasks.job import InspectionJob, StageResult
from tests.synthetic.registration_scene import Wall, build_walls
from tests.unit.detection.onnx_models import HEIGHT, WIDTH, make_card, make_output, save_model

# From 10 m before the right end of a wall 20 m wide: it fills the left half, 12.5 mm a pixel, and sky the right one.
CAMERA = Camera(width_px=800, height_px=600, fx_px=800, fy_px=800, cx_px=400, cy_px=300)
POSED = PosedCamera(
    camera=CAMERA,
    site_from_cam=Similarity(
        rotation=np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), translation=np.array([10.0, -10.0, 4.5])
    ),
)
EDGE_PX = 400
MARGIN_PX = 18  # by which a building may stand beside its model
TILE = (2 * WIDTH, 2 * HEIGHT)  # of a model that wants 25 mm a pixel


def stage(folder: Path, name: str) -> StageResult:
    """An earlier stage's result, made by the test."""
    (folder / name).mkdir()
    return StageResult(stage=name, key=name, content_sha256=name, folder=folder / name, hit=True, seconds=0, peak_mib=0)


@pytest.fixture
def job(tmp_path: Path) -> InspectionJob:
    """Four photographs and a model that sees a crack in the middle of whatever it looks at."""
    save_model(tmp_path / "all.onnx", make_output("yolov8", [(40, WIDTH / 2, HEIGHT / 2, 10.0, 8.0, 0.75, 0)]))
    content = make_card("yolov8", name="all")
    content["input"]["gsd_mm"] = [25.0]
    (tmp_path / "all.card.yaml").write_text(yaml.safe_dump(content))
    images = tmp_path / "images"
    images.mkdir()
    for name in ("wall.png", "masked.png", "lost.png", "torn.png"):
        cv2.imwrite(str(images / name), np.zeros((600, 800, 3), dtype=np.uint8))
    (images / "torn.png").write_bytes((images / "torn.png").read_bytes()[:40])
    mask = np.full((600, 800), 255, dtype=np.uint8)
    mask[:300] = 0
    cv2.imwrite(str(images / "masked_mask.png"), mask)
    building = Building.model_validate(
        {
            "id": "barn", "name": "Barn", "model": "barn.ifc", "photographs": str(images), "campaigns": ["2026-04"],
            "detector": {"kind": "onnx", "model": str(tmp_path / "all.onnx"), "threads": 2},
        }
    )  # fmt: skip
    return InspectionJob(
        building=building,
        campaign_id="2026-04",
        run_id="r",
        started_at=datetime.now(UTC),
        code_sha256="c",
        lake=tmp_path / "lake",
    )


def test_a_model_looks_where_the_building_is(
    job: InspectionJob, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    model, photos, placed = (stage(tmp_path, name) for name in ("model", "photos", "placed"))
    build_walls([Wall()]).save(model.folder)
    names = ("lost.png", "masked.png", "torn.png", "wall.png")
    said = {"bytes": 1, "photo_outcome": "accepted", "prior_source": "none", "prior_height_datum": "unknown"}
    write_table(
        "photos", table_from_rows("photos", [{"photo_id": n, "sha256": n, **said} for n in names]), photos.folder
    )
    pose = {
        "pose_source": "sfm",
        "image_width_px": 800,
        "image_height_px": 600,
        "tie_points": 9,
        **columns_from_camera(POSED),
    }
    known = [name for name in names if name != "lost.png"]
    write_table("poses", table_from_rows("poses", [{"photo_id": n, **pose} for n in known]), placed.folder)

    made = detect.fn(job, model, photos, placed)
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in read_table("detections", made.folder).to_pylist():
        rows.setdefault(row["photo_id"], []).append(row)
    middles = {
        name: np.array([(r["box_x_px"] + r["box_width_px"] / 2, r["box_y_px"] + r["box_height_px"] / 2) for r in some])
        for name, some in rows.items()
    }
    # The wall and nothing but the wall: tiles of 192 x 128 px that share a fifth, over 416 x 600 px and 416 x 300 px.
    assert len(rows["wall.png"]) == 3 * 6
    assert len(rows["masked.png"]) == 3 * 3
    for name in ("wall.png", "masked.png"):
        reach = middles[name][:, 0] + TILE[0] / 2
        assert EDGE_PX < reach.max() < EDGE_PX + MARGIN_PX  # px
        assert {row["reason"] for row in rows[name]} == {None}
    assert abs((middles["masked.png"][:, 1] - TILE[1] / 2).min() - 300) < 3  # px
    # Where nobody knows, it looks everywhere, at the photograph's own pixels.
    assert len(rows["lost.png"]) > 120
    assert {row["reason"] for row in rows["lost.png"]} == {WITHOUT_POSE}
    assert "torn.png" not in rows and "torn.png cannot be read" in caplog.text

    assert detect.fn(job, model, photos, placed).hit
    assert not detect.fn(job, model, photos, replace(placed, content_sha256="placed anew")).hit
    stricter = job.building.detector.model_copy(update={"score_threshold": 0.8})
    strict = replace(job, building=job.building.model_copy(update={"detector": stricter}))
    assert len(read_table("detections", detect.fn(strict, model, photos, placed).folder)) == 0
