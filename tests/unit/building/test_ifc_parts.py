"""Openings, curtain walls, curved walls, roofs, layers, properties, storeys and buildings, in every schema."""

import json

import ifcopenshell
import ifcopenshell.guid
import numpy as np
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.storeys import StoreyElevation
from facadelake.core.errors import ModelError
from tests.unit.building.conftest import Box, Ifc

SCHEMAS = ("IFC2X3", "IFC4", "IFC4X3")
CRS = {"Name": "EPSG:25832", "VerticalDatum": "ellipsoidal"}
PLACED = IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal")
HERE = {"conversion": {"Eastings": 456639.0, "Northings": 5421033.0, "OrthogonalHeight": 178.0}, "crs": CRS}
FAR = (456639.0, 5421033.0, 178.0)


class Edit:
    """An IFC opened to be changed: relations as the schema has them."""

    def __init__(self, path):
        self.path = path
        self.model = ifcopenshell.open(path)

    def one(self, name):
        return next(element for element in self.model.by_type("IfcRoot") if element.Name == name)

    def make(self, kind, **attributes):
        owners = self.model.by_type("IfcOwnerHistory")
        owner = owners[0] if owners else None
        return self.model.create_entity(kind, GlobalId=ifcopenshell.guid.new(), OwnerHistory=owner, **attributes)

    def aggregate(self, whole, parts):
        self.make("IfcRelAggregates", RelatingObject=whole, RelatedObjects=parts)

    def loosen(self, element):
        """Take the element out of its storey."""
        for containing in self.model.by_type("IfcRelContainedInSpatialStructure"):
            rest = [one for one in containing.RelatedElements if one != element]
            if rest:
                containing.RelatedElements = rest
            else:
                self.model.remove(containing)

    def rows(self, settings=PLACED):
        """The elements by name, once written and loaded."""
        self.model.write(str(self.path))
        self.building = load_ifc_building(self.path, settings=settings)
        return {row["element_name"]: row for row in self.building.elements.to_pylist()}


def at_map(*boxes):
    """Boxes moved to map coordinates, so that no schema needs a map conversion."""
    return [
        Box(size_m=box.size_m, corner_m=tuple(np.add(box.corner_m, FAR)), name=box.name, ifc_class=box.ifc_class,
            contained=box.contained)
        for box in boxes
    ]  # fmt: skip


@pytest.fixture
def house(write_ifc):
    """Writes the boxes at map coordinates in a schema and opens them to be changed."""

    def open_house(schema, *boxes):
        return Edit(write_ifc(Ifc(schema=schema, boxes=at_map(*boxes))))

    return open_house


@pytest.mark.parametrize("schema", SCHEMAS)
def test_a_window_has_its_walls_storey_and_leaves_a_hole_in_it(house, schema):
    edit = house(
        schema, Box(name="wall", size_m=(6.0, 0.3, 3.0)),
        Box(name="hole", size_m=(1.0, 0.5, 1.2), corner_m=(2.0, -0.1, 1.0), ifc_class="IfcOpeningElement",
            contained=False),
        Box(name="window", size_m=(1.0, 0.1, 1.2), corner_m=(2.0, 0.1, 1.0), ifc_class="IfcWindow", contained=False),
    )  # fmt: skip
    wall, hole, window = edit.one("wall"), edit.one("hole"), edit.one("window")
    edit.make("IfcRelVoidsElement", RelatingBuildingElement=wall, RelatedOpeningElement=hole)
    edit.make("IfcRelFillsElement", RelatingOpeningElement=hole, RelatedBuildingElement=window)
    rows = edit.rows()
    assert set(rows) == {"wall", "window"}
    assert (rows["window"]["host_guid"], rows["window"]["storey"]) == (wall.GlobalId, "Ground floor")
    assert rows["window"]["storey_source"] == "host"
    assert (rows["wall"]["host_guid"], rows["wall"]["storey_source"]) == (None, "containment")
    # Faces of 6 x 3 without 1 x 1.2, the ends, and the reveal all round.
    area = 2 * (18 - 1.2) + 2 * (6 + 3) * 0.3 + 2 * (1.0 + 1.2) * 0.3
    np.testing.assert_allclose(rows["wall"]["surface_area_m2"], area, rtol=2e-3)  # the map's stretch
    assert (rows["wall"]["detail_level"], rows["window"]["detail_level"]) == ("body", "box")


