"""Every way an IFC states its georeference, its level, and what is refused, against positions computed by hand."""

import ifcopenshell
import ifcopenshell.api
import ifcopenshell.api.owner.settings
import numpy as np
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.core.errors import GeoreferenceError
from tests.unit.building.conftest import Box, Ifc
from tests.unit.building.globe_by_hand import (
    CONVERSION,
    CRS,
    assert_same_places,
    corners_of,
    expected_geo,
    geo_of_east_north_up,
)

REGISTRY = IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal")
EAST, NORTH, HEIGHT = 456639.25, 5421033.5, 178.25
LON, LAT = 8.4078, 48.9405


def edited(path, edit):
    """The IFC at ``path``, changed by ``edit``."""
    model = ifcopenshell.open(path)
    edit(model)
    model.write(str(path))
    return path


def context_of(model):
    return model.by_type("IfcGeometricRepresentationContext", include_subtypes=False)[0]


def axes(model, place, x_axis=None):
    """An IfcAxis2Placement3D at ``place``, its x axis turned to ``x_axis``."""
    point = model.create_entity("IfcCartesianPoint", tuple(map(float, place)))
    if x_axis is None:
        return model.create_entity("IfcAxis2Placement3D", point)
    up = model.create_entity("IfcDirection", (0.0, 0.0, 1.0))
    return model.create_entity("IfcAxis2Placement3D", point, up, model.create_entity("IfcDirection", x_axis))


def set_north(model, x, y):
    context_of(model).TrueNorth = model.create_entity("IfcDirection", (float(x), float(y)))


def with_operation(path, kind, **attributes):
    """The IFC4.3 at ``path`` with an operation of ``kind`` to EPSG:25832."""

    def edit(model):
        crs = model.create_entity("IfcProjectedCRS", **CRS)
        model.create_entity(kind, SourceCRS=context_of(model), TargetCRS=crs, **attributes)

    return edited(path, edit)


