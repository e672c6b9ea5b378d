"""Maps whose x and y do not grow to the east and north: a model in them is never mirrored or turned in silence."""

from dataclasses import replace

import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.mesh.load import load_mesh_building
from facadelake.building.model_georeference.control_pairs import ControlPair
from facadelake.building.model_georeference.map_placement import MapPlacement
from facadelake.core.errors import GeoreferenceError
from facadelake.core.proj.crs import list_axis_directions
from tests.unit.building.conftest import Ifc
from tests.unit.building.test_mesh_readings import HALL, SETTINGS, write_hall

AXES = "x and y of EPSG:2053 (Hartebeesthoek94 / Lo29) grow to the west and south; the model's coordinates are taken so"
ELLIPSOIDAL = IfcModelSettings(vertical_datum="ellipsoidal")
# By hand: 100 m east of the meridian 29 deg E, 2,900,000 m south of the equator: west -100, south 2,900,000.
SOUTH_AFRICA = {"Eastings": -100.0, "Northings": 2_900_000.0, "OrthogonalHeight": 1700.0}


@pytest.mark.parametrize(
    ("crs", "directions"),
    [
        ("EPSG:25832", ("east", "north")),
        ("EPSG:31467", ("east", "north")),  # its own order is north, east
        ("EPSG:5514", ("east", "north")),
        ("EPSG:5513", ("south", "west")),
        ("EPSG:2053", ("west", "south")),
    ],
)
def test_directions_of_x_and_y(crs: str, directions: tuple[str, str]) -> None:
    assert list_axis_directions(crs) == directions


def test_a_model_in_southing_and_westing_would_be_mirrored(write_ifc) -> None:
    conversion = {"Eastings": 1_043_172.85, "Northings": 743_375.94, "OrthogonalHeight": 250.0, "Scale": 0.9999}
    path = write_ifc(Ifc(conversion=conversion, crs={"Name": "EPSG:5513"}, map_unit_metre=True))
    with pytest.raises(GeoreferenceError) as caught:
        load_ifc_building(path, settings=ELLIPSOIDAL)
    assert " grow to the south and west, so that the model would be mirrored; " in str(caught.value)


def test_eastings_and_northings_in_a_crs_of_westing_and_southing_are_asked_for(write_ifc) -> None:
    path = write_ifc(Ifc(conversion=SOUTH_AFRICA, crs={"Name": "EPSG:2053"}, map_unit_metre=True))
    with pytest.raises(GeoreferenceError) as caught:
        load_ifc_building(path, settings=ELLIPSOIDAL)
    assert (
        " grow to the west and south, so that Eastings and Northings of the IFC may be either, and the model turned by "
        "180 degrees; set crs.control in the portfolio: "
    ) in str(caught.value)
    # The remedy: the model's x axis points east, which is -west, and its y axis north.
    pairs = tuple(
        ControlPair(ifc_m=(x, y, 0.0), map_m=(-100.0 - x, 2_900_000.0 - y, 1700.0))
        for x, y in ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0))
    )
    building = load_ifc_building(path, settings=replace(ELLIPSOIDAL, control=pairs))
    geo = building.origin.geo_from_site(building.vertices_site_m)
    # 4 m of wall to the east of 100 m east of the meridian; a degree of longitude is 99.97 km at latitude -26.2.
    assert (geo[:, 0].min() - 29.0) * 99_970 == pytest.approx(100.0, abs=0.2)  # m
    assert (geo[:, 0].max() - 29.0) * 99_970 == pytest.approx(104.0, abs=0.2)  # m
    assert AXES in building.remarks


def test_a_mesh_in_westing_and_southing_is_told(tmp_path) -> None:
    settings = replace(
        SETTINGS, map_crs="EPSG:2053", placement=MapPlacement(east_m=-100.0, north_m=2_900_000.0, height_m=1700.0)
    )
    building = load_mesh_building(write_hall(tmp_path / "hall.obj"), settings=settings)
    assert AXES in building.remarks
    geo = building.origin.geo_from_site(building.vertices_site_m)
    # x of the mesh is westing: it extends to the west of 100 m east of the meridian.
    assert (geo[:, 0].max() - 29.0) * 99_970 == pytest.approx(100.0, abs=0.2)  # m
    assert (geo[:, 0].max() - geo[:, 0].min()) * 99_970 == pytest.approx(HALL[0], abs=0.1)  # m
    mirrored = replace(
        settings, map_crs="EPSG:5513", placement=MapPlacement(east_m=1_043_172.85, north_m=743_375.94, height_m=250.0)
    )
    with pytest.raises(GeoreferenceError, match="would be mirrored"):
        load_mesh_building(tmp_path / "hall.obj", settings=mirrored)
