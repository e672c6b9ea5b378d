"""Axis and unit of a mesh: told, and refused where the photographs fit another reading."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from facadelake.building.mesh.files import MeshAxes
from facadelake.building.mesh.load import (
    MeshModelSettings,
    load_mesh_building,
    place_building_without_model,
)
from facadelake.building.mesh.other_readings import check_mesh_against_photographs
from facadelake.building.model_georeference.map_placement import MapPlacement, geo_from_map
from facadelake.core.errors import GeoreferenceError, ModelError
from facadelake.core.geodesy import SiteOrigin

SETTINGS = MeshModelSettings(
    map_crs="EPSG:25832",
    vertical_datum="ellipsoidal",
    placement=MapPlacement(east_m=456639.0, north_m=5421033.0, height_m=178.0),
)
HALL = np.array([30.0, 12.0, 9.0])  # m, its south-west corner at the placement
FACES = "f 2 4 1\nf 5 2 1\nf 1 4 3\nf 3 5 1\nf 2 8 4\nf 6 2 5\nf 6 8 2\nf 4 8 3\nf 7 5 3\nf 3 8 7\nf 7 6 5\nf 8 6 7\n"


def write_hall(path: Path, *, axes: MeshAxes = MeshAxes.Z_UP, unit_m: float = 1.0, offset=(0.0, 0.0, 0.0)) -> Path:
    """A closed box of the hall's size, in the axes and unit of the file."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * HALL + offset
    if axes is MeshAxes.Y_UP:
        corners = corners[:, [0, 2, 1]] * [1, 1, -1]
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in corners / unit_m]
    path.write_text("\n".join(lines) + "\n" + FACES)
    return path


def flight(*, datum: str = "ellipsoidal", with_attitude: bool = True, height_error_m: float = 0.0) -> pa.Table:
    """Photographs 10 m from the four walls, at three heights, each towards its wall; GPS is 2 m off."""
    east, north, up, yaw = [], [], [], []
    for height in (2.0, 5.0, 8.0):
        for share in np.linspace(0, 1, 6):
            east += [share * 30, share * 30, -10.0, 40.0]
            north += [-10.0, 22.0, share * 12, share * 12]
            up += [height] * 4
            yaw += [0.0, 180.0, 90.0, 270.0]
    noise = np.random.default_rng(3).normal(0, 1.5, (len(east), 3))
    map_m = np.column_stack([east, north, up]) + noise + [456639.0, 5421033.0, 178.0 + height_error_m]
    geo = geo_from_map(map_m, "EPSG:25832", "ellipsoidal")
    unknown = np.full(len(geo), np.nan)
    return pa.table(
        {
            "prior_lon_deg": geo[:, 0], "prior_lat_deg": geo[:, 1], "prior_height_m": geo[:, 2],
            "prior_sigma_horizontal_m": np.full(len(geo), 2.0),
            "prior_yaw_deg": np.array(yaw) if with_attitude else unknown,
            "prior_pitch_deg": np.zeros(len(geo)) if with_attitude else unknown,
            "prior_height_datum": [datum] * len(geo),
        }
    )  # fmt: skip


def test_axis_unit_and_size_are_always_told(tmp_path: Path) -> None:
    path = write_hall(tmp_path / "hall.obj")
    assert (
        "the mesh was read with z up (crs.axes is not set) and metre as its unit (crs.unit is not set): it is 30.0 x "
        "12.0 m in plan and 9.0 m high"
    ) in load_mesh_building(path, settings=SETTINGS).remarks
    stated = replace(SETTINGS, axes=MeshAxes.Z_UP, unit="metre")
    assert "z up (by crs.axes) and metre as its unit (by crs.unit)" in load_mesh_building(path, settings=stated).remarks


@pytest.mark.parametrize("datum", ["ellipsoidal", "unknown"])
@pytest.mark.parametrize("with_attitude", [True, False])
def test_the_right_reading_is_accepted(tmp_path: Path, datum: str, with_attitude: bool) -> None:
    path = write_hall(tmp_path / "hall.obj")
    photos = flight(datum=datum, with_attitude=with_attitude, height_error_m=48.0 if datum == "unknown" else 0.0)
    check_mesh_against_photographs(path, photos, settings=SETTINGS)