def turned_corners(box, angle_deg):
    """East, north, up of a box's corners where the model's x axis is ``angle_deg`` anticlockwise from east."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    x, y, z = corners_of(box).T
    return np.column_stack([c * x - s * y, s * x + c * y, z])


@pytest.mark.parametrize("schema", ["IFC2X3", "IFC4", "IFC4X3"])
def test_the_registry_places_every_schema(write_ifc, schema):
    settings = IfcModelSettings(
        map_crs="EPSG:25832",
        vertical_datum="ellipsoidal",
        placement=MapPlacement(east_m=EAST, north_m=NORTH, height_m=HEIGHT, rotation_deg=30.0),
    )
    building = load_ifc_building(write_ifc(Ifc(schema=schema, milli=True)), settings=settings)
    assert_same_places(building, expected_geo(corners_of(Box())))


def test_map_conversion_scaled_stretches_by_its_factors(write_ifc):
    box = Box(size_m=(50.0, 0.3, 80.0))
    path = with_operation(
        write_ifc(Ifc(schema="IFC4X3", boxes=[box], milli=True)), "IfcMapConversionScaled",
        **CONVERSION, Scale=0.001, FactorX=0.9996, FactorY=0.9996, FactorZ=1.0,
    )  # fmt: skip
    building = load_ifc_building(path, settings=IfcModelSettings())
    assert building.georeference_level == "50"
    assert "factors along x, y, z are 0.999600, 0.999600, 1.000000" in building.remarks
    assert_same_places(building, expected_geo(corners_of(box), factor=0.9996))


@pytest.mark.parametrize("milli", [False, True])
def test_rigid_operation_shifts_and_does_not_rotate(write_ifc, milli):
    path = write_ifc(Ifc(schema="IFC4X3", milli=milli))
    model = ifcopenshell.open(path)
    metre = model.create_entity("IfcSIUnit", None, "LENGTHUNIT", None, "METRE")
    crs = model.create_entity("IfcProjectedCRS", Name=CRS["Name"], Description=CRS["Description"], MapUnit=metre)
    model.create_entity(
        "IfcRigidOperation", SourceCRS=context_of(model), TargetCRS=crs,
        FirstCoordinate=model.create_entity("IfcLengthMeasure", EAST),
        SecondCoordinate=model.create_entity("IfcLengthMeasure", NORTH), Height=HEIGHT,
    )  # fmt: skip
    model.write(str(path))
    building = load_ifc_building(path, settings=IfcModelSettings())
    assert (building.georeference_level, building.remarks) == ("50", "")
    found = building.map_from_site(building.vertices_site_m)
    for corner in np.add(corners_of(Box()), (EAST, NORTH, HEIGHT)):
        assert np.linalg.norm(found - corner, axis=1).min() < 0.0005  # m


def test_rigid_operation_in_degrees_is_upright_in_metres_on_the_ground(write_ifc):
    path = write_ifc(Ifc(schema="IFC4X3"))

    def edit(model):
        degree = model.create_entity("IfcSIUnit", None, "PLANEANGLEUNIT", None, "RADIAN")
        model.by_type("IfcUnitAssignment")[0].Units = [*model.by_type("IfcUnitAssignment")[0].Units, degree]
        crs = model.create_entity("IfcGeographicCRS", Name="EPSG:4326")
        model.create_entity(
            "IfcRigidOperation", SourceCRS=context_of(model), TargetCRS=crs,
            FirstCoordinate=model.create_entity("IfcPlaneAngleMeasure", float(np.radians(LAT))),
            SecondCoordinate=model.create_entity("IfcPlaneAngleMeasure", float(np.radians(LON))), Height=HEIGHT,
        )  # fmt: skip
        set_north(model, np.sin(np.radians(20)), np.cos(np.radians(20)))

    building = load_ifc_building(edited(path, edit), settings=IfcModelSettings(vertical_datum="ellipsoidal"))
    assert (building.georeference_level, building.map_crs) == ("50", "EPSG:32632")
    assert "latitude first" in building.remarks
    # True north is 20 degrees clockwise from the model's y axis, so its x axis points 20 degrees north of east.
    assert_same_places(building, geo_of_east_north_up(LON, LAT, HEIGHT, turned_corners(Box(), 20.0)))


@pytest.mark.parametrize("where", ["site", "geometry"])
def test_level_30_map_coordinates_in_a_placement_or_in_the_geometry(write_ifc, where):
    """A wall of 4.001 m at 5e6 m keeps its millimetre."""
    size = (4.001, 0.3, 3.0)
    far = (EAST, NORTH, HEIGHT)
    if where == "geometry":
        path = write_ifc(Ifc(boxes=[Box(size_m=size)]))

        def edit(model):
            solid = model.by_type("IfcExtrudedAreaSolid")[0]
            solid.Position = axes(model, far)
    else:
        path = write_ifc(Ifc(boxes=[Box(size_m=size)], milli=True))

        def edit(model):
            wall = model.by_type("IfcWall")[0]
            site = model.by_type("IfcSite")[0]
            site.ObjectPlacement = model.create_entity("IfcLocalPlacement", None, axes(model, np.multiply(far, 1000.0)))
            wall.ObjectPlacement = model.create_entity(
                "IfcLocalPlacement", site.ObjectPlacement, axes(model, (0, 0, 0))
            )

    building = load_ifc_building(edited(path, edit), settings=REGISTRY)
    assert building.georeference_level == "30"
    assert "taken as coordinates of EPSG:25832" in building.remarks
    found = building.map_from_site(building.vertices_site_m)
    for corner in corners_of(Box(size_m=size)) + far:
        assert np.linalg.norm(found - corner, axis=1).min() < 0.0002  # m


def test_coordinates_near_zero_are_not_the_maps(write_ifc):
    with pytest.raises(GeoreferenceError, match="is not georeferenced"):
        load_ifc_building(write_ifc(Ifc(boxes=[Box(corner_m=(900.0, 500.0, 0.0))])), settings=REGISTRY)


def test_level_40_by_the_world_coordinate_system(write_ifc):
    def shifted(model):
        context_of(model).WorldCoordinateSystem = axes(model, (EAST, NORTH, HEIGHT), (np.cos(0.5), np.sin(0.5), 0.0))

    building = load_ifc_building(edited(write_ifc(Ifc()), shifted), settings=REGISTRY)
    assert building.georeference_level == "40"
    found = building.map_from_site(building.vertices_site_m)
    for corner in np.add(turned_corners(Box(), np.degrees(0.5)), (EAST, NORTH, HEIGHT)):
        assert np.linalg.norm(found - corner, axis=1).min() < 0.0005  # m


def test_level_40_turned_by_true_north_is_coarse(write_ifc):
    """Grid north is 0.45 degrees from true north there, and the IFC does not state which one TrueNorth is."""

    def edit(model):
        context_of(model).WorldCoordinateSystem = axes(model, (EAST, NORTH, HEIGHT))
        set_north(model, -np.sin(0.5), np.cos(0.5))

    path = edited(write_ifc(Ifc()), edit)
    with pytest.raises(GeoreferenceError, match=r"LoGeoRef 40: .*accept_level: 40"):
        load_ifc_building(path, settings=REGISTRY)
    accepted = IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", accept_level=40)
    building = load_ifc_building(path, settings=accepted)
    found = building.map_from_site(building.vertices_site_m)
    for corner in np.add(turned_corners(Box(), -np.degrees(0.5)), (EAST, NORTH, HEIGHT)):
        assert np.linalg.norm(found - corner, axis=1).min() < 0.0005  # m
    assert "0.45 deg" in building.remarks


def site_at(latitude, longitude, elevation):
    """An edit that gives IfcSite its RefLatitude, RefLongitude, RefElevation, and TrueNorth 35 degrees to the left."""

    def edit(model):
        site = model.by_type("IfcSite")[0]
        site.RefLatitude, site.RefLongitude, site.RefElevation = latitude, longitude, elevation
        set_north(model, -np.sin(np.radians(35)), np.cos(np.radians(35)))

    return edit


@pytest.mark.parametrize("schema", ["IFC2X3", "IFC4", "IFC4X3"])
def test_level_20_is_refused_unless_it_is_accepted_by_name(write_ifc, schema):
    here = site_at((48, 56, 25, 800000), (8, 24, 28, 80000), HEIGHT)
    path = edited(write_ifc(Ifc(schema=schema)), here)
    with pytest.raises(GeoreferenceError, match=r"LoGeoRef 20.*crs.accept_level: 20 would accept them.*crs\.map"):
        load_ifc_building(path, settings=IfcModelSettings(vertical_datum="ellipsoidal"))
    with pytest.raises(GeoreferenceError, match=r"its sigma is 10 m, above the limit of 0.05 m.*crs\.control"):
        load_ifc_building(path, settings=REGISTRY)
    building = load_ifc_building(path, settings=IfcModelSettings(vertical_datum="ellipsoidal", accept_level=20))
    assert (building.georeference_level, building.map_crs) == ("20", "EPSG:32632")
    assert "accuracy about 10 m, one sigma" in building.remarks
    lon, lat = 8 + 24 / 60 + 28.08 / 3600, 48 + 56 / 60 + 25.8 / 3600
    # True north is 35 degrees anticlockwise of the model's y axis, so its x axis points 35 degrees south of east.
    assert_same_places(building, geo_of_east_north_up(lon, lat, HEIGHT, turned_corners(Box(), -35.0)))


@pytest.mark.parametrize(
    ("latitude", "longitude", "lon", "lat", "sigma"),
    [
        ((-33, -51, -31), (151, 12, 50), 151 + 12 / 60 + 50 / 3600, -(33 + 51 / 60 + 31 / 3600), "accuracy about 10 m"),
        ((42, 21, 0), (-71, -3, 0), -(71 + 3 / 60), 42 + 21 / 60, "accuracy about 537 m"),
    ],
)
def test_level_20_south_west_and_what_rounding_leaves(write_ifc, latitude, longitude, lon, lat, sigma):
    path = edited(write_ifc(Ifc()), site_at(latitude, longitude, 12.5))
    building = load_ifc_building(path, settings=IfcModelSettings(vertical_datum="ellipsoidal", accept_level=20))
    assert sigma in building.remarks
    assert_same_places(building, geo_of_east_north_up(lon, lat, 12.5, turned_corners(Box(), -35.0)))


def test_a_site_on_another_continent_is_not_forced_into_the_registrys_crs(write_ifc):
    """An authoring tool's own default, Boston, beside a registry that says UTM zone 32."""
    path = edited(write_ifc(Ifc()), site_at((42, 21, 31, 181945), (-71, -3, -24, -263305), 0.0))
    with pytest.raises(
        GeoreferenceError, match=r"is not georeferenced.*only IfcSite latitude and longitude, LoGeoRef 20"
    ):
        load_ifc_building(path, settings=REGISTRY)


