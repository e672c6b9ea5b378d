"""Statements of an IFC that contradict one another: refused or told, never the first one taken in silence."""

import ifcopenshell
import ifcopenshell.api
import numpy as np
import pyproj
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model_georeference.length_units import LengthUnit
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.core.errors import FacadelakeError, GeoreferenceError, ModelError
from facadelake.core.proj.crs_parsing import find_ellipsoidal_heights, parse_vertical_datum
from tests.unit.building.conftest import Box, Ifc
from tests.unit.building.globe_by_hand import CONVERSION, CRS, ecef
from tests.unit.building.test_georeference_levels import axes, context_of, edited, set_north, site_at

BY_IFC = IfcModelSettings()
US_FOOT_M = 1200 / 3937
PLACED = Ifc(conversion=CONVERSION, crs=CRS, map_unit_metre=True)
LONG_ISLAND = {"Eastings": 987650.0, "Northings": 213000.0, "OrthogonalHeight": 30.0}  # ftUS of EPSG:6539


def refused(path, settings=BY_IFC):
    with pytest.raises(FacadelakeError) as caught:
        load_ifc_building(path, settings=settings)
    return str(caught.value)


def foot(model, name, factor, prefix=None):
    """An IfcConversionBasedUnit of length."""
    metre = model.create_entity("IfcSIUnit", None, "LENGTHUNIT", prefix, "METRE")
    measure = model.create_entity("IfcMeasureWithUnit", model.create_entity("IfcLengthMeasure", factor), metre)
    dimensions = model.create_entity("IfcDimensionalExponents", 1, 0, 0, 0, 0, 0, 0)
    return model.create_entity("IfcConversionBasedUnit", dimensions, "LENGTHUNIT", name, measure)


def with_map_unit(path, name, factor, prefix=None):
    def edit(model):
        model.by_type("IfcProjectedCRS")[0].MapUnit = foot(model, name, factor, prefix)

    return edited(path, edit)


def model_zero(building):
    """Where the model's zero is, in EPSG:4979: the lowest corner of the box nearest to it."""
    return building.origin.geo_from_site(building.vertices_site_m)


def assert_zero_is_at(building, east, north, height, crs):
    """The model's zero is where pyproj itself puts these coordinates (in the unit of the CRS)."""
    lon, lat = pyproj.Transformer.from_crs(crs, "EPSG:6318", always_xy=True).transform(east, north)
    found = ecef(model_zero(building))
    assert np.linalg.norm(found - ecef(np.array([[lon, lat, height]])), axis=1).min() < 0.002  # m


def test_map_unit_is_read_by_its_conversion_factor(write_ifc):
    """The name 'US SURVEY FOOT' was counted as 1 m."""
    ifc = Ifc(
        conversion=LONG_ISLAND | {"Scale": 1 / US_FOOT_M}, crs={"Name": "EPSG:6539", "VerticalDatum": "ellipsoidal"}
    )
    for name, factor, prefix in (
        ("US SURVEY FOOT", US_FOOT_M, None), ("foot_us", US_FOOT_M, None), ("FOOT", 1000 * US_FOOT_M, "MILLI"),
    ):  # fmt: skip
        building = load_ifc_building(with_map_unit(write_ifc(ifc), name, factor, prefix), settings=BY_IFC)
        assert_zero_is_at(building, 987650.0, 213000.0, 30 * US_FOOT_M, "EPSG:6539")


def test_international_feet_beside_a_crs_in_us_survey_feet_are_asked_for(write_ifc):
    ifc = Ifc(conversion=LONG_ISLAND | {"Scale": 1 / 0.3048}, crs={"Name": "EPSG:6539", "VerticalDatum": "ellipsoidal"})
    path = with_map_unit(write_ifc(ifc), "FOOT", 0.3048)
    message = refused(path)
    for part in ("MapUnit FOOT (0.3048 m)", "US survey foot (0.3048006096 m)", "0.60 m apart", "crs.map_unit"):
        assert part in message
    unit = LengthUnit(name="us_survey_foot", metres=US_FOOT_M)
    building = load_ifc_building(path, settings=IfcModelSettings(map_unit=unit))
    assert "us_survey_foot (0.3048006096 m) by crs.map_unit of the portfolio" in building.remarks
    assert_zero_is_at(building, 987650.0, 213000.0, 30 * US_FOOT_M, "EPSG:6539")


