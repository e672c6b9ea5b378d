"""A box written as OBJ, PLY, STL and glTF is read back at its position by PROJ to the millimetre."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest

from facadelake.building.mesh.files import MeshAxes, read_mesh_file
from facadelake.building.mesh.load import MeshModelSettings, load_mesh_building, place_building_without_model
from facadelake.building.mesh.offset import read_mesh_offset
from facadelake.building.model import BuildingModel, read_building
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.building.storeys import StoreyElevation, find_storey
from facadelake.building.surface.raycasting import Surface
from facadelake.core.errors import GeoreferenceError, ModelError
from facadelake.core.geodesy import SiteOrigin
from schemas.vocabulary import SurfaceKind

# A corner of the box in EPSG:25832 with ellipsoidal height; the box is 20 m east, 10 m north, 8 m high.
CORNER = np.array([456_600.1234, 5_421_000.7654, 178.3339])
SIZE = np.array([20.0, 10.0, 8.0])
TRIANGLES = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
     [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
)  # fmt: skip
SETTINGS = MeshModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal")
LOCAL = replace(SETTINGS, placement=MapPlacement(east_m=CORNER[0], north_m=CORNER[1], height_m=CORNER[2]))
OFFSET_TEXT = f"WGS84 UTM 32N\n{CORNER[0]} {CORNER[1]}\n"


def box(corner=CORNER, size=SIZE):
    """Corners (8, 3) of a box: below anticlockwise from the south-west, then above."""
    unit = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    return np.asarray(corner, dtype=float) + unit * size


def obj(path: Path, vertices, triangles=TRIANGLES) -> Path:
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices]
    lines += [f"f {a}/1 {b}/1 {c}/1" for a, b, c in np.asarray(triangles) + 1]
    path.write_text("mtllib missing.mtl\nusemtl brick\nvt 0 0\n" + "\n".join(lines) + "\n")
    return path


def ply(path: Path, vertices, kind: str = "double") -> Path:
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        + "".join(f"property {kind} {axis}\n" for axis in "xyz")
        + f"element face {len(TRIANGLES)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = b"".join(struct.pack("<Biii", 3, *triangle) for triangle in TRIANGLES.tolist())
    dtype = {"double": "<f8", "float": "<f4"}[kind]
    path.write_bytes(header.encode() + np.asarray(vertices).astype(dtype).tobytes() + faces)
    return path


def stl(path: Path, vertices) -> Path:
    corners = np.asarray(vertices)[TRIANGLES].astype("<f4")
    records = b"".join(bytes(12) + triangle.tobytes() + bytes(2) for triangle in corners)
    path.write_bytes(bytes(80) + struct.pack("<I", len(corners)) + records)
    return path


def glb(path: Path, vertices_y_up, translation=(0.0, 0.0, 0.0)) -> Path:
    """By the glTF 2.0 specification: positions as float32, the node's translation as JSON numbers."""
    points = np.asarray(vertices_y_up).astype("<f4")
    data = points.tobytes() + TRIANGLES.astype("<u4").tobytes()
    content = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": list(translation)}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3",
             "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()},
            {"bufferView": 1, "componentType": 5125, "count": TRIANGLES.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": TRIANGLES.size * 4},
        ],
        "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)
    return path


def y_up(vertices):
    """East, north, up as glTF's x right, y up, z to the viewer."""
    x, y, z = np.asarray(vertices).T
    return np.column_stack([x, z, -y])


def corners_on_the_map(building: BuildingModel) -> np.ndarray:
    """All corners of the triangles in EPSG:25832, by PROJ from the site's ECEF, rounded to 0.1 mm and unique."""
    origin = building.origin
    lon, lat = np.radians([origin.lon_deg, origin.lat_deg])
    zero = np.array(
        pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(
            origin.lon_deg, origin.lat_deg, origin.height_ellipsoidal_m
        )
    )
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    ecef = zero + building.vertices_site_m[building.triangles].reshape(-1, 3) @ np.array([east, np.cross(up, east), up])
    to_map = pyproj.Transformer.from_crs("EPSG:4978", pyproj.CRS("EPSG:25832").to_3d(), always_xy=True)
    return np.unique(np.column_stack(to_map.transform(*ecef.T)).round(4), axis=0)