def test_a_world_coordinate_system_beside_the_registrys_placement_is_reported(write_ifc):
    def edit(model):
        context_of(model).WorldCoordinateSystem = axes(model, (100.0, 0.0, 0.0))

    placement = MapPlacement(east_m=EAST, north_m=NORTH, height_m=HEIGHT, rotation_deg=30.0)
    settings = IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", placement=placement)
    building = load_ifc_building(edited(write_ifc(Ifc()), edit), settings=settings)
    assert "WorldCoordinateSystem is shifted or rotated and was not used" in building.remarks
    assert_same_places(building, expected_geo(corners_of(Box())))


def test_an_address_is_not_a_position(write_ifc):
    def edit(model):
        model.by_type("IfcBuilding")[0].BuildingAddress = model.create_entity("IfcPostalAddress", Town="Ettlingen")

    with pytest.raises(GeoreferenceError, match="its address, LoGeoRef 10, is not a position"):
        load_ifc_building(edited(write_ifc(Ifc()), edit), settings=IfcModelSettings())


def test_a_shift_in_geometry_and_conversion_is_detected_where_both_are_in_the_area_of_use(write_ifc):
    """Luxembourg's coordinates are small: twice the shift is still near the country."""
    conversion = {"Eastings": 76670.0, "Northings": 77179.0, "OrthogonalHeight": 290.0}
    crs = {"Name": "EPSG:2169", "VerticalDatum": "ellipsoidal"}
    path = write_ifc(Ifc(boxes=[Box(corner_m=(76670.0, 77179.0, 290.0))], conversion=conversion, crs=crs))
    with pytest.raises(
        GeoreferenceError, match=r"shifted to the map twice.*crs\.placement in the portfolio to \{east_m: 0"
    ):
        load_ifc_building(path, settings=IfcModelSettings())
    zero = MapPlacement(east_m=0.0, north_m=0.0, height_m=0.0)
    remedied = load_ifc_building(path, settings=IfcModelSettings(placement=zero))
    found = remedied.map_from_site(remedied.vertices_site_m)
    # PROJ's seven-parameter shift of EPSG:2169 there and back leaves 2 mm.
    assert np.linalg.norm(found - [76670.0, 77179.0, 290.0], axis=1).min() < 0.005  # m