@pytest.mark.parametrize("schema", SCHEMAS)
def test_parts_of_a_curtain_wall(house, schema):
    edit = house(
        schema,
        *(
            Box(name=f"plate {i}", size_m=(1.0, 0.05, 6.0), corner_m=(i, 0.0, 0.0), ifc_class="IfcPlate",
                contained=False)
            for i in range(3)
        ),
        Box(name="back", size_m=(3.0, 0.2, 6.0), corner_m=(0.0, 4.0, 0.0)),
    )  # fmt: skip
    whole = edit.make("IfcCurtainWall", Name="curtain")
    edit.model.by_type("IfcRelContainedInSpatialStructure")[0].RelatedElements = [edit.one("back"), whole]
    edit.aggregate(whole, [edit.one(f"plate {i}") for i in range(3)])
    rows = edit.rows()
    assert set(rows) == {"plate 0", "plate 1", "plate 2", "back"}
    for i in range(3):
        row = rows[f"plate {i}"]
        assert (row["host_guid"], row["storey"], row["storey_source"]) == (whole.GlobalId, "Ground floor", "host")
        assert row["facade"] == "S"


@pytest.mark.parametrize("schema", SCHEMAS)
def test_a_half_round_tower_is_open_around(house, schema):
    edit = house(schema, Box(name="tower", size_m=(6.0, 6.0, 5.0)), Box(name="hall", size_m=(6.0, 0.3, 5.0),
                                                                        corner_m=(-3.0, 3.0, 0.0)))  # fmt: skip
    angle = np.radians(np.linspace(180.0, 360.0, 37))
    outline = [(3 + 3 * np.cos(a), 3 * np.sin(a)) for a in angle]
    points = [edit.model.create_entity("IfcCartesianPoint", tuple(map(float, p))) for p in [*outline, outline[0]]]
    solid = edit.one("tower").Representation.Representations[0].Items[0]
    solid.SweptArea.OuterCurve = edit.model.create_entity("IfcPolyline", points)
    rows = edit.rows()
    assert (rows["tower"]["facade"], rows["tower"]["facade_azimuth_deg"]) == ("around", None)
    assert rows["hall"]["facade"] == "N"


def test_a_gently_curved_wall_is_one_facade(house):
    """An arc of 40 degrees has the direction of its centre."""
    edit = house("IFC4", Box(name="arc", size_m=(6.0, 6.0, 5.0)), Box(name="hall", corner_m=(-2.0, 8.0, 0.0)))
    angle = np.radians(np.linspace(250.0, 290.0, 21))
    outer = [(20 * np.cos(a), 20 + 20 * np.sin(a)) for a in angle]
    inner = [(19.7 * np.cos(a), 20 + 19.7 * np.sin(a)) for a in angle[::-1]]
    points = [edit.model.create_entity("IfcCartesianPoint", tuple(map(float, p))) for p in [*outer, *inner, outer[0]]]
    edit.one("arc").Representation.Representations[0].Items[0].SweptArea.OuterCurve = edit.model.create_entity(
        "IfcPolyline", points
    )
    row = edit.rows()["arc"]
    assert row["facade"] == "S"
    np.testing.assert_allclose(row["facade_azimuth_deg"], 180.0 - 0.45, rtol=0, atol=0.5)  # deg: grid north's share


@pytest.mark.parametrize("schema", SCHEMAS)
def test_layers_from_the_outside_in_whichever_way_the_wall_was_drawn(house, schema):
    """Both walls are drawn along x with their layers towards +y: outward for the northern one, inward for the other."""
    edit = house(
        schema, Box(name="south", size_m=(6.0, 0.3, 3.0)), Box(name="north", size_m=(6.0, 0.3, 3.0),
                                                               corner_m=(0.0, 4.7, 0.0)),
        Box(name="roof", size_m=(6.0, 5.0, 0.3), corner_m=(0.0, 0.0, 3.0), ifc_class="IfcSlab"),
    )  # fmt: skip
    model = edit.model
    plaster, brick = (model.create_entity("IfcMaterial", Name=name) for name in ("plaster", "brick"))
    layers = [model.create_entity("IfcMaterialLayer", m, t) for m, t in ((plaster, 0.02), (None, 0.04), (brick, 0.24))]
    layer_set = model.create_entity("IfcMaterialLayerSet", layers)
    for name, direction in (("south", "AXIS2"), ("north", "AXIS2"), ("roof", "AXIS3")):
        usage = model.create_entity("IfcMaterialLayerSetUsage", layer_set, direction, "POSITIVE", 0.0)
        edit.make("IfcRelAssociatesMaterial", RelatedObjects=[edit.one(name)], RelatingMaterial=usage)
    rows = edit.rows()
    as_listed = [
        {"material": "plaster", "thickness_m": 0.02},
        {"material": None, "thickness_m": 0.04},
        {"material": "brick", "thickness_m": 0.24},
    ]
    assert json.loads(rows["south"]["material_layers"]) == as_listed
    assert json.loads(rows["north"]["material_layers"]) == as_listed[::-1]
    assert json.loads(rows["roof"]["material_layers"]) == as_listed[::-1]
    assert rows["south"]["material"] == "plaster; brick"


