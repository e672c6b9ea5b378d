"""The stage that imports poses: its tables, its cache, and the stages after it that have no block."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from facadelake.building.model import BuildingModel
from facadelake.core.tables import read_table, table_from_rows, write_table
from facadelake.registry import read_portfolio
from tasks.import_poses import import_poses
from tasks.job import InspectionJob, StageResult
from tasks.merge import merge_duplicates
from tasks.register import register
from tasks.verify_model import verify_model
from tests.unit.georeferencing.imported_wall import NAMES, ORIGIN, build_photos, build_wall, write_geo_csv

REGISTRY = """
buildings:
  - {id: hall, name: Hall, model: hall.ifc, photographs: "{campaign}", detector: {kind: coco, file: boxes.json}}
"""


def make_stage(folder: Path, name: str) -> StageResult:
    folder.mkdir()
    return StageResult(stage=name, key=name, content_sha256=name, folder=folder, hit=False, seconds=0.0, peak_mib=0.0)


@pytest.fixture
def stages(tmp_path: Path) -> tuple[InspectionJob, StageResult, StageResult]:
    """A job whose poses are the wall's, with the wall as model and four photographs."""
    (tmp_path / "portfolio.yaml").write_text(REGISTRY)
    job = InspectionJob(
        building=read_portfolio(tmp_path / "portfolio.yaml").get_building("hall"),
        campaign_id="2026-04",
        run_id="run",
        started_at=datetime(2026, 4, 1, tzinfo=UTC),
        code_sha256="c",
        lake=tmp_path / "lake",
        poses=write_geo_csv(tmp_path / "poses"),
    )
    model, ingested = make_stage(tmp_path / "model", "model"), make_stage(tmp_path / "photos", "photos")
    surface = build_wall()
    element = {
        "element_guid": "wall", "ifc_class": "IfcWall", "facade": "S", "surface_area_m2": 160.0, "triangles": 2,
    }  # fmt: skip
    BuildingModel(
        origin=ORIGIN,
        map_crs="EPSG:25832",
        vertical_datum="ellipsoidal",
        georeference_level="50",
        remarks="",
        vertices_site_m=surface.vertices_site_m,
        triangles=surface.triangles,
        element_of_triangle=surface.triangles[:, 0] * 0,
        elements=table_from_rows("elements", [element]),
    ).save(model.folder)
    write_table("photos", build_photos(), ingested.folder)
    return job, model, ingested


def test_tables_cache_and_the_stages_after(stages: tuple[InspectionJob, StageResult, StageResult]) -> None:
    job, model, ingested = stages
    first = import_poses.fn(job, model, ingested)
    assert (first.hit, dict(first.counts)) == (False, {"localised": 4, "not localised": 0})
    assert read_table("georeference", first.folder).column("control").to_pylist() == ["imported"]
    assert import_poses.fn(job, model, ingested).hit
    assert job.poses is not None
    job.poses.write_text(job.poses.read_text().replace(NAMES[3], "another.JPG"))
    again = import_poses.fn(job, model, ingested)
    assert (again.hit, dict(again.counts)) == (False, {"localised": 3, "not localised": 1})
    views = read_table("integrity_views", verify_model.fn(job, model, None, again).folder).to_pylist()
    assert len(views) == 3 and all("poses were imported" in view["reason"] for view in views)


def test_masks_that_change_places_register_anew_and_nothing_detected_is_no_error(
    stages: tuple[InspectionJob, StageResult, StageResult], tmp_path: Path
) -> None:
    """Two masks of the same bytes, each of the other photograph: the same bytes in the same order of paths."""
    job, model, ingested = stages
    found = make_stage(tmp_path / "detections", "detections")
    write_table("detections", table_from_rows("detections", []), found.folder)
    folder = tmp_path / "2026-04"
    (folder / "masks").mkdir(parents=True)
    for name in ("a.jpg", "b.jpg", "a_mask.png", "masks/b.png"):
        (folder / name).write_bytes(b"black" if name == "a_mask.png" else b"white")
    placed = import_poses.fn(job, model, ingested)
    first = register.fn(job, model, placed, found, None)
    assert not first.hit and register.fn(job, model, placed, found, None).hit
    (folder / "a_mask.png").rename(folder / "b_mask.png")
    (folder / "masks" / "b.png").rename(folder / "masks" / "a.png")
    again = register.fn(job, model, placed, found, None)
    assert not again.hit
    merged = merge_duplicates.fn(job, model, ingested, placed, again, found)
    assert dict(merged.counts) == {"defects": 0, "decisions": 0}