def test_a_map_unit_that_only_the_crs_contradicts_is_named(write_ifc):
    """Eastings in metres, MapUnit feet: read as stated, the building lies elsewhere."""
    message = refused(with_map_unit(write_ifc(PLACED), "FOOT", 0.3048))
    assert "read in MapUnit FOOT (0.3048 m), the model lies outside the area of use of EPSG:25832" in message
    assert "crs.map_unit in the portfolio (metre, centimetre, millimetre, inch, foot, us_survey_foot)" in message


def test_two_readings_in_the_area_of_use_are_asked_for(write_ifc):
    """Small coordinates of a small country: read as metres or as feet, both are in or near it."""
    conversion = {"Eastings": 76670.0, "Northings": 77179.0, "OrthogonalHeight": 290.0}
    ifc = Ifc(conversion=conversion, crs={"Name": "EPSG:2169", "VerticalDatum": "ellipsoidal"})
    message = refused(with_map_unit(write_ifc(ifc), "FOOT", 0.3048))
    assert "both lie in or near the area of use of EPSG:2169" in message and "crs.map_unit" in message


def test_a_name_and_a_factor_that_are_two_units_are_refused(write_ifc):
    assert "that name means 0.3048 m; correct one of them" in refused(with_map_unit(write_ifc(PLACED), "FOOT", 304.8))
    two = write_ifc(PLACED)

    def edit(model):
        units = model.by_type("IfcUnitAssignment")[0]
        units.Units = [*units.Units, model.create_entity("IfcSIUnit", None, "LENGTHUNIT", "MILLI", "METRE")]

    assert "states several length units (METRE (1 m), MILLIMETRE (0.001 m))" in refused(edited(two, edit))


@pytest.mark.parametrize(
    ("height", "unit"), [(178250.0, "millimetres (178.25 m)"), (-7000.0, "millimetres (-7.00 m)"), (1e9, "")]
)
def test_a_height_at_which_no_building_stands_is_refused(write_ifc, height, unit):
    path = write_ifc(Ifc(conversion=CONVERSION | {"OrthogonalHeight": height}, crs=CRS, map_unit_metre=True))
    message = refused(path)
    assert "where no building stands (limits -500 to 9,000 m)" in message
    assert unit in message


def test_doors_that_are_too_high_mean_a_wrong_unit(write_ifc):
    doors = [Box(size_m=(90.0, 5.0, 210.0), name="door", ifc_class="IfcDoor"), Box(size_m=(900.0, 30.0, 290.0))]
    message = refused(write_ifc(Ifc(boxes=doors, conversion=CONVERSION, crs=CRS)))
    assert "doors are 210 m high (median of 1; limits 1 to 25 m)" in message and "may be centimetres" in message
    low = [Box(size_m=(0.3, 0.03, 0.64), name="door", ifc_class="IfcDoor"), Box(size_m=(9.0, 0.1, 0.9))]
    assert "may be metres, not feet" in refused(write_ifc(Ifc(boxes=low, conversion=CONVERSION, crs=CRS)))


@pytest.mark.parametrize("scale", [0.99, 1.02])
def test_a_scale_that_changes_the_size_on_the_ground_is_refused(write_ifc, scale):
    message = refused(write_ifc(Ifc(conversion=CONVERSION | {"Scale": scale}, crs=CRS)))
    assert "the building would be" in message and "a metre on the ground is 0.999595 m on the map" in message


