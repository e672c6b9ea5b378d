"""Elements: names, storeys, areas, winding, materials and facades."""

import ifcopenshell
import ifcopenshell.api
import ifcopenshell.api.material
import ifcopenshell.api.pset
import ifcopenshell.api.root
import numpy as np
import pytest
import shapely
import trimesh

from facadelake.building.facades.directions import Facades, find_facades
from facadelake.building.facades.openness import COMPASS, compass_from_direction, find_open_sides
from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.ifc.meshes import mesh_elements, open_ifc
from facadelake.building.surface.raycasting import Surface
from tests.unit.building.conftest import Box, Ifc

PLACED = {
    "conversion": {"Eastings": 456639.0, "Northings": 5421033.0, "OrthogonalHeight": 178.0},
    "crs": {"Name": "EPSG:25832", "VerticalDatum": "ellipsoidal"},
}
# A room of 6 x 5 m under a roof slab: each wall is open to the sky on one side only.
ROOM = (
    Box(name="south", size_m=(6.0, 0.3, 3.0), corner_m=(0.0, 0.0, 0.0)),
    Box(name="north", size_m=(6.0, 0.3, 3.0), corner_m=(0.0, 4.7, 0.0)),
    Box(name="west", size_m=(0.3, 4.4, 3.0), corner_m=(0.0, 0.3, 0.0)),
    Box(name="east", size_m=(0.3, 4.4, 3.0), corner_m=(5.7, 0.3, 0.0)),
    Box(name="roof", size_m=(6.0, 5.0, 0.3), corner_m=(0.0, 0.0, 3.0), ifc_class="IfcSlab", contained=False),
    Box(name="table", size_m=(1.0, 1.0, 0.8), corner_m=(2.0, 2.0, 0.0), ifc_class="IfcFurnishingElement"),
    Box(name="room", size_m=(5.0, 4.0, 2.9), corner_m=(0.5, 0.5, 0.0), ifc_class="IfcSpace", contained=False),
    Box(name="hole", size_m=(1.0, 0.5, 1.0), corner_m=(1.0, -0.1, 1.0), ifc_class="IfcOpeningElement", contained=False),
)


def elements_of(path, **settings):
    table = load_ifc_building(path, settings=IfcModelSettings(**settings)).elements
    return {row["element_name"]: row for row in table.to_pylist()}


def test_walls_face_outward_and_the_room_is_no_surface(write_ifc):
    rows = elements_of(write_ifc(Ifc(boxes=ROOM, **PLACED)))
    assert {name: row["facade"] for name, row in rows.items()} == {
        "south": "S", "north": "N", "west": "W", "east": "E", "roof": "level", "table": "inside",
    }  # fmt: skip


def test_storeys_by_containment_else_by_level(write_ifc):
    rows = elements_of(write_ifc(Ifc(boxes=ROOM, **PLACED)))
    assert rows["south"]["storey"] == "Ground floor"
    assert rows["roof"]["storey"] == "First floor"  # in no storey, its foot at 3.0 m


def test_areas_and_footprints_have_the_sizes_of_the_boxes(write_ifc):
    building = load_ifc_building(write_ifc(Ifc(boxes=ROOM[:1], milli=True, **PLACED)), settings=IfcModelSettings())
    row = building.elements.to_pylist()[0]
    np.testing.assert_allclose(row["surface_area_m2"], 2 * (6 * 0.3 + 6 * 3 + 0.3 * 3), rtol=1e-3)  # grid factor
    outline = shapely.from_wkb(row["geometry"])
    geo = np.column_stack([outline.exterior.coords.xy[0], outline.exterior.coords.xy[1], np.full(5, 178.0)])
    xy = building.origin.site_from_geo(geo)[:, :2]
    np.testing.assert_allclose(shapely.Polygon(xy).area, 6 * 0.3, rtol=0, atol=0.003)  # m2
    assert not shapely.has_z(outline)


def test_bodies_are_wound_outward(write_ifc):
    path = write_ifc(Ifc(boxes=ROOM, **PLACED))
    for mesh in mesh_elements(open_ifc(path), deflection_m=0.001, workers=1):
        a, b, c = (mesh.vertices_ifc_m[mesh.triangles[:, i]] for i in range(3))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        size = np.ptp(mesh.vertices_ifc_m, axis=0)
        np.testing.assert_allclose(volume, size.prod(), rtol=0, atol=1e-6)  # m3