def in_order(points):
    return points[np.lexsort(np.round(points, 2).T[::-1])]


@pytest.mark.parametrize("name", ["obj", "ply", "local obj", "local ply", "local stl", "glb", "glb of a large node"])
def test_a_box_is_at_the_position_in_its_file(tmp_path: Path, name: str) -> None:
    local = box(corner=(0, 0, 0))
    path, settings = {
        "obj": lambda: (obj(tmp_path / "a.obj", box()), SETTINGS),
        "ply": lambda: (ply(tmp_path / "a.ply", box()), SETTINGS),
        "local obj": lambda: (obj(tmp_path / "a.obj", local), LOCAL),
        "local ply": lambda: (ply(tmp_path / "a.ply", local, "float"), LOCAL),
        "local stl": lambda: (stl(tmp_path / "a.stl", local), LOCAL),
        "glb": lambda: (glb(tmp_path / "a.glb", y_up(local)), LOCAL),
        "glb of a large node": lambda: (glb(tmp_path / "a.glb", y_up(local), y_up(CORNER[None])[0]), SETTINGS),
    }[name]()
    building = load_mesh_building(path, settings=settings)
    np.testing.assert_allclose(in_order(corners_on_the_map(building)), in_order(box()), rtol=0, atol=0.001)  # m
    assert building.surface_kind is SurfaceKind.MESH
    assert building.georeference_level == "registry"
    # A closed body wound outwards: its volume by the divergence theorem, in true metres (the map's factor is 0.9996).
    a, b, c = building.vertices_site_m[building.triangles].transpose(1, 0, 2)
    volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
    assert abs(volume - SIZE.prod() / 0.99963**2) < 0.5  # m3


def test_an_offset_file_beside_the_mesh_places_it_and_can_name_the_crs(tmp_path: Path) -> None:
    mesh = obj(tmp_path / "a.obj", box(corner=(0, 0, CORNER[2])))
    offset_file = tmp_path / "odm_georeferencing_model_geo.txt"
    offset_file.write_text(OFFSET_TEXT)
    by_registry = load_mesh_building(mesh, settings=replace(SETTINGS, offset_file=offset_file))
    np.testing.assert_allclose(in_order(corners_on_the_map(by_registry)), in_order(box()), rtol=0, atol=0.001)  # m
    assert "EPSG:32632" in by_registry.remarks and "EPSG:25832" in by_registry.remarks
    by_file = load_mesh_building(
        mesh, settings=MeshModelSettings(vertical_datum="ellipsoidal", offset_file=offset_file)
    )
    assert by_file.map_crs == "EPSG:32632"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("WGS84 UTM 32N\n432000 5422000\n0.5 0.25 3\n", (432000.0, 5422000.0, 0.0, "EPSG:32632")),
        ("WGS84 UTM 56S\n334000.5 6252000", (334000.5, 6252000.0, 0.0, "EPSG:32756")),
        ("432000.000 5422000.000 120.000\n", (432000.0, 5422000.0, 120.0, None)),
        (
            '<?xml version="1.0"?><ModelMetadata version="1"><SRS>EPSG:25832</SRS>'
            "<SRSOrigin>432000,5422000,1.5</SRSOrigin></ModelMetadata>",
            (432000.0, 5422000.0, 1.5, "EPSG:25832"),
        ),
    ],
)
def test_offset_files_of_the_programs(tmp_path: Path, text: str, expected: tuple[float, float, float, str]) -> None:
    path = tmp_path / "offset.txt"
    path.write_text(text)
    offset = read_mesh_offset(path)
    assert (offset.east_m, offset.north_m, offset.height_m, offset.crs) == expected


@pytest.mark.parametrize("text", ["", "WGS84 UTM 32N\n", "nothing of use\nhere neither", "<a/>", "1 2 3 4"])
def test_an_offset_file_without_an_offset_is_an_error(tmp_path: Path, text: str) -> None:
    path = tmp_path / "offset.txt"
    path.write_text(text)
    with pytest.raises(GeoreferenceError, match=r"offset.txt has no offset.*crs.placement"):
        read_mesh_offset(path)