@pytest.mark.parametrize(
    ("x", "y", "conflict"),
    [
        (np.sin(np.radians(30)), np.cos(np.radians(30)), ""),  # the conversion's turn: grid north
        (np.sin(np.radians(30.45)), np.cos(np.radians(30.45)), ""),  # true north, 0.45 degrees to the right there
        (0.0, 1.0, "differs by 30.45 deg from true north and was not used"),
    ],
)
def test_a_true_north_that_contradicts_the_conversion_is_reported(write_ifc, x, y, conflict):
    path = edited(write_ifc(Ifc(conversion=CONVERSION, crs=CRS)), lambda model: set_north(model, x, y))
    building = load_ifc_building(path, settings=IfcModelSettings())
    assert conflict in building.remarks
    assert bool(conflict) == bool(building.remarks)
    assert_same_places(building, expected_geo(corners_of(Box())))


@pytest.mark.parametrize(("schema", "scale"), [("IFC4", 0.3048), ("IFC4X3", 25.4)])
def test_a_scale_that_is_a_wrong_unit_is_refused(write_ifc, schema, scale):
    path = write_ifc(Ifc(schema=schema, conversion=CONVERSION | {"Scale": scale}, crs=CRS))
    with pytest.raises(GeoreferenceError, match=rf"IfcMapConversion has Scale {scale}.*a unit is wrong"):
        load_ifc_building(path, settings=IfcModelSettings())


@pytest.mark.parametrize(
    ("conversion", "crs", "message"),
    [
        ({"Eastings": "456639,25"}, {}, "Eastings is '456639,25', not a number"),
        ({}, {"MapUnit": "rod"}, "MapUnit is 'rod'; known units are"),
    ],
)
def test_ifc2x3_property_sets_with_bad_values(write_ifc, monkeypatch, conversion, crs, message):
    path = write_ifc(Ifc(schema="IFC2X3"))
    model = ifcopenshell.open(path)
    user, tool = model.by_type("IfcPersonAndOrganization")[0], model.by_type("IfcApplication")[0]
    monkeypatch.setattr(ifcopenshell.api.owner.settings, "get_user", lambda file: user)
    monkeypatch.setattr(ifcopenshell.api.owner.settings, "get_application", lambda file: tool)
    sets = {
        "ePSet_MapConversion": CONVERSION | conversion,
        "ePSet_ProjectedCRS": {"Name": "EPSG:25832", "VerticalDatum": "ellipsoidal"} | crs,
    }
    for name, properties in sets.items():
        pset = ifcopenshell.api.run("pset.add_pset", model, product=model.by_type("IfcProject")[0], name=name)
        ifcopenshell.api.run("pset.edit_pset", model, pset=pset, properties=properties)
    model.write(str(path))
    with pytest.raises(GeoreferenceError, match=message):
        load_ifc_building(path, settings=IfcModelSettings())