def test_materials_and_is_external(write_ifc):
    path = write_ifc(Ifc(boxes=ROOM[:2], **PLACED))
    model = ifcopenshell.open(path)
    run = ifcopenshell.api.run
    south, north = sorted(model.by_type("IfcWall"), key=lambda wall: wall.Name, reverse=True)
    layers = run("material.add_material_set", model, name="wall", set_type="IfcMaterialLayerSet")
    for name in ("plaster", "brick", "plaster"):
        material = next((m for m in model.by_type("IfcMaterial") if m.Name == name), None)
        material = material or run("material.add_material", model, name=name)
        run("material.add_layer", model, layer_set=layers, material=material)
    run("material.assign_material", model, products=[south], type="IfcMaterialLayerSet", material=layers)
    pset = run("pset.add_pset", model, product=south, name="Pset_WallCommon")
    run("pset.edit_pset", model, pset=pset, properties={"IsExternal": True})
    model.write(str(path))
    rows = elements_of(path)
    assert rows["south"]["material"] == "plaster; brick"
    assert rows["south"]["is_external"] is True
    assert rows["north"]["material"] is None
    assert rows["north"]["is_external"] is None
    assert north.Name == "north"


@pytest.mark.parametrize(
    ("direction", "name"),
    [([0, 1, 0], "N"), ([1, 1, 0.2], "NE"), ([1, 0, 0], "E"), ([0.1, -1, 0], "S"), ([-1, 0, 0.9], "W"),
     ([-1, 1, 0], "NW"), ([0, 0, 1], "level"), ([0.3, 0, -1], "level"), ([-0.01, 1, 0], "N")],
)  # fmt: skip
def test_compass(direction, name):
    assert compass_from_direction(np.array(direction, dtype=float)) == name


def test_a_return_does_not_change_the_direction_of_its_wall():
    """A wall of 10 m that faces 156 degrees, with a return of 6 m that faces 246: their mean would be south.

    The wall has two facades, so the normal at a point decides, and the facade of the long side keeps its direction.
    """
    a = np.radians(156.0)
    out, aside, up = np.array([np.sin(a), np.cos(a), 0]), np.array([-np.cos(a), np.sin(a), 0]), np.array([0, 0, 4.0])
    block = trimesh.creation.box(extents=[10, 8, 4])
    turned = block.vertices @ np.array([aside, -out, [0, 0, 1]]) + up / 2 - 4.05 * out
    wall = np.array([5 * aside, -5 * aside, -5 * aside + up, 5 * aside + up])
    side = np.array([-5.05 * aside - 6 * out, -5.05 * aside, -5.05 * aside + up, -5.05 * aside - 6 * out + up])
    square = np.array([[0, 1, 2], [0, 2, 3]])
    owner = np.array([0, 0, 0, 0, *[1] * len(block.faces)])
    surface = Surface.from_mesh(
        np.vstack([wall, side, turned]), np.vstack([square, square + 4, block.faces + 8]), owner
    )
    assert (compass_from_direction(out), compass_from_direction(out - 0.6 * aside)) == ("SE", "S")
    sides = find_open_sides(surface, owner, 2)
    assert sides.labels[0] == "around"
    np.testing.assert_allclose(sides.azimuth_deg[0], 156.0, rtol=0, atol=0.01)  # deg
    straight = Surface.from_mesh(np.vstack([wall, turned]), np.vstack([square, block.faces + 4]), owner[2:])
    facade = find_facades(straight, owner[2:], 2)[0]
    assert facade.name == "SE"
    np.testing.assert_allclose(facade.azimuth_deg, 156.0, rtol=0, atol=0.01)  # deg


@pytest.mark.parametrize(
    ("element", "normal", "expected"),
    [
        ("S", [0, -1, 0], "S"),
        ("S", [1, 0, 0], "S"),  # a reveal belongs to its wall
        ("S", [0.1, 1, 0], "N"),  # the wall's other side
        ("S", [0, 0, 1], "S"),  # a sill
        ("level", [0, -1, 0], "S"),  # the edge of a slab
        ("level", [0, 0, -1], "level"),
        ("inside", [1, 0, 0], "E"),
    ],
)
def test_the_facade_assigned_to_a_point(element, normal, expected):
    facades = Facades(names=COMPASS, azimuths_deg=tuple(45.0 * number for number in range(8)))
    assert facades.assign_facade(element, np.array(normal, dtype=float)) == expected