def test_web_mercator_without_its_scale_is_refused(write_ifc):
    """A metre on the ground is 1.52 m on that map: with Scale 1 the building would be two thirds of its size."""
    conversion = {"Eastings": 935950.0, "Northings": 6264700.0, "OrthogonalHeight": 178.0}
    message = refused(write_ifc(Ifc(conversion=conversion, crs=CRS | {"Name": "EPSG:3857"})))
    assert "would be 0.657" in message
    scaled = Ifc(conversion=conversion | {"Scale": 1.5224}, crs=CRS | {"Name": "EPSG:3857"})
    corners = ecef(model_zero(load_ifc_building(write_ifc(scaled), settings=BY_IFC)))
    diagonal = np.linalg.norm(corners[:, None] - corners[None], axis=2).max()
    assert abs(diagonal - np.linalg.norm((4.0, 0.3, 3.0))) < 0.02  # m: its size on the ground


@pytest.mark.parametrize(
    ("text", "is_stated"),
    [
        ("heights are ellipsoidal", True),
        ("ETRS89 / UTM zone 32N; heights are ellipsoidal (GRS80)", True),
        ("UTM 32, ellipsoidal heights", True),
        ("ETRS89, ellipsoid GRS80, heights: ellipsoidal", True),
        ("ETRS89 / UTM zone 32N, reference ellipsoid GRS80, heights DHHN92", False),
        ("heights are not ellipsoidal", False),
        ("heights are ellipsoidal, DHHN92", False),
        ("ellipsoidal heights, reduced to the geoid", False),
        ("heights: ellipsoidal (GRS80), then converted to NHN", False),
        ("ellipsoidal heights, NHN", False),
        ("Ellipsoid GRS80", False),
        ("", False),
    ],
)
def test_a_description_states_heights_or_nothing(text, is_stated):
    assert find_ellipsoidal_heights(text) == ("ellipsoidal" if is_stated else "")


@pytest.mark.parametrize("text", ["not ellipsoidal", "reference ellipsoid GRS80, heights DHHN92", "Bessel ellipsoid"])
def test_a_vertical_datum_that_only_mentions_an_ellipsoid_is_not_one(text):
    with pytest.raises(GeoreferenceError, match="no single vertical CRS"):
        parse_vertical_datum(text)


def test_a_description_that_is_not_used_is_named(write_ifc):
    crs = {"Name": "EPSG:25832", "Description": "reference ellipsoid GRS80, heights DHHN92"}
    message = refused(write_ifc(Ifc(conversion=CONVERSION, crs=crs)))
    assert "its description 'reference ellipsoid GRS80, heights DHHN92' is not used" in message


def test_vertical_datums_of_one_source_that_differ_are_refused(write_ifc):
    path = write_ifc(Ifc(conversion=CONVERSION, crs={"Name": "EPSG:25832+7837", "VerticalDatum": "DHHN92"}))
    assert "CRS EPSG:25832+7837 (EPSG:7837); VerticalDatum DHHN92 (EPSG:5783)" in refused(path)
    both = IfcModelSettings(map_crs="EPSG:25832+7837", vertical_datum="ellipsoidal")
    assert "the portfolio states different vertical datums" in refused(write_ifc(PLACED), both)


def test_what_the_portfolio_replaces_is_told(write_ifc):
    path = write_ifc(Ifc(conversion=CONVERSION, crs={"Name": "EPSG:25832", "VerticalDatum": "DHHN92"}))
    settings = IfcModelSettings(map_crs="EPSG:32632", vertical_datum="ellipsoidal")
    remarks = load_ifc_building(path, settings=settings).remarks
    assert "the IFC names the CRS EPSG:25832; EPSG:32632 of the portfolio was used" in remarks
    assert "the IFC's heights are EPSG:5783; ellipsoidal of the portfolio was used" in remarks


def another_conversion(model):
    crs = model.create_entity("IfcProjectedCRS", Name="EPSG:25833", VerticalDatum="ellipsoidal")
    model.create_entity("IfcMapConversion", SourceCRS=context_of(model), TargetCRS=crs, **CONVERSION)


