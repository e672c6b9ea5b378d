"""IFC to the globe by an independent path: the map conversion computed by hand, then pyproj."""

import ifcopenshell
import ifcopenshell.api
import ifcopenshell.api.owner.settings
import numpy as np
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model import read_building
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.core.errors import GeoreferenceError, ModelError
from facadelake.core.geodesy import SiteOrigin
from facadelake.core.proj.crs_parsing import parse_vertical_datum, split_crs
from tests.unit.building.conftest import Box, Ifc
from tests.unit.building.globe_by_hand import CONVERSION, CRS, assert_same_places, corners_of, ecef, expected_geo


@pytest.mark.parametrize(
    ("milli", "map_unit_metre", "scale"),
    [
        (False, False, None),  # metres throughout
        (False, True, 1.0),
        (True, True, 0.001),  # the standard's way: Scale holds the units' ratio
        (True, True, None),  # Revit's way: Scale left out (Autodesk/revit-ifc 784)
        (True, False, 0.001),  # no MapUnit, but Scale shows that the map counts in metres
        (True, False, None),  # no MapUnit and no Scale; eastings only make sense as metres
    ],
)
def test_metres_and_millimetres_land_on_the_same_place(write_ifc, milli, map_unit_metre, scale):
    conversion = CONVERSION | ({"Scale": scale} if scale else {})
    path = write_ifc(Ifc(milli=milli, map_unit_metre=map_unit_metre, conversion=conversion, crs=CRS))
    building = load_ifc_building(path, settings=IfcModelSettings())
    assert building.vertical_datum == "ellipsoidal"
    assert building.georeference_level == "50"
    assert_same_places(building, expected_geo(corners_of(Box())))


def test_assumptions_are_reported(write_ifc):
    by_the_book = write_ifc(Ifc(milli=True, map_unit_metre=True, conversion=CONVERSION | {"Scale": 0.001}, crs=CRS))
    assert load_ifc_building(by_the_book, settings=IfcModelSettings()).remarks == ""
    loose = write_ifc(Ifc(milli=True, conversion=CONVERSION, crs=CRS))
    assert "MapUnit is not given" in load_ifc_building(loose, settings=IfcModelSettings()).remarks


def test_a_grid_factor_stretches_the_map_and_not_the_height(write_ifc):
    path = write_ifc(Ifc(conversion=CONVERSION | {"Scale": 0.9996}, crs=CRS, boxes=[Box(size_m=(50.0, 0.3, 80.0))]))
    building = load_ifc_building(path, settings=IfcModelSettings())
    assert_same_places(building, expected_geo(corners_of(Box(size_m=(50.0, 0.3, 80.0))), factor=0.9996))
    assert "grid scale factor 0.999600" in building.remarks


@pytest.mark.parametrize(("holder", "prefix"), [("IfcSite", "ePSet"), ("IfcProject", "ePset")])
def test_ifc2x3_by_property_sets_at_the_site_or_the_project(write_ifc, monkeypatch, holder, prefix):
    path = write_ifc(Ifc(schema="IFC2X3", milli=True))
    model = ifcopenshell.open(path)
    user, tool = model.by_type("IfcPersonAndOrganization")[0], model.by_type("IfcApplication")[0]
    monkeypatch.setattr(ifcopenshell.api.owner.settings, "get_user", lambda file: user)
    monkeypatch.setattr(ifcopenshell.api.owner.settings, "get_application", lambda file: tool)
    sets = {
        f"{prefix}_MapConversion": CONVERSION | {"Scale": 0.001},
        f"{prefix}_ProjectedCRS": {"Name": "EPSG:25832", "MapUnit": "METRE", "VerticalDatum": "ellipsoidal"},
    }
    for name, properties in sets.items():
        pset = ifcopenshell.api.run("pset.add_pset", model, product=model.by_type(holder)[0], name=name)
        ifcopenshell.api.run("pset.edit_pset", model, pset=pset, properties=properties)
    model.write(str(path))
    assert_same_places(load_ifc_building(path, settings=IfcModelSettings()), expected_geo(corners_of(Box())))


def test_a_shifted_world_coordinate_system_is_refused(write_ifc):
    path = write_ifc(Ifc(conversion=CONVERSION, crs=CRS))
    model = ifcopenshell.open(path)
    context = model.by_type("IfcGeometricRepresentationContext", include_subtypes=False)[0]
    context.WorldCoordinateSystem = model.create_entity(
        "IfcAxis2Placement3D", model.create_entity("IfcCartesianPoint", (100.0, 0.0, 0.0))
    )
    model.write(str(path))
    with pytest.raises(GeoreferenceError, match="WorldCoordinateSystem"):
        load_ifc_building(path, settings=IfcModelSettings())


