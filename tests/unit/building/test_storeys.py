"""The storey of a point: its element's, or by level where the element extends over several storeys."""

import numpy as np
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model import read_building
from facadelake.building.storeys import StoreyLevel, find_storey, find_storeys
from tests.unit.building.conftest import Box, Ifc

LEVELS = (
    StoreyLevel(name="Ground", floor_site_m=0.0),
    StoreyLevel(name="First", floor_site_m=3.0),
    StoreyLevel(name="Second", floor_site_m=6.0),
)


@pytest.mark.parametrize(
    ("z_m", "name"), [(-2.0, "Ground"), (1.0, "Ground"), (2.95, "First"), (5.0, "First"), (20, "Second")]
)
def test_storey_by_level(z_m, name):
    assert find_storey(LEVELS, z_m) == name
    assert find_storey((), z_m) == ""


def test_points_of_a_curtain_wall_have_the_storey_of_their_level_and_those_of_a_parapet_their_walls():
    element_storeys = ["Ground", "Second", "First", None]
    # A curtain wall, a wall, a wall with a parapet, and one without a storey.
    extents = np.array([[0.0, 9.0], [6.0, 9.0], [2.7, 6.4], [0.0, 9.0]])
    element = np.array([0, 0, 0, 1, 2, 3])
    z = np.array([1.0, 4.0, 8.0, 6.0, 6.3, 4.0])
    found = find_storeys(LEVELS, element_storeys, extents, element, z)
    assert found == ["Ground", "First", "Second", "Second", "First", None]


def test_a_model_keeps_its_storeys_levels(write_ifc, tmp_path):
    path = write_ifc(
        Ifc(
            boxes=[Box(size_m=(4.0, 0.3, 6.0))],
            conversion={"Eastings": 456639.0, "Northings": 5421033.0, "OrthogonalHeight": 178.0},
            crs={"Name": "EPSG:25832", "VerticalDatum": "ellipsoidal"},
            milli=True,
        )
    )
    building = load_ifc_building(path, settings=IfcModelSettings())
    assert [storey.name for storey in building.storeys] == ["Ground floor", "First floor"]
    levels = np.array([storey.floor_site_m for storey in building.storeys])
    np.testing.assert_allclose(levels, [-2.0, 1.0], rtol=0, atol=0.001)  # m: the origin lies at 180
    np.testing.assert_allclose(building.compute_vertical_extents(), [[-2.0, 4.0]], rtol=0, atol=0.001)  # m
    building.save(tmp_path)
    assert read_building(tmp_path).storeys == building.storeys