def test_units_and_axes_are_those_of_the_registry(tmp_path: Path) -> None:
    feet = read_mesh_file(obj(tmp_path / "a.obj", box(corner=(0, 0, 0)) / 0.3048), unit_m=0.3048)
    np.testing.assert_allclose(feet.vertices_m.max(axis=0), SIZE, rtol=0, atol=0.0001)  # m
    raw = glb(tmp_path / "a.glb", box(corner=(0, 0, 0)))  # some programs write glTF with z up
    np.testing.assert_allclose(read_mesh_file(raw, axes=MeshAxes.Z_UP).vertices_m.max(axis=0), SIZE, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read_mesh_file(raw).vertices_m.max(axis=0), [20, 0, 10], rtol=0, atol=1e-6)  # m


def test_a_quad_is_two_triangles_and_parts_are_one_mesh(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("o one\nv 0 0 0\nv 4 0 0\nv 4 0 3\nv 0 0 3\nf 1 2 3 4\no two\nv 9 0 0\nv 9 5 0\nv 9 5 3\nf 5 6 7\n")
    mesh = read_mesh_file(path)
    assert len(mesh.triangles) == 3
    corners = mesh.vertices_m[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert abs(area - (4 * 3 + 5 * 3 / 2)) < 1e-6  # m2


def test_map_coordinates_in_32_bits_are_refused(tmp_path: Path) -> None:
    message = r"32-bit numbers, whose spacing at 5,421,.* is 500 mm \(limit 1 mm\).*crs.offset_file"
    for path in (
        ply(tmp_path / "a.ply", box(), "float"),
        stl(tmp_path / "a.stl", box()),
        glb(tmp_path / "a.glb", y_up(box())),
    ):
        with pytest.raises(ModelError, match=message):
            read_mesh_file(path)
    rng = np.random.default_rng(5)
    lost = rng.uniform(CORNER, CORNER + SIZE, (200, 3)).astype(np.float32).astype(float)  # 32 bits on the way
    with pytest.raises(ModelError, match=message):
        read_mesh_file(obj(tmp_path / "b.obj", lost, np.arange(198).reshape(-1, 3)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "cannot be read as a mesh|has no triangles"),
        (b"v 0 0 0\nv 1 0 0\nv 0 9 0\n", "has no triangles"),
        (b"v 0 0 0\nv nan 0 0\nv 0 9 0\nf 1 2 3\n", "1 of 3 vertices are not finite"),
        (b"v 0 0 0\nv 1e5 0 0\nv 0 1e5 9\nf 1 2 3\n", r"100,000 m across .* crs.unit"),
        (b"v 0 0 0\nv 0.2 0 0\nv 0 0.1 0.3\nf 1 2 3\n", "0.3 m across"),
        (b"v 0 0 0\nv 5 0 0\nv 9 0 0\nf 1 2 3\n", "have zero area"),
    ],
    ids=["empty", "points alone", "NaN", "millimetres", "a model of a model", "flat"],
)
def test_a_mesh_that_is_not_a_building(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.obj"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=message):
        read_mesh_file(path)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "gltf"])