def another_crs(model):
    model.remove(model.by_type("IfcMapConversion")[0])
    model.create_entity("IfcProjectedCRS", Name="EPSG:25833", VerticalDatum="ellipsoidal")


def another_shift(model):
    pset = ifcopenshell.api.run("pset.add_pset", model, product=model.by_type("IfcSite")[0], name="ePSet_MapConversion")
    values = {name: CONVERSION[name] for name in ("Eastings", "Northings", "OrthogonalHeight")}
    ifcopenshell.api.run("pset.edit_pset", model, pset=pset, properties=values | {"Eastings": 456640.25})


def another_zone(model):
    model.by_type("IfcProjectedCRS")[0].MapZone = "33"


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (another_conversion, "the IFC states 2 different coordinate operations: IfcMapConversion to EPSG:25832"),
        (another_crs, "the IFC states 2 different coordinate reference systems: EPSG:25832"),
        (another_shift, "ePSet_MapConversion (456640.25, 5421033.5, 178.25); remove the wrong one"),
        (another_zone, "the IFC's CRS is EPSG:25832 (ETRS89 / UTM zone 32N), but its MapZone is '33'"),
    ],
)
def test_two_statements_of_one_thing_are_refused_and_the_portfolio_replaces_them(write_ifc, edit, message):
    path = edited(write_ifc(PLACED), edit)
    assert message in refused(path)
    settings = IfcModelSettings(
        map_crs="EPSG:25832",
        vertical_datum="ellipsoidal",
        placement=MapPlacement(east_m=456639.25, north_m=5421033.5, height_m=178.25, rotation_deg=30.0),
    )
    assert load_ifc_building(path, settings=settings).georeference_level == "registry"


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"XAxisAbscissa": 0.0, "XAxisOrdinate": 0.0}, "which is no direction"),
        ({"XAxisAbscissa": 1.0}, "XAxisOrdinate None, which is no direction"),
        ({"Scale": 0.0}, "has Scale 0; it must be more than 0"),
    ],
)
def test_an_axis_or_scale_that_means_nothing_is_not_replaced_by_the_default(write_ifc, attributes, message):
    conversion = {"Eastings": 456639.25, "Northings": 5421033.5, "OrthogonalHeight": 178.25} | attributes
    assert message in refused(write_ifc(Ifc(conversion=conversion, crs=CRS)))


def other_norths(model):
    """A second context, as of an IFC merged from two, with another true north."""
    context = model.create_entity("IfcGeometricRepresentationContext", ContextType="Model")
    context.CoordinateSpaceDimension = 3
    context.WorldCoordinateSystem = axes(model, (0.0, 0.0, 0.0))
    context.TrueNorth = model.create_entity("IfcDirection", (0.5, 0.8))


def test_contexts_with_different_true_norths(write_ifc):
    """Told where TrueNorth is not used, refused where the model is turned by it."""

    def edit(model):
        set_north(model, 0.5, np.sqrt(0.75))
        other_norths(model)

    remark = "the IFC's contexts state different TrueNorth (-30.000, -32.005 deg from the y axis)"
    assert remark in load_ifc_building(edited(write_ifc(PLACED), edit), settings=BY_IFC).remarks
    path = edited(write_ifc(Ifc()), site_at((48, 56, 25, 800000), (8, 24, 28, 80000), 178.25))
    settings = IfcModelSettings(vertical_datum="ellipsoidal", accept_level=20)
    assert load_ifc_building(path, settings=settings).georeference_level == "20"
    assert "and the model is placed by it (LoGeoRef 20)" in refused(edited(path, other_norths), settings)


