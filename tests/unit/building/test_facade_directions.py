"""Facades are clusters of outward directions, not sectors of a compass."""

import numpy as np
import pytest

from facadelake.building.facades.directions import (
    Facades,
    cluster_directions,
    collect_facades,
    measure_turn_deg,
    name_facades,
)
from facadelake.core.tables import table_from_rows


def facing(azimuth_deg, up=0.0):
    angle = np.radians(azimuth_deg)
    return np.array([np.sin(angle), np.cos(angle), up])


@pytest.mark.parametrize("turn", [0.0, 21.9, 22.5, 23.1, 44.0, 67.5, 180.3, 359.9])
def test_a_rectangular_building_has_four_facades_in_any_orientation(turn):
    """22.5 degrees is the limit of a compass sector; walls that differ by a degree are one facade."""
    noise = np.random.default_rng(7).normal(0.0, 0.5, 40)
    azimuth = (turn + 90.0 * (np.arange(40) % 4) + noise) % 360.0
    found = cluster_directions(azimuth, np.full(40, 12.0))
    assert len(found) == 4
    for side in range(4):
        assert measure_turn_deg(found, turn + 90.0 * side).min() < 0.6  # deg: the mean of ten walls of 0.5
    assert len(set(name_facades(found))) == 4


def test_two_wings_of_one_compass_point_have_names_of_their_own():
    azimuth = np.array([350.0, 350.2, 10.0, 9.8, 180.0])
    found = cluster_directions(azimuth, np.array([50.0, 50.0, 40.0, 40.0, 90.0]))
    # 20 degrees is one facade, so the wings of this building turn by more.
    assert len(found) == 2
    azimuth[2:4] += 6.0
    names = name_facades(cluster_directions(azimuth, np.array([50.0, 50.0, 40.0, 40.0, 90.0])))
    assert set(names) == {"N-350", "N-016", "S"}


def test_a_small_return_is_dropped_and_a_small_side_is_kept():
    azimuth = np.array([0.0, 30.0, 180.0, 90.0])
    found = cluster_directions(azimuth, np.array([1000.0, 5.0, 1000.0, 5.0]))
    assert sorted(np.round(found).tolist()) == [0.0, 90.0, 180.0]


def test_directions_are_weighted_by_area_and_close_the_circle():
    found = cluster_directions(np.array([358.0, 4.0]), np.array([3.0, 1.0]))
    np.testing.assert_allclose(found, [359.5], rtol=0, atol=0.05)  # deg
    assert name_facades(found) == ("N",)


def test_no_walls_no_facades():
    assert len(cluster_directions(np.zeros(0), np.zeros(0))) == 0
    assert Facades(names=(), azimuths_deg=()).find_facade(facing(170.0)) == "S"


@pytest.mark.parametrize(
    ("element", "normal", "expected"),
    [
        ("N-350", facing(350.0), "N-350"),
        ("N-350", facing(80.0), "N-350"),  # a reveal belongs to its wall
        ("N-350", facing(170.0), "S"),  # its other side
        ("around", facing(8.0), "N-016"),
        ("around", facing(300.0), "NW"),  # no facade faces that direction
        ("around", facing(150.0), "SE"),  # 30 degrees from the southern facade: the compass decides
        ("around", facing(202.0), "S"),  # within half a sector of it
        ("level", facing(180.0, up=3.0), "level"),
    ],
)
def test_the_facade_assigned_to_a_point(element, normal, expected):
    facades = Facades(names=("N-350", "N-016", "S"), azimuths_deg=(350.0, 16.0, 180.0))
    assert facades.assign_facade(element, normal) == expected


def test_the_facades_of_a_table_of_elements():
    known = {"ifc_class": "IfcWall", "triangles": 12, "surface_area_m2": 1.0}
    rows = [
        known | {"element_guid": "a", "facade": "N-350", "facade_azimuth_deg": 350.4},
        known | {"element_guid": "b", "facade": "E"},  # written before facades had azimuths
        known | {"element_guid": "c", "facade": "around"},
    ]
    facades = collect_facades(table_from_rows("elements", rows))
    assert dict(zip(facades.names, facades.azimuths_deg, strict=True)) == {"N-350": 350.4, "E": 90.0}