def test_malformed_files_give_a_message(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(bytes(range(256)) * 4)
    with pytest.raises(ModelError, match=rf"a\.{suffix}"):
        read_mesh_file(path)
    with pytest.raises(ModelError, match="does not exist"):
        read_mesh_file(tmp_path / f"none.{suffix}")


def test_a_position_that_is_not_stated_or_impossible(tmp_path: Path) -> None:
    local = obj(tmp_path / "a.obj", box(corner=(0, 0, 0)))
    with pytest.raises(GeoreferenceError, match=r"outside the area of use of EPSG:25832 .*crs.offset_file"):
        load_mesh_building(local, settings=SETTINGS)
    with pytest.raises(GeoreferenceError, match=r"crs.map"):
        load_mesh_building(local, settings=replace(LOCAL, map_crs=None))
    with pytest.raises(GeoreferenceError, match=r"crs.vertical"):
        load_mesh_building(local, settings=replace(LOCAL, vertical_datum=None))


def test_facades_stand_for_elements_and_storeys_come_from_the_registry(tmp_path: Path) -> None:
    floors = [
        StoreyElevation(name="First floor", floor_m=CORNER[2] + 4),
        StoreyElevation(name="Ground floor", floor_m=CORNER[2]),
    ]
    settings = replace(SETTINGS, storeys=floors)
    building = load_mesh_building(obj(tmp_path / "a.obj", box()), settings=settings)
    elements = {row["element_guid"]: row for row in building.elements.to_pylist()}
    assert set(elements) == {"facade-N-1", "facade-E-1", "facade-S-1", "facade-W-1", "level-1"}
    assert {row["ifc_class"] for row in elements.values()} == {"Surface"}
    assert elements["facade-S-1"]["facade"] == "S" and elements["facade-S-1"]["storey"] == "Ground floor"
    # Grid north is 0.4 degrees off true north here.
    assert abs(elements["facade-S-1"]["facade_azimuth_deg"] - 180) < 1.0  # deg
    assert abs(elements["facade-S-1"]["surface_area_m2"] - 20 * 8) < 0.2  # m2
    assert abs(elements["level-1"]["surface_area_m2"] - 2 * 20 * 10) < 0.5  # m2
    assert [storey.name for storey in building.storeys] == ["Ground floor", "First floor"]
    top = building.vertices_site_m[:, 2].max()
    assert find_storey(building.storeys, top - 3.9) == "First floor" and find_storey(building.storeys, top - 4.2) == (
        "Ground floor"
    )
    folder = tmp_path / "saved"
    folder.mkdir()
    building.save(folder)
    again = read_building(folder)
    assert (again.surface_kind, again.storeys, again.has_surface) == (SurfaceKind.MESH, building.storeys, True)


def test_a_ray_meets_the_mesh_where_the_box_is(tmp_path: Path) -> None:
    building = load_mesh_building(obj(tmp_path / "a.obj", box()), settings=SETTINGS)
    centre = CORNER + SIZE / 2
    to_geo = pyproj.Transformer.from_crs(pyproj.CRS("EPSG:25832").to_3d(), "EPSG:4979", always_xy=True)
    eye, target = (building.origin.site_from_geo(np.array([to_geo.transform(*at)]))
                   for at in (centre - [0, 30, 0], centre))  # fmt: skip
    hits = Surface(building).cast(eye, target - eye)
    on_map = building.map_from_site(hits.xyz_site_m)[0]
    np.testing.assert_allclose(on_map, centre - [0, SIZE[1] / 2, 0], rtol=0, atol=0.001)  # m
    assert building.elements.column("element_guid")[int(hits.element[0])].as_py() == "facade-S-1"


def test_a_building_without_a_model_is_placed_at_its_photographs() -> None:
    lon_lat = np.array([[8.4081, 48.9402], [8.4083, 48.9405], [np.nan, np.nan], [8.4082, 48.9401]])
    place = place_building_without_model(lon_lat, settings=MeshModelSettings(vertical_datum="ellipsoidal"))
    assert (place.map_crs, place.surface_kind, place.has_surface) == ("EPSG:32632", SurfaceKind.AS_BUILT, False)
    assert (place.origin.lon_deg, place.origin.lat_deg) == (8.408, 48.94)
    given = SiteOrigin(lon_deg=151.2, lat_deg=-33.9, height_ellipsoidal_m=20.0)
    nowhere = np.full((2, 2), np.nan)
    assert place_building_without_model(
        nowhere, settings=MeshModelSettings(vertical_datum="ellipsoidal", origin=given)
    ).map_crs == "EPSG:32756"  # fmt: skip
    with pytest.raises(GeoreferenceError, match=r"none of the 2 photographs .* crs.origin"):
        place_building_without_model(nowhere, settings=MeshModelSettings(vertical_datum="ellipsoidal"))
    with pytest.raises(GeoreferenceError, match=r"crs.vertical"):
        place_building_without_model(lon_lat, settings=MeshModelSettings())