def rigid_operation(first_deg, second_deg, crs):
    def edit(model):
        radian = model.create_entity("IfcSIUnit", None, "PLANEANGLEUNIT", None, "RADIAN")
        model.by_type("IfcUnitAssignment")[0].Units = [*model.by_type("IfcUnitAssignment")[0].Units, radian]
        model.create_entity(
            "IfcRigidOperation", SourceCRS=context_of(model),
            TargetCRS=model.create_entity("IfcGeographicCRS", Name=crs),
            FirstCoordinate=model.create_entity("IfcPlaneAngleMeasure", float(np.radians(first_deg))),
            SecondCoordinate=model.create_entity("IfcPlaneAngleMeasure", float(np.radians(second_deg))), Height=178.0,
        )  # fmt: skip

    return edit


def test_latitude_and_longitude_exchanged_are_named(write_ifc):
    """EPSG:4258 is of Europe: 14.09, 46.36 in its axis order is in Arabia."""
    settings = IfcModelSettings(vertical_datum="ellipsoidal")
    path = edited(write_ifc(Ifc(schema="IFC4X3")), rigid_operation(14.09, 46.36, "EPSG:4258"))
    message = refused(path, settings)
    assert "IfcRigidOperation gives 14.090000 and 46.360000 degrees, latitude first by the axis order" in message
    assert "exchanged (14.09, 46.36) it would lie in it" in message
    right = edited(write_ifc(Ifc(schema="IFC4X3")), rigid_operation(46.36, 14.09, "EPSG:4258"))
    building = load_ifc_building(right, settings=settings)
    found = ecef(model_zero(building)) - ecef(np.array([[14.09, 46.36, 178.0]]))
    assert np.linalg.norm(found, axis=1).min() < 0.002  # m


def test_exchanged_where_the_crs_is_of_the_world_are_told_by_ifc_site(write_ifc):
    settings = IfcModelSettings(vertical_datum="ellipsoidal")
    path = edited(write_ifc(Ifc(schema="IFC4X3")), rigid_operation(14.09, 46.36, "EPSG:4326"))
    site = site_at((46, 21, 36, 0), (14, 5, 24, 0), 178.0)
    assert "and would lie there with the two exchanged" in refused(edited(path, site), settings)


def test_a_map_conversion_to_a_geographic_crs_is_refused_whatever_the_portfolio_says(write_ifc):
    conversion = {"Eastings": 14.09, "Northings": 46.36, "OrthogonalHeight": 178.0}
    path = write_ifc(Ifc(conversion=conversion, crs=CRS | {"Name": "EPSG:4258"}))
    for settings in (BY_IFC, IfcModelSettings(map_crs="EPSG:2169", vertical_datum="ellipsoidal")):
        assert "IfcMapConversion has the target CRS 'EPSG:4258' (ETRS89), whose coordinates are degrees" in refused(
            path, settings
        )


def test_a_site_elsewhere_is_told(write_ifc):
    path = edited(write_ifc(PLACED), site_at((42, 21, 31, 181945), (-71, -3, -24, -263305), 0.0))
    remarks = load_ifc_building(path, settings=BY_IFC).remarks
    assert "latitude 42.358662 and longitude -71.056740 of IfcSite lie 5,9" in remarks


@pytest.mark.parametrize("angle", [(48, -56, -25), (48, 61, 0), (48, 56, 25, 2_000_000)])
def test_an_angle_that_is_none_is_not_a_position(write_ifc, angle):
    path = edited(write_ifc(Ifc()), site_at(angle, (8, 24, 28), 178.0))
    settings = IfcModelSettings(map_crs="EPSG:25832", vertical_datum="ellipsoidal", accept_level=20)
    assert "which is not degrees, minutes, seconds" in refused(path, settings)