@pytest.mark.parametrize("schema", SCHEMAS)
def test_layers_without_a_usage_keep_the_order_of_the_ifc(house, schema):
    edit = house(
        schema, Box(name="south", size_m=(6.0, 0.3, 3.0)), Box(name="north", size_m=(6.0, 0.3, 3.0),
                                                               corner_m=(0.0, 4.7, 0.0)),
    )  # fmt: skip
    model = edit.model
    materials = [model.create_entity("IfcMaterial", Name=name) for name in ("render", "brick")]
    layer_set = model.create_entity(
        "IfcMaterialLayerSet", [model.create_entity("IfcMaterialLayer", m, 0.1) for m in materials]
    )
    walls = [edit.one("south"), edit.one("north")]
    edit.make("IfcRelAssociatesMaterial", RelatedObjects=walls, RelatingMaterial=layer_set)
    for row in edit.rows().values():
        assert [layer["material"] for layer in json.loads(row["material_layers"])] == ["render", "brick"]


@pytest.mark.parametrize("schema", SCHEMAS)
def test_properties_of_the_element_and_its_type(house, schema):
    edit = house(schema, Box(name="wall"), Box(name="slab", ifc_class="IfcSlab", corner_m=(0.0, 0.0, 3.0)))
    model = edit.model

    def single(name, kind, value):
        return model.create_entity("IfcPropertySingleValue", name, None, model.create_entity(kind, value), None)

    def pset(name, *properties):
        return edit.make("IfcPropertySet", Name=name, HasProperties=properties)

    wall_type = edit.make(
        "IfcWallType", PredefinedType="STANDARD",
        HasPropertySets=[
            pset("Pset_WallCommon", single("IsExternal", "IfcBoolean", False), single("FireRating", "IfcLabel", "REI")),
            pset("Supplier", single("Text", "IfcText", "x" * 9000)),
        ],
    )  # fmt: skip
    edit.make("IfcRelDefinesByType", RelatedObjects=[edit.one("wall")], RelatingType=wall_type)
    own = pset("Pset_WallCommon", single("IsExternal", "IfcBoolean", True))
    edit.make("IfcRelDefinesByProperties", RelatedObjects=[edit.one("wall")], RelatingPropertyDefinition=own)
    edit.one("slab").PredefinedType = "ROOF"
    rows = edit.rows()
    sets = json.loads(rows["wall"]["properties"])
    assert sets["Pset_WallCommon"] == {"IsExternal": True, "FireRating": "REI"}
    assert sets["_left_out"] == ["Supplier"]
    assert rows["wall"]["is_external"] is True
    assert (rows["wall"]["predefined_type"], rows["slab"]["predefined_type"]) == ("STANDARD", "ROOF")
    assert rows["slab"]["properties"] is None


def without_storeys(edit):
    for containing in edit.model.by_type("IfcRelContainedInSpatialStructure"):
        edit.model.remove(containing)
    for storey in edit.model.by_type("IfcBuildingStorey"):
        edit.model.remove(storey)


@pytest.mark.parametrize("schema", SCHEMAS)
def test_a_model_without_storeys_has_none(house, schema):
    edit = house(schema, Box(name="wall"))
    without_storeys(edit)
    row = edit.rows()["wall"]
    assert (row["storey"], row["storey_source"]) == (None, None)
    assert edit.building.storeys == ()


