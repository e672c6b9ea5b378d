"""Registry entries of buildings without BIM, and the checks of the flow before the first stage."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from facadelake.building.model import read_building
from facadelake.building.registry_settings import mesh_settings_from_registry, read_registered_model
from facadelake.campaigns.preflight import AUTO, check_control, check_files
from facadelake.core.errors import InputDataError
from facadelake.registry import Building, read_portfolio
from schemas.vocabulary import SurfaceKind
from tasks.job import InspectionJob
from tasks.load_model import load_model

MESH = {"map": "EPSG:25832", "vertical": "ellipsoidal"}


def registered(folder: Path, **changes: Any) -> Building:
    """The portfolio's building ``hall`` with changed keys."""
    entry = {
        "id": "hall",
        "name": "Town hall",
        "model": "mesh/hall.obj",
        "photographs": "photos/{campaign}/images",
        "crs": MESH,
        "detector": {"kind": "coco", "file": "photos/{campaign}/boxes.json"},
        **changes,
    }
    path = folder / "portfolio.yaml"
    path.write_text(yaml.safe_dump({"buildings": [entry]}))
    return read_portfolio(path).get_building("hall")


@pytest.mark.parametrize(
    ("model", "kind"),
    [
        ("hall.ifc", SurfaceKind.IFC), ("hall.OBJ", SurfaceKind.MESH), ("hall.glb", SurfaceKind.MESH),
        ("hall.ply", SurfaceKind.MESH), ("as-built", SurfaceKind.AS_BUILT), ("as-built.ifc", SurfaceKind.IFC),
    ],
)  # fmt: skip
def test_the_kind_of_the_model_follows_from_keyword_or_suffix(tmp_path: Path, model: str, kind: SurfaceKind) -> None:
    assert registered(tmp_path, model=model).surface_kind is kind


def test_what_a_mesh_is_told_reaches_geobim_and_paths_count_from_the_registry(tmp_path: Path) -> None:
    (tmp_path / "mesh").mkdir()
    (tmp_path / "mesh" / "coords.txt").write_text("WGS84 UTM 32N\n456600 5421000\n")
    crs = {**MESH, "offset_file": "mesh/coords.txt", "unit": "foot", "axes": "y-up"}
    building = registered(tmp_path, crs=crs, storeys=[{"name": "Ground floor", "floor_m": 178.5}])
    settings = mesh_settings_from_registry(building)
    assert settings.offset_file == tmp_path / "mesh" / "coords.txt"
    assert (settings.unit, settings.axes, settings.map_crs) == ("foot", "y-up", "EPSG:25832")
    assert [(storey.name, storey.floor_m) for storey in settings.storeys] == [("Ground floor", 178.5)]
    (tmp_path / "mesh" / "hall.obj").write_text("v 0 0 0\nv 30 0 0\nv 30 30 0\nf 1 2 3\n")
    model = read_registered_model(building)
    assert model.surface_kind is SurfaceKind.MESH
    # One triangle of 30 by 30 feet that glTF's axes lay into the plane facing south, at the offset on the map.
    assert abs(model.elements.column("surface_area_m2")[0].as_py() - (30 * 0.3048) ** 2 / 2) < 0.1  # m2
    east, north, _ = model.map_from_site(model.vertices_site_m).min(axis=0)
    assert abs(east - 456600) < 0.001 and abs(north - 5421000) < 0.001  # m


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"model": "hall.ifc", "crs": {"axes": "y-up"}},
            "'axes' applies to buildings whose model is a mesh; the model of this one is an IFC",
        ),
        (
            {"model_building": "East"},
            "'model_building' applies to buildings whose model is an IFC; the model of this one is a mesh",
        ),
        ({"crs": {**MESH, "accept_level": 20}}, "'accept_level' applies to buildings whose model is an IFC"),
        ({"model": "as-built", "crs": {"map": "EPSG:25832"}}, "'vertical' is missing in 'crs'"),
        ({"model": "as-built", "crs": {**MESH, "offset_file": "x.txt"}}, "'offset_file' applies to .* a mesh"),
        (
            {"crs": {**MESH, "offset_file": "x", "placement": {"east_m": 1, "north_m": 2, "height_m": 3}}},
            "both 'placement' and 'offset_file'",
        ),
        ({"crs": {**MESH, "unit": "yard"}}, "crs.unit.*'yard'"),
        ({"storeys": [{"name": "a"}]}, "storeys.0.floor_m.*missing"),
    ],
)
def test_keys_that_do_not_fit_the_model_are_mistakes(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputDataError, match=message):
        registered(tmp_path, **changes)


def test_a_building_without_a_model_needs_no_file_but_a_control_that_is_not_the_model(tmp_path: Path) -> None:
    photographs = tmp_path / "photos" / "2026-04" / "images"
    photographs.mkdir(parents=True)
    (photographs.parent / "boxes.json").write_text("{}")
    building = registered(tmp_path, model="as-built")
    assert check_files(building, "2026-04", None) == ()
    for control in (AUTO, "gcp", "gps", "campaign"):
        check_control(building, "2026-04", control, None)
    with pytest.raises(InputDataError, match=r"has no model \(model: as-built\).*--georeference model"):
        check_control(building, "2026-04", "model", None)
    (tmp_path / "poses.csv").write_text("photo_id\n")
    with pytest.raises(InputDataError, match="tie points, which imported poses do not have"):
        check_control(building, "2026-04", AUTO, str(tmp_path / "poses.csv"))
    check_control(registered(tmp_path), "2026-04", "model", None)  # a mesh can hold a campaign
    with pytest.raises(InputDataError, match=r"the model .*hall\.obj of building 'hall' does not exist"):
        check_files(registered(tmp_path), "2026-04", None)
    (tmp_path / "mesh").mkdir()
    (tmp_path / "mesh" / "hall.obj").write_text("")
    with pytest.raises(InputDataError, match=r"the offset file .*coords\.txt of building 'hall' does not exist"):
        check_files(registered(tmp_path, crs={**MESH, "offset_file": "mesh/coords.txt"}), "2026-04", None)


def test_coordinates_beside_a_gltf_are_part_of_its_cache_key(tmp_path: Path) -> None:
    """A glTF in text names its buffers: the same text with moved coordinates is another model."""

    def export(height_m: float) -> None:
        (tmp_path / "mesh").mkdir(exist_ok=True)
        box = trimesh.creation.box((12.0, height_m, 8.0))
        for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(box)).items():
            if name != "model.gltf":
                (tmp_path / "mesh" / name).write_bytes(content)
            elif not (tmp_path / "mesh" / "hall.gltf").exists():
                (tmp_path / "mesh" / "hall.gltf").write_bytes(content)

    place = {"placement": {"east_m": 456600.0, "north_m": 5421000.0, "height_m": 180.0}}
    export(6.0)
    job = InspectionJob(
        building=registered(tmp_path, model="mesh/hall.gltf", crs={**MESH, **place}),
        campaign_id="2026-04",
        run_id="run",
        started_at=datetime(2026, 4, 1, tzinfo=UTC),
        code_sha256="c",
        lake=tmp_path / "lake",
    )
    first = load_model.fn(job)
    assert load_model.fn(job).hit
    export(9.0)
    again = load_model.fn(job)
    assert not again.hit
    heights = [float(np.ptp(read_building(stage.folder).vertices_site_m[:, 2])) for stage in (first, again)]
    assert heights == pytest.approx([6.0, 9.0], rel=0, abs=0.01)  # m
