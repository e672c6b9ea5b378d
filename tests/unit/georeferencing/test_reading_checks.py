"""How a mesh was read, compared with the block: another unit or axis is refused, the right reading never."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from facadelake.building import SurfaceReading
from facadelake.building.mesh.files import MeshAxes
from facadelake.building.mesh.load import MeshModelSettings, load_mesh_building
from facadelake.building.mesh.other_readings import list_surface_readings
from facadelake.building.model_georeference.map_placement import geo_from_map
from facadelake.building.surface import Surface
from facadelake.georeferencing.model.control import ModelControl
from facadelake.georeferencing.placement_checks import PlacementCheck
from facadelake.georeferencing.reading_checks import MeshReadingError, compare_readings
from schemas.vocabulary import ControlKind, PlacementCheckOutcome, PlacementStatement
from tests.synthetic.test_georeference import Scene, build_model, build_ring
from tests.unit.building.test_mesh_readings import HALL, SETTINGS, write_hall

AGREES, DISAGREES = PlacementCheckOutcome.AGREES, PlacementCheckOutcome.DISAGREES
UNDECIDED = PlacementCheckOutcome.NOT_COMPARABLE
# Of each facade of the hall: axis across it, its position on that axis, the outward direction.
FACADES = {"south": (1, 0.0, -1), "north": (1, 12.0, 1), "west": (0, 0.0, -1), "east": (0, 30.0, 1)}
TAKEN = "read with crs.axes: z-up, crs.unit: metre, the mesh is "


def compare(
    path: Path, *facades: str, settings: MeshModelSettings = SETTINGS, moved_m: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> PlacementCheck:
    """Compare points on facades of the hall, each seen from 20 m, displaced by ``moved_m``, with the mesh."""
    rng = np.random.default_rng(4)
    points, eyes = [], []
    for facade in facades or FACADES:
        axis, at, outward = FACADES[facade]
        xyz = rng.uniform(0, 1, (150, 3)) * HALL
        xyz[:, axis] = at + rng.normal(0, 0.02, 150)
        eye = xyz + rng.normal(0, 2.0, (150, 3))
        eye[:, axis] = at + outward * 20.0
        points.append(xyz)
        eyes.append(eye)
    building = load_mesh_building(path, settings=settings)
    corner = np.array([456639.0, 5421033.0, 178.0])
    xyz, eye = (
        building.origin.site_from_geo(geo_from_map(corner + np.vstack(rows), "EPSG:25832", "ellipsoidal")) + moved_m
        for rows in (points, eyes)
    )
    return compare_readings(xyz, eye, list_surface_readings(path, building.origin, settings=settings))


@pytest.mark.parametrize("moved_m", [(0.0, 0.0, 0.0), (3.0, -2.0, 5.0)], ids=["placed exactly", "placed by GPS"])
def test_the_right_reading_agrees(tmp_path: Path, moved_m: tuple[float, ...]) -> None:
    check = compare(write_hall(tmp_path / "hall.obj"), moved_m=moved_m)
    assert (check.statement, check.outcome) == (PlacementStatement.MESH_READING, AGREES)
    assert check.detail.startswith(TAKEN + "30.0 x 12.0 x 9.0 m, and ")


def test_feet_read_as_metres_are_contradicted(tmp_path: Path) -> None:
    path = write_hall(tmp_path / "hall.obj", unit_m=0.3048)
    check = compare(path)
    assert check.outcome is DISAGREES
    assert check.detail.startswith(TAKEN + "98.4 x 39.4 x 29.5 m, and ")
    assert "read with crs.axes: z-up, crs.unit: foot, the mesh is 30.0 x 12.0 x 9.0 m, and " in check.detail
    assert check.detail.endswith("limit 3): set crs.axes and crs.unit in the portfolio")
    assert compare(path, settings=replace(SETTINGS, unit="foot")).outcome is AGREES


def test_y_up_read_as_z_up_is_contradicted(tmp_path: Path) -> None:
    path = write_hall(tmp_path / "hall.obj", axes=MeshAxes.Y_UP)
    check = compare(path)
    assert check.outcome is DISAGREES
    assert check.detail.startswith(TAKEN + "30.0 x 9.0 x 12.0 m, and ")
    assert "read with crs.axes: y-up, crs.unit: metre, the mesh is 30.0 x 12.0 x 9.0 m, and " in check.detail
    assert compare(path, settings=replace(SETTINGS, axes=MeshAxes.Y_UP)).outcome is AGREES


def test_one_facade_on_the_same_plane_in_both_units_is_undecided(tmp_path: Path) -> None:
    check = compare(write_hall(tmp_path / "hall.obj", unit_m=0.3048), "south")
    assert check.outcome is UNDECIDED
    assert check.detail.endswith(": the tie points do not decide; set crs.axes and crs.unit in the portfolio")


def test_nothing_is_compared_where_the_portfolio_states_axis_and_unit(tmp_path: Path) -> None:
    path = write_hall(tmp_path / "hall.obj")
    settings = replace(SETTINGS, axes=MeshAxes.Z_UP, unit="metre")
    assert list_surface_readings(path, load_mesh_building(path, settings=settings).origin, settings=settings) == ()


SCENE = Scene(build_ring())


def build_box(unit_m: float, keys: str) -> SurfaceReading:
    """The scene's building, in a file of another unit, read as metres."""
    box = trimesh.creation.box(bounds=np.array([[-10, -6, 0], [10, 6, 14]]) / unit_m)
    surface = Surface.from_mesh(np.asarray(box.vertices, dtype=float), np.asarray(box.faces, dtype=np.int64))
    return SurfaceReading(keys=keys, size_m=np.array([20.0, 12.0, 14.0]) / unit_m, surface=surface)


@pytest.mark.parametrize("kind", [ControlKind.GCP, ControlKind.MODEL, ControlKind.GPS, None])
def test_a_mesh_in_feet_read_as_metres_refuses_the_campaign(kind: ControlKind | None) -> None:
    as_metres, as_feet = build_box(0.3048, "crs.unit: metre"), build_box(1.0, "crs.unit: foot")
    model = ModelControl(
        surface=as_metres.surface,
        sigma_m=0.03,
        ground_site_m=0.0,
        highest_site_m=14 / 0.3048,
        readings=(as_metres, as_feet),
    )
    with pytest.raises(MeshReadingError) as caught:
        SCENE.georeference(kind, control_points=SCENE.build_control(), model=model)
    said = str(caught.value)
    assert said.startswith("read with crs.unit: metre, the mesh is 65.6 x 39.4 x 45.9 m, and ")
    assert "; read with crs.unit: foot, the mesh is 20.0 x 12.0 x 14.0 m, and " in said
    assert said.count("read with crs.unit: foot") == 1


@pytest.mark.parametrize("kind", [ControlKind.GCP, ControlKind.GPS])
def test_the_right_reading_of_a_campaign_is_recorded(kind: ControlKind) -> None:
    readings = (build_box(1.0, "crs.unit: metre"), build_box(1 / 0.3048, "crs.unit: foot"))
    model = replace(build_model(), surface=readings[0].surface, readings=readings)
    found = SCENE.georeference(kind, control_points=SCENE.build_control(), model=model)
    assert [check.outcome for check in found.placement_checks if check.statement == "mesh_reading"] == [AGREES]
