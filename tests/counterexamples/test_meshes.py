"""Mesh files and offset files that are not usable as a building: the whole message of each."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from facadelake.building.mesh.files import MeshAxes
from facadelake.building.mesh.load import (
    MeshModelSettings,
    load_mesh_building,
    place_building_without_model,
)
from facadelake.building.mesh.other_readings import check_mesh_against_photographs
from facadelake.core.errors import FacadelakeError, GeoreferenceError, ModelError
from tests.unit.building.test_mesh_readings import SETTINGS as PLACED
from tests.unit.building.test_mesh_readings import flight, write_hall

SETTINGS = MeshModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal")
WALL = "v 0 0 0\nv 9 0 0\nv 9 0 9\nf 1 2 3\n"


def refused(kind: type[FacadelakeError], path: Path, settings: MeshModelSettings = SETTINGS) -> str:
    with pytest.raises(kind) as caught:
        load_mesh_building(path, settings=settings)
    return str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "v 0 0 0\nv 1 0 0\nv 0 9 0\n",
            "hall.obj has no triangles (a point cloud?); export a mesh with faces",
        ),
        (
            "v 0 0 0\nv nan 0 0\nv 0 9 0\nf 1 2 3\n",
            "hall.obj: 1 of 3 vertices are not finite (NaN or infinite); repair the mesh, or export it again",
        ),
        (
            "v 0 0 0\nv 20000 0 0\nv 0 0 9000\nf 1 2 3\n",
            "hall.obj is 20,000 m across with a unit of 1.0 m (a building has 1 to 5,000 m); set crs.unit in the "
            "portfolio (metre, centimetre, millimetre, inch, foot, us_survey_foot), or crop the mesh to the building",
        ),
        (
            WALL,
            "the centre of hall.obj is at east, north, height [4.5, 0.0, 4.5] m, outside the area of use of EPSG:25832 "
            "(Europe between 6°E and 12°E); check crs.map in the portfolio. If a photogrammetry program exported the "
            "mesh with coordinates near zero, set crs.offset_file to the offset file that it wrote, or set "
            "crs.placement",
        ),
    ],
    ids=["points alone", "NaN", "millimetres", "no offset"],
)
def test_a_mesh_that_is_not_a_building(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "hall.obj"
    path.write_text(content)
    assert refused(FacadelakeError, path) == message


def test_map_coordinates_in_32_bits(tmp_path: Path) -> None:
    path = tmp_path / "hall.stl"
    wall = np.array([[456600, 5421000, 170], [456620, 5421000, 170], [456620, 5421000, 180]], dtype="<f4")
    path.write_bytes(bytes(80) + struct.pack("<I", 1) + bytes(12) + wall.tobytes() + bytes(2))
    assert refused(ModelError, path) == (
        "hall.stl stores its coordinates as 32-bit numbers, whose spacing at 5,421,000 m is 500 mm (limit 1 mm), so "
        "the mesh's detail is lost; export it with an offset (coordinates near zero) and set crs.offset_file or "
        "crs.placement in the portfolio, or export OBJ or double-precision PLY with all digits"
    )


def test_an_offset_file_without_an_offset(tmp_path: Path) -> None:
    path, offset = tmp_path / "hall.obj", tmp_path / "coords.txt"
    path.write_text(WALL)
    offset.write_text("WGS84 UTM 32N\n")
    settings = MeshModelSettings(vertical_datum="ellipsoidal", offset_file=offset)
    assert refused(GeoreferenceError, path, settings) == (
        "coords.txt has no offset; expected is a line with east and north (and height), such as '432000 5422000', "
        "after at most one line with the CRS; set crs.placement (east_m, north_m, height_m) in the portfolio instead"
    )


def test_neither_model_nor_gps() -> None:
    with pytest.raises(GeoreferenceError) as caught:
        place_building_without_model(np.full((3, 2), np.nan), settings=MeshModelSettings(vertical_datum="ellipsoidal"))
    assert str(caught.value) == (
        "none of the 3 photographs has a GPS position and there is no model, so the building's position is unknown; "
        "set crs.origin (lon_deg, lat_deg, height_ellipsoidal_m) in the portfolio"
    )


def test_axis_and_unit_are_told_and_the_photographs_may_contradict_them(tmp_path: Path) -> None:
    said = load_mesh_building(write_hall(tmp_path / "hall.obj"), settings=PLACED).remarks
    assert said.endswith(
        "the mesh was read with z up (crs.axes is not set) and metre as its unit (crs.unit is not set): it is 30.0 x "
        "12.0 m in plan and 9.0 m high"
    )
    with pytest.raises(GeoreferenceError) as caught:
        check_mesh_against_photographs(write_hall(tmp_path / "hall.obj", axes=MeshAxes.Y_UP), flight(), settings=PLACED)
    parts = (
        "read with crs.axes: z-up, crs.unit: metre, the mesh is 30.0 x 9.0 x 12.0 m, and ",
        " photographs stand outside it and look at it by their own metadata; read with crs.axes: y-up, crs.unit: "
        "metre, it is 30.0 x 12.0 x 9.0 m, and ",
        " do (limit: 25% more): set crs.axes and crs.unit in the portfolio",
    )
    assert all(part in str(caught.value) for part in parts)


def test_a_mesh_that_is_very_high_in_metres(tmp_path: Path) -> None:
    assert refused(ModelError, write_hall(tmp_path / "hall.obj", unit_m=0.01), PLACED) == (
        "hall.obj is 900 m high in metres (limit 200 m where crs.unit is not set), 9.0 m in centimetre, 0.9 m in "
        "millimetre, 22.9 m in inch, 274.3 m in foot, 274.3 m in us_survey_foot; set crs.unit in the portfolio, also "
        "if it is metre"
    )


def test_map_coordinates_with_y_up(tmp_path: Path) -> None:
    path = write_hall(tmp_path / "hall.obj", axes=MeshAxes.Y_UP, offset=(456639.0, 5421033.0, 178.0))
    said = refused(GeoreferenceError, path)
    assert "(Europe between 6°E and 12°E); read with crs.axes: y-up, crs.unit: metre, it would lie in it; check" in said