def test_y_up_read_as_z_up_is_refused(tmp_path: Path) -> None:
    path = write_hall(tmp_path / "hall.obj", axes=MeshAxes.Y_UP)
    with pytest.raises(GeoreferenceError) as caught:
        check_mesh_against_photographs(path, flight(), settings=SETTINGS)
    said = str(caught.value)
    assert said.startswith("read with crs.axes: z-up, crs.unit: metre, the mesh is 30.0 x 9.0 x 12.0 m, and ")
    assert "read with crs.axes: y-up, crs.unit: metre, it is 30.0 x 12.0 x 9.0 m, and " in said
    check_mesh_against_photographs(path, flight(), settings=replace(SETTINGS, axes=MeshAxes.Y_UP))


@pytest.mark.parametrize("datum", ["ellipsoidal", "unknown"])
@pytest.mark.parametrize(("unit", "unit_m"), [("foot", 0.3048), ("centimetre", 0.01), ("inch", 0.0254)])
def test_another_unit_read_as_metres_is_refused(tmp_path: Path, unit: str, unit_m: float, datum: str) -> None:
    path = write_hall(tmp_path / "hall.obj", unit_m=unit_m)
    with pytest.raises((GeoreferenceError, ModelError), match=r"crs\.unit") as caught:
        check_mesh_against_photographs(path, flight(datum=datum), settings=SETTINGS)
    assert f"crs.axes: z-up, crs.unit: {unit}, it is 30.0 x 12.0 x 9.0 m" in str(caught.value) or (
        f"9.0 m in {unit}" in str(caught.value)
    )
    check_mesh_against_photographs(path, flight(datum=datum), settings=replace(SETTINGS, unit=unit))


def test_map_coordinates_in_other_axes_or_units_are_named(tmp_path: Path) -> None:
    there = (456639.0, 5421033.0, 178.0)
    on_map = replace(SETTINGS, placement=None)
    y_up = write_hall(tmp_path / "a.obj", axes=MeshAxes.Y_UP, offset=there)
    with pytest.raises(GeoreferenceError, match=r"read with crs\.axes: y-up, crs\.unit: metre, it would lie in it"):
        load_mesh_building(y_up, settings=on_map)
    feet = write_hall(tmp_path / "b.obj", unit_m=0.3048, offset=there)
    with pytest.raises(GeoreferenceError, match=r"read with crs\.axes: z-up, crs\.unit: foot, it would lie in it"):
        load_mesh_building(feet, settings=on_map)


def test_the_other_foot_is_asked_for(tmp_path: Path) -> None:
    us_foot_m = 1200 / 3937
    path = write_hall(tmp_path / "a.obj", unit_m=us_foot_m, offset=(987650 * us_foot_m, 213000 * us_foot_m, 10.0))
    settings = MeshModelSettings(map_crs="EPSG:6539", vertical_datum="ellipsoidal", unit="foot")
    with pytest.raises(
        GeoreferenceError, match=r"US survey foot, and the two are 0\.60 m apart here \(limit 0\.05 m\)"
    ):
        load_mesh_building(path, settings=settings)
    building = load_mesh_building(path, settings=replace(settings, unit="us_survey_foot"))
    corner = building.map_from_site(building.vertices_site_m).min(axis=0)
    np.testing.assert_allclose(corner[:2], np.array([987650, 213000]) * us_foot_m, rtol=0, atol=0.002)  # m


def test_a_height_and_an_origin_that_cannot_be(tmp_path: Path) -> None:
    path = write_hall(tmp_path / "hall.obj")
    high = replace(SETTINGS, placement=MapPlacement(east_m=456639.0, north_m=5421033.0, height_m=178_000.0))
    with pytest.raises(GeoreferenceError, match="where no building stands"):
        load_mesh_building(path, settings=high)
    exchanged = SiteOrigin(lon_deg=48.94, lat_deg=8.41, height_ellipsoidal_m=180.0)
    with pytest.raises(GeoreferenceError, match="latitude and longitude are exchanged"):
        load_mesh_building(path, settings=replace(SETTINGS, origin=exchanged))


def test_photographs_outside_the_area_of_use_of_the_portfolios_crs() -> None:
    settings = MeshModelSettings(map_crs="EPSG:2056", vertical_datum="ellipsoidal")
    with pytest.raises(GeoreferenceError, match=r"median GPS position, lon 13\.4000, lat 52\.5000, lies outside"):
        place_building_without_model(np.array([[13.4, 52.5]] * 3), settings=settings)
