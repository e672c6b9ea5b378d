"""The stages of a building without a model on a given small block: place, surface, and what is not compared."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from facadelake.building.model import read_building
from facadelake.core.cache import DIAGNOSTICS
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Similarity
from facadelake.core.pose_table import columns_from_camera
from facadelake.core.tables import read_table, table_from_rows, write_table
from facadelake.registry import Building
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob, StageResult
from tasks.verify_model import verify_model
from tasks.without_model import make_as_built_model, place_building

CAMERA = Camera(width_px=1600, height_px=1200, fx_px=1000, fy_px=1000, cx_px=800, cy_px=600)
PLACE = (8.4082, 48.9403)


@pytest.fixture
def job(tmp_path: Path) -> InspectionJob:
    building = Building.model_validate(
        {
            "id": "barn", "name": "Barn", "model": "as-built", "photographs": str(tmp_path / "{campaign}"),
            "crs": {"vertical": "ellipsoidal"},
            "storeys": [{"name": "Loft", "floor_m": 3}, {"name": "Stable", "floor_m": 0}],
            "detector": {"kind": "coco", "file": "boxes.json"},
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


def given(folder: Path, stage: str) -> StageResult:
    """An earlier stage's result, made by the test."""
    (folder / stage).mkdir()
    return StageResult(
        stage=stage, key=stage, content_sha256=stage, folder=folder / stage, hit=True, seconds=0, peak_mib=0
    )


def cameras() -> dict[str, PosedCamera]:
    """Five upright cameras south of the wall that look north."""
    rotation = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: right is east, down, forward is north
    return {
        f"{k}.jpg": PosedCamera(
            camera=CAMERA,
            site_from_cam=Similarity(rotation=rotation, translation=np.array([3.0 * k - 6, -12 - k % 2, 2.0 + k % 3])),
        )
        for k in range(5)
    }


def save_block(folder: Path, posed: dict[str, PosedCamera]) -> None:
    """A reconstruction of a wall of 16 by 6 m in the plane y = 0, in a free frame of half the size."""
    rng = np.random.default_rng(6)
    xyz = np.column_stack([rng.uniform(-8, 8, 600), np.zeros(600), rng.uniform(0, 6, 600)])
    photo, point, pixel = [], [], []
    for k, camera in enumerate(posed.values()):
        xy = camera.project_site(xyz)
        seen = np.flatnonzero(CAMERA.is_inside(xy))
        photo.append(np.full(len(seen), k))
        point.append(seen)
        pixel.append(xy[seen] + rng.normal(0, 0.4, (len(seen), 2)))
    np.savez(
        folder / "reconstruction.npz",
        camera=np.tile([CAMERA.width_px, CAMERA.height_px, 1000.0, 1000, 800, 600, 0, 0, 0, 0], (5, 1)),
        sfm_from_cam_rotation=np.array([camera.site_from_cam.rotation for camera in posed.values()]),
        sfm_from_cam_translation=np.array([camera.centre_site_m / 2 for camera in posed.values()]),
        xyz_sfm=xyz / 2,
        rgb=np.zeros((600, 3), np.uint8),
        image_point_photo=np.concatenate(photo),
        image_point_tie_point=np.concatenate(point),
        image_point_xy_img=np.vstack(pixel),
    )
    photos = [{"photo_id": name, "reprojection_error_px": 0.5, "tie_points": 600} for name in posed]
    said = {"photos": photos, "unlocalised": [], "mean_reprojection_error_px": 0.5}
    (folder / DIAGNOSTICS).mkdir()
    (folder / DIAGNOSTICS / "costs.json").write_text("[]")
    (folder / "reconstruction.json").write_text(json.dumps(said))


def test_a_building_without_model_gets_its_place_then_its_surface_and_is_compared_with_nothing(
    job: InspectionJob, tmp_path: Path
) -> None:
    photos, block, placed = (given(tmp_path, stage) for stage in ("photos", "block", "placed"))
    posed = cameras()
    rows = [
        {"photo_id": name, "sha256": "0", "bytes": 1, "photo_outcome": "accepted", "prior_source": "exif",
         "prior_height_datum": "unknown", "prior_lon_deg": PLACE[0], "prior_lat_deg": PLACE[1]}
        for name in posed
    ]  # fmt: skip
    write_table("photos", table_from_rows("photos", rows), photos.folder)
    save_block(block.folder, posed)
    poses = [
        {"photo_id": name, "pose_source": "sfm", "image_width_px": 1600, "image_height_px": 1200, "tie_points": 600}
        | columns_from_camera(camera)
        for name, camera in posed.items()
    ]
    write_table("poses", table_from_rows("poses", poses), placed.folder)

    place = place_building.fn(job, photos)
    before = read_building(place.folder)
    assert (before.surface_kind, before.has_surface, before.map_crs) == (SurfaceKind.AS_BUILT, False, "EPSG:32632")
    assert (before.origin.lon_deg, before.origin.lat_deg) == (8.408, 48.94)

    model = make_as_built_model.fn(job, place, block, placed)
    after = read_building(model.folder)
    wall = next(row for row in after.elements.to_pylist() if row["element_guid"] == "facade-S-1")
    assert 70 < wall["surface_area_m2"] < 110  # m2, of 96 that no tie point borders exactly
    assert wall["storey"] == "Stable" and [storey.name for storey in after.storeys] == ["Stable", "Loft"]
    assert abs(np.median(after.vertices_site_m[:, 1])) < 0.005  # m: from the poses, not from the free block
    assert make_as_built_model.fn(job, place, block, placed).hit

    compared = read_table("integrity_views", verify_model.fn(job, model, block, placed).folder).to_pylist()
    assert {row["integrity_outcome"] for row in compared} == {"no_model"}
    assert all("no model" in row["reason"] for row in compared) and len(compared) == len(posed)
