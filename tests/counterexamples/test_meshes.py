"""Mesh files and offsets that cannot be a building: the whole message of each."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from facadelake.building.mesh.load import MeshModelSettings, load_mesh_building, place_building_without_model
from facadelake.core.errors import FacadelakeError, GeoreferenceError, ModelError

SETTINGS = MeshModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal")
WALL = "v 0 0 0\nv 9 0 0\nv 9 0 9\nf 1 2 3\n"


def refused(kind: type[FacadelakeError], path: Path, settings: MeshModelSettings = SETTINGS) -> str:
    with pytest.raises(kind) as caught:
        load_mesh_building(path, settings=settings)
    return str(caught.value)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (
            "v 0 0 0\nv 1 0 0\nv 0 9 0\n",
            "hall.obj holds no triangles (a point cloud?); export a mesh with faces",
        ),
        (
            "v 0 0 0\nv nan 0 0\nv 0 9 0\nf 1 2 3\n",
            "hall.obj: 1 of 3 vertices are not numbers (NaN or infinite); repair the mesh, or export it anew",
        ),
        (
            "v 0 0 0\nv 20000 0 0\nv 0 0 9000\nf 1 2 3\n",
            "hall.obj is 20,000 m across (a building is 1 to 5,000 m) when its unit is taken as 1.0 m; give the "
            "registry's crs.unit (metre, millimetre, foot, us_survey_foot), or cut the mesh down to the building",
        ),
        (
            WALL,
            "the middle of hall.obj comes to lie at east, north, height [4.5, 0.0, 4.5] m, outside the area where "
            "EPSG:25832 is in use (Europe between 6°E and 12°E); is the CRS the right one? A mesh that photogrammetry "
            "exported stands near its own zero: give the offset file it came with (crs.offset_file), or crs.placement",
        ),
    ],
    ids=["points alone", "NaN", "millimetres", "no offset"],
)
def test_what_is_no_building(tmp_path: Path, content: str, told: str) -> None:
    path = tmp_path / "hall.obj"
    path.write_text(content)
    assert refused(FacadelakeError, path) == told


def test_map_coordinates_in_32_bits(tmp_path: Path) -> None:
    path = tmp_path / "hall.stl"
    wall = np.array([[456600, 5421000, 170], [456620, 5421000, 170], [456620, 5421000, 180]], dtype="<f4")
    path.write_bytes(bytes(80) + struct.pack("<I", 1) + bytes(12) + wall.tobytes() + bytes(2))
    assert refused(ModelError, path) == (
        "hall.stl keeps its coordinates as 32-bit numbers, which at 5,421,000 m come in steps of 500 mm (limit 1 mm): "
        "the mesh's detail is gone; export it with an offset (coordinates near zero) and give that as the registry's "
        "crs.offset_file or crs.placement, or as OBJ or double-precision PLY with all digits"
    )


def test_an_offset_file_without_an_offset(tmp_path: Path) -> None:
    path, offset = tmp_path / "hall.obj", tmp_path / "coords.txt"
    path.write_text(WALL)
    offset.write_text("WGS84 UTM 32N\n")
    settings = MeshModelSettings(vertical_datum="ellipsoidal", offset_file=offset)
    assert refused(GeoreferenceError, path, settings) == (
        "coords.txt says no offset: a line with east and north (and height) is wanted, such as '432000 5422000', "
        "below at most one line with the CRS; give the registry's crs.placement (east_m, north_m, height_m) instead"
    )


def test_neither_model_nor_gps() -> None:
    with pytest.raises(GeoreferenceError) as caught:
        place_building_without_model(np.full((3, 2), np.nan), settings=MeshModelSettings(vertical_datum="ellipsoidal"))
    assert str(caught.value) == (
        "none of the 3 photographs says where it was taken and there is no model, so the building has no place; give "
        "the registry's crs.origin (lon_deg, lat_deg, height_ellipsoidal_m)"
    )