def test_the_registry_stands_in_for_a_missing_georeference(write_ifc):
    placement = MapPlacement(east_m=456639.25, north_m=5421033.5, height_m=178.25, rotation_deg=30.0)
    settings = IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", placement=placement)
    building = load_ifc_building(write_ifc(Ifc()), settings=settings)
    assert building.georeference_level == "registry"
    assert_same_places(building, expected_geo(corners_of(Box())))


def test_map_coordinates_are_the_conversion_written_out(write_ifc):
    building = load_ifc_building(write_ifc(Ifc(conversion=CONVERSION, crs=CRS)), settings=IfcModelSettings())
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    expected = [456639.25 + c * 4 - s * 0.3, 5421033.5 + s * 4 + c * 0.3, 178.25 + 3]
    found = building.map_from_site(building.vertices_site_m)
    assert np.linalg.norm(found - expected, axis=1).min() < 0.0005  # m


def test_a_shift_in_the_geometry_alone_loses_nothing(write_ifc):
    """Coordinates of 5e5 and 5e6 m in the placements, as some exporters write them: float64 to the end."""
    far = Box(corner_m=(456639.25, 5421033.5, 178.25))
    zero = {"Eastings": 0.0, "Northings": 0.0, "OrthogonalHeight": 0.0}
    building = load_ifc_building(write_ifc(Ifc(boxes=[far], conversion=zero, crs=CRS)), settings=IfcModelSettings())
    assert np.abs(building.vertices_site_m).max() < 100.0  # m: the origin went to the building
    corners = building.map_from_site(building.vertices_site_m)
    for corner in corners_of(far):
        assert np.linalg.norm(corners - corner, axis=1).min() < 0.001  # m


def test_the_origin_is_round_and_can_be_given(write_ifc):
    path = write_ifc(Ifc(conversion=CONVERSION, crs=CRS))
    moved = write_ifc(Ifc(conversion=CONVERSION | {"Eastings": 456639.75}, crs=CRS))
    building = load_ifc_building(path, settings=IfcModelSettings())
    assert load_ifc_building(moved, settings=IfcModelSettings()).origin == building.origin
    origin = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)
    given = load_ifc_building(path, settings=IfcModelSettings(origin=origin))
    assert given.origin == origin
    np.testing.assert_allclose(
        ecef(given.origin.geo_from_site(given.vertices_site_m)),
        ecef(building.origin.geo_from_site(building.vertices_site_m)),
        rtol=0,
        atol=1e-5,  # m
    )


def test_a_saved_building_reads_back_the_same(write_ifc, tmp_path):
    building = load_ifc_building(write_ifc(Ifc(conversion=CONVERSION, crs=CRS)), settings=IfcModelSettings())
    building.save(tmp_path)
    again = read_building(tmp_path)
    np.testing.assert_array_equal(again.vertices_site_m, building.vertices_site_m)
    np.testing.assert_array_equal(again.triangles, building.triangles)
    assert again.elements.equals(building.elements)
    assert (again.origin, again.map_crs, again.remarks) == (building.origin, building.map_crs, building.remarks)
    with pytest.raises(ModelError, match="delete the folder"):
        read_building(tmp_path / "nothing")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ellipsoidal", "ellipsoidal"),
        ("Ellipsoid GRS80", "ellipsoidal"),
        ("EPSG:5783", "EPSG:5783"),
        ("DHHN2016", "EPSG:7837"),
        ("NAVD88 height", "EPSG:5703"),
        ("5783", "EPSG:5783"),
    ],
)
def test_vertical_datums_by_name_and_code(text, expected):
    assert parse_vertical_datum(text) == expected


def test_a_compound_crs_falls_into_its_parts():
    assert split_crs("EPSG:25832+7837") == ("EPSG:25832", "EPSG:7837")
    assert split_crs("EPSG:5555") == ("EPSG:25832", "EPSG:5783")
    assert split_crs("EPSG:25832") == ("EPSG:25832", "")
    with pytest.raises(GeoreferenceError, match="not a vertical CRS"):
        parse_vertical_datum("EPSG:25832")
