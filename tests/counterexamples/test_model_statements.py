"""Building models whose statements contradict one another, or cannot be: the whole message of each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import ifcopenshell
import numpy as np
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.core.errors import FacadelakeError
from tests.unit.building.conftest import Box, Ifc
from tests.unit.building.test_contradictions import (
    LONG_ISLAND,
    another_conversion,
    another_shift,
    another_zone,
    rigid_operation,
    with_map_unit,
)
from tests.unit.building.test_georeference_levels import edited

WriteIfc = Callable[[Ifc], Path]
Change = Callable[[Path], Path]
CONVERSION = {"Eastings": 456639.25, "Northings": 5421033.5, "OrthogonalHeight": 178.25}
CRS = {"Name": "EPSG:25832", "VerticalDatum": "ellipsoidal"}
PLACED = Ifc(crs=CRS, conversion=CONVERSION, map_unit_metre=True)
IN_FEET = Ifc(crs={"Name": "EPSG:6539", "VerticalDatum": "ellipsoidal"}, conversion=LONG_ISLAND | {"Scale": 1 / 0.3048})
DOOR = Box(size_m=(90.0, 5.0, 210.0), name="door", ifc_class="IfcDoor")
ELLIPSOIDAL = IfcModelSettings(vertical_datum="ellipsoidal")


def unchanged(path: Path) -> Path:
    return path


def in_international_feet(path: Path) -> Path:
    return with_map_unit(path, "FOOT", 0.3048)


@pytest.mark.parametrize(
    ("ifc", "change", "message"),
    [
        (
            Ifc(crs=CRS, conversion=CONVERSION | {"OrthogonalHeight": 178250.0}, map_unit_metre=True),
            unchanged,
            "the model's lowest point is at height 178,250.0 m (its origin at 178,250.0 m), where no building stands "
            "(limits -500 to 9,000 m); in millimetres (178.25 m) it would be possible; correct OrthogonalHeight, the "
            "elevation or its unit in the model, or set crs.placement in the portfolio",
        ),
        (
            Ifc(crs=CRS, conversion=CONVERSION | {"Scale": 1.02}),
            unchanged,
            "the model's scale is 1.020000 map metres per metre, but a metre on the ground is 0.999595 m on the map of "
            "EPSG:25832 here: the building would be 1.0204 times its size (limit 0.5%); correct Scale in the IFC or "
            "crs.map, or set crs.control in the portfolio, which keeps the size",
        ),
        (
            Ifc(crs=CRS, conversion=CONVERSION, boxes=[DOOR, Box(size_m=(900.0, 30.0, 290.0))]),
            unchanged,
            "the model's doors are 210 m high (median of 1; limits 1 to 25 m), so its length unit (IfcUnitAssignment) "
            "is wrong; it may be centimetres: correct it, or export the model again",
        ),
        (
            PLACED,
            in_international_feet,
            "read in MapUnit FOOT (0.3048 m), the model lies outside the area of use of EPSG:25832 (Europe between 6°E "
            "and 12°E), read in the unit of EPSG:25832, metre (1 m), it lies in it; correct MapUnit in the IFC, or set "
            "crs.map_unit in the portfolio (metre, centimetre, millimetre, inch, foot, us_survey_foot)",
        ),
        (
            IN_FEET,
            in_international_feet,
            "the model's georeference is LoGeoRef 50: MapUnit FOOT (0.3048 m) is not the unit of EPSG:6539, US survey "
            "foot (0.3048006096 m), and the two are 0.60 m apart here; correct MapUnit, or set crs.map_unit in the "
            "portfolio (foot or us_survey_foot); its sigma is 0.6 m, above the limit of 0.05 m for registering defects "
            "on it",
        ),
        (
            Ifc(
                crs={"Name": "EPSG:25832", "Description": "reference ellipsoid GRS80, heights DHHN92"},
                conversion=CONVERSION,
            ),
            unchanged,
            "neither the IFC nor the portfolio states the vertical datum of the model's heights (CRS EPSG:25832; its "
            "description 'reference ellipsoid GRS80, heights DHHN92' is not used); set crs.vertical in the portfolio: "
            "'ellipsoidal', or a vertical CRS such as EPSG:7837 (DHHN2016)",
        ),
        (
            Ifc(crs={"Name": "EPSG:25832+7837", "VerticalDatum": "DHHN92"}, conversion=CONVERSION),
            unchanged,
            "the IFC states different vertical datums: CRS EPSG:25832+7837 (EPSG:7837); VerticalDatum DHHN92 "
            "(EPSG:5783); correct all but one, or set crs.map and crs.vertical in the portfolio",
        ),
        (
            PLACED,
            lambda path: edited(path, another_zone),
            "the IFC's CRS is EPSG:25832 (ETRS89 / UTM zone 32N), but its MapZone is '33'; correct one of them, or set "
            "crs.map in the portfolio",
        ),
        (
            PLACED,
            lambda path: edited(path, another_shift),
            "IfcMapConversion gives east, north, height (456639.25, 5421033.5, 178.25), ePSet_MapConversion "
            "(456640.25, 5421033.5, 178.25); remove the wrong one, or set crs.placement in the portfolio",
        ),
        (
            Ifc(crs=CRS | {"Name": "EPSG:4258"}, conversion=CONVERSION | {"Eastings": 14.09, "Northings": 46.36}),
            unchanged,
            "IfcMapConversion has the target CRS 'EPSG:4258' (ETRS89), whose coordinates are degrees, not a projected "
            "CRS (east 14.09, north 46.36); export it with a projected CRS, or set crs.map and crs.placement (or "
            "crs.control) in the portfolio",
        ),
    ],
    ids=[
        "height in millimetres", "scale", "doors", "MapUnit of another size", "the other foot", "words on heights",
        "two vertical datums", "zone", "two conversions", "degrees",
    ],
)  # fmt: skip
def test_a_statement_that_cannot_be(write_ifc: WriteIfc, ifc: Ifc, change: Change, message: str) -> None:
    with pytest.raises(FacadelakeError) as caught:
        load_ifc_building(change(write_ifc(ifc)), settings=IfcModelSettings())
    assert str(caught.value).startswith(message)


def test_two_map_conversions(write_ifc: WriteIfc) -> None:
    with pytest.raises(FacadelakeError) as caught:
        load_ifc_building(edited(write_ifc(PLACED), another_conversion), settings=IfcModelSettings())
    said = str(caught.value)
    assert said.startswith("the IFC states 2 different coordinate operations: IfcMapConversion to EPSG:25832, ")
    assert said.endswith(
        "remove all but one, or set crs.map, crs.vertical and crs.placement (or crs.control) in the portfolio, which "
        "replace them"
    )


def test_latitude_and_longitude_exchanged(write_ifc: WriteIfc) -> None:
    path = edited(write_ifc(Ifc(schema="IFC4X3")), rigid_operation(14.09, 46.36, "EPSG:4258"))
    with pytest.raises(FacadelakeError) as caught:
        load_ifc_building(path, settings=ELLIPSOIDAL)
    assert str(caught.value).startswith(
        "IfcRigidOperation gives 14.090000 and 46.360000 degrees, latitude first by the axis order of EPSG:4258: the "
        "point 46.36, 14.09 of ETRS89 (longitude, latitude) lies outside the area of use of that CRS"
    )
    assert "exchanged (14.09, 46.36) it would lie in it" in str(caught.value)


def test_one_global_id_of_two_elements(write_ifc: WriteIfc) -> None:
    def share(model: ifcopenshell.file) -> None:
        first, second = model.by_type("IfcWall")
        second.GlobalId = first.GlobalId

    path = edited(write_ifc(Ifc(boxes=[Box(), Box(corner_m=(0, 8, 0))], crs=CRS, conversion=CONVERSION)), share)
    building = load_ifc_building(path, settings=IfcModelSettings())
    said = (
        "2 elements have no GlobalId or that of another element; they are kept apart by their STEP ids, which the next "
        "export changes"
    )
    assert said in building.remarks
    assert len(set(building.elements.column("element_guid").to_pylist())) == 2
    assert np.ptp(building.vertices_site_m, axis=0).max() > 8


def test_two_true_norths_and_a_site_elsewhere_are_told(write_ifc: WriteIfc) -> None:
    def change(model: ifcopenshell.file) -> None:
        site = model.by_type("IfcSite")[0]
        site.RefLatitude, site.RefLongitude = (42, 21, 31), (-71, -3, -24)
        for north in ((0.0, 1.0), (0.5, 0.8)):
            context = model.create_entity("IfcGeometricRepresentationContext", ContextType="Model")
            context.TrueNorth = model.create_entity("IfcDirection", north)

    remarks = load_ifc_building(edited(write_ifc(PLACED), change), settings=IfcModelSettings()).remarks
    assert "the IFC's contexts state different TrueNorth (" in remarks
    assert "of IfcSite lie 5," in remarks and " km away and were not used" in remarks


def test_a_damaged_header_and_a_damaged_entity(write_ifc: WriteIfc) -> None:
    """The text is whole, but a placement has two coordinates; a reference in the header ended the process."""
    path = write_ifc(PLACED)
    text = path.read_text()
    path.write_text(text.replace("FILE_SCHEMA(('IFC4'))", "FILE_SCHEMA((#1))"))
    with pytest.raises(FacadelakeError) as caught:
        load_ifc_building(path, settings=IfcModelSettings())
    assert str(caught.value) == f"the header of building model {path} refers to an entity; export it again"
    path.write_text(text)

    def flatten(model: ifcopenshell.file) -> None:
        model.by_type("IfcBuildingStorey")[1].ObjectPlacement.RelativePlacement.Location.Coordinates = (0.0, 0.0)

    with pytest.raises(FacadelakeError) as caught:
        load_ifc_building(edited(path, flatten), settings=IfcModelSettings())
    assert str(caught.value).startswith(f"building model {path} has an entity with missing or wrong attributes (")
    assert str(caught.value).endswith("check it with an IFC validator, and export it again")