def test_one_global_id_of_two_walls(write_ifc):
    """The one vanished, and its facade with it."""
    boxes = [Box(size_m=(10.0, 0.3, 3.0), name="south"), Box(size_m=(10.0, 0.3, 3.0), corner_m=(0, 8, 0), name="north")]
    path = write_ifc(Ifc(boxes=boxes, conversion=CONVERSION, crs=CRS))

    def edit(model):
        first, second = model.by_type("IfcWall")
        second.GlobalId = first.GlobalId

    before = load_ifc_building(path, settings=BY_IFC).elements.to_pylist()
    building = load_ifc_building(edited(path, edit), settings=BY_IFC)
    rows = {row["element_name"]: row for row in building.elements.to_pylist()}
    assert {name: row["facade"] for name, row in rows.items()} == {r["element_name"]: r["facade"] for r in before}
    guids = [row["element_guid"] for row in rows.values()]
    walls = ifcopenshell.open(path).by_type("IfcWall")
    assert sorted(guids) == sorted(f"{walls[0].GlobalId}#{wall.id()}" for wall in walls)
    assert "2 elements have no GlobalId or that of another element" in building.remarks


def test_a_door_of_a_wall_with_a_shared_global_id_keeps_its_wall(write_ifc):
    path = write_ifc(Ifc(boxes=[Box(name="a"), Box(name="b", corner_m=(0, 8, 0))], conversion=CONVERSION, crs=CRS))

    def edit(model):
        first, second = model.by_type("IfcWall")
        model.create_entity(
            "IfcRelAggregates", GlobalId=ifcopenshell.guid.new(), RelatingObject=first, RelatedObjects=[second]
        )
        second.GlobalId = first.GlobalId

    rows = {r["element_name"]: r for r in load_ifc_building(edited(path, edit), settings=BY_IFC).elements.to_pylist()}
    assert rows["b"]["host_guid"] == rows["a"]["element_guid"]


def test_buildings_and_storeys_of_one_name_are_told_apart(write_ifc):
    path = write_ifc(
        Ifc(
            boxes=[Box(name="ours", size_m=(8.0, 0.3, 7.0)), Box(name="theirs", corner_m=(30, 0, 0), contained=False)],
            conversion=CONVERSION,
            crs=CRS,
        )
    )

    def edit(model):
        building = ifcopenshell.api.run("root.create_entity", model, ifc_class="IfcBuilding", name="building")
        building.GlobalId = "3zzzzzzzzzzzzzzzzzzzzz"  # the last in order
        storeys = [
            ifcopenshell.api.run("root.create_entity", model, ifc_class="IfcBuildingStorey", name=name)
            for name in ("Ground floor", "Loft", "Loft")
        ]
        for storey, level in zip(storeys, (1.0, 4.0, 6.0), strict=True):
            matrix = np.eye(4)
            matrix[2, 3] = level
            ifcopenshell.api.run("geometry.edit_object_placement", model, product=storey, matrix=matrix)
        run = ifcopenshell.api.run
        run("aggregate.assign_object", model, products=[building], relating_object=model.by_type("IfcSite")[0])
        run("aggregate.assign_object", model, products=storeys, relating_object=building)
        theirs = next(wall for wall in model.by_type("IfcWall") if wall.Name == "theirs")
        run("spatial.assign_container", model, products=[theirs], relating_structure=storeys[0])

    building = load_ifc_building(edited(path, edit), settings=BY_IFC)
    rows = {row["element_name"]: (row["ifc_building"], row["storey"]) for row in building.elements.to_pylist()}
    assert rows == {
        "ours": ("building (1)", "Ground floor, building (1)"),
        "theirs": ("building (2)", "Ground floor, building (2)"),
    }  # fmt: skip
    assert [storey.name for storey in building.storeys] == [
        "Ground floor, building (1)", "Ground floor, building (2)", "First floor", "Loft (1)", "Loft (2)",
    ]  # fmt: skip
    assert "'building (2)' (3zzzzzzzzzzzzzzzzzzzzz)" in building.remarks
    ours = load_ifc_building(path, settings=IfcModelSettings(building="building (1)"))
    assert ours.elements.column("storey").to_pylist() == ["Ground floor"]
    with pytest.raises(ModelError, match="matches 2 of the IFC's buildings"):
        load_ifc_building(path, settings=IfcModelSettings(building="building"))