def test_the_registrys_storeys_replace_those_an_ifc_lacks(house):
    edit = house("IFC4", Box(name="low"), Box(name="high", corner_m=(0.0, 0.0, 3.2)))
    without_storeys(edit)
    floors = (StoreyElevation(name="Upper", floor_m=181.2), StoreyElevation(name="Ground", floor_m=178.0))
    rows = edit.rows(IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", storeys=floors))
    assert {name: (row["storey"], row["storey_source"]) for name, row in rows.items()} == {
        "low": ("Ground", "elevation"), "high": ("Upper", "elevation"),
    }  # fmt: skip
    rise = edit.building.storeys[1].floor_site_m - edit.building.storeys[0].floor_site_m
    np.testing.assert_allclose(rise, 3.2, rtol=0, atol=0.001)  # m


def test_storeys_left_at_zero_count_by_their_elevation(house):
    """Some exporters place every storey at the building's origin and give the level only in Elevation."""
    edit = house("IFC4", Box(name="low"), Box(name="high", corner_m=(0.0, 0.0, 3.2), contained=False))
    for storey, elevation in zip(edit.model.by_type("IfcBuildingStorey"), (178.0, 181.0), strict=True):
        storey.Elevation = elevation
        storey.ObjectPlacement = edit.model.by_type("IfcBuildingStorey")[0].ObjectPlacement
    rows = edit.rows()
    assert (rows["high"]["storey"], rows["high"]["storey_source"]) == ("First floor", "elevation")


@pytest.mark.parametrize("schema", SCHEMAS)
def test_several_buildings_in_a_file(house, schema):
    edit = house(
        schema, Box(name="ours"), Box(name="theirs", corner_m=(30.0, 0.0, 0.0)),
        Box(name="roof of theirs", corner_m=(30.0, 0.0, 3.0), contained=False),
    )  # fmt: skip
    edit.loosen(edit.one("theirs"))
    neighbour = edit.make("IfcBuilding", Name="neighbour", CompositionType="ELEMENT")
    floor = edit.make("IfcBuildingStorey", Name="Their floor", CompositionType="ELEMENT", Elevation=178.0)
    edit.aggregate(edit.model.by_type("IfcSite")[0], [neighbour])
    edit.aggregate(neighbour, [floor])
    edit.make("IfcRelContainedInSpatialStructure", RelatingStructure=floor, RelatedElements=[edit.one("theirs")])
    edit.make(
        "IfcRelContainedInSpatialStructure", RelatingStructure=neighbour, RelatedElements=[edit.one("roof of theirs")]
    )
    rows = edit.rows()
    assert {name: row["ifc_building"] for name, row in rows.items()} == {
        "ours": "building", "theirs": "neighbour", "roof of theirs": "neighbour",
    }  # fmt: skip
    # By elevation it is the storey of its own building, not one of the other building at the same height.
    assert rows["roof of theirs"]["storey"] == "Their floor"
    assert "the IFC has 2 buildings" in edit.building.remarks
    ours = IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", building="building")
    rows = edit.rows(ours)
    assert set(rows) == {"ours"}
    assert "only 'building' was loaded" in edit.building.remarks
    assert {storey.name for storey in edit.building.storeys} == {"Ground floor", "First floor"}
    with pytest.raises(
        ModelError, match=r"model_building 'nobody' in the portfolio matches 0 .*'building' \(.*'neighbour'"
    ):
        load_ifc_building(
            edit.path, settings=IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", building="nobody")
        )


def test_distant_elements_are_omitted_and_reported(house):
    edit = house("IFC4", Box(name="wall"), Box(name="door", corner_m=(1.0, 0.0, 0.0)), Box(name="lost"))
    matrix = edit.one("lost").ObjectPlacement.RelativePlacement
    matrix.Location = edit.model.create_entity("IfcCartesianPoint", (0.0, 0.0, 0.0))
    rows = edit.rows()
    assert set(rows) == {"wall", "door"}
    assert edit.one("lost").GlobalId in edit.building.remarks


@pytest.mark.parametrize(("size", "text"), [((4000.0, 300.0, 3000.0), "3e"), ((0.004, 0.0003, 0.003), "0.003")])
def test_a_building_of_impossible_size_has_a_wrong_unit(write_ifc, size, text):
    with pytest.raises(ModelError, match=rf"{text}.* m high \(limits: .*; its length unit"):
        load_ifc_building(write_ifc(Ifc(boxes=[Box(size_m=size)], **HERE)), settings=IfcModelSettings())
