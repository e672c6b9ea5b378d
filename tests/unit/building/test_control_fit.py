"""A placement fitted to pairs: the true one is recovered, noise shows in the residuals, a wrong pair is named."""

import numpy as np
import pyproj
import pytest

from facadelake.building.ifc.load import IfcModelSettings, load_ifc_building
from facadelake.building.model_georeference.control_pairs import ControlPair, fit_placement
from facadelake.core.errors import GeoreferenceError
from tests.unit.building.conftest import Box, Ifc
from tests.unit.building.globe_by_hand import assert_same_places, corners_of, geo_of_east_north_up

CORNERS = np.array([[0.0, 0, 0], [24, 0, 0], [24, 11, 0], [0, 11, 0], [0, 0, 9], [24, 11, 9]])
LON, LAT, HEIGHT, TURN = 8.4078, 48.9405, 178.25, 37.0


def pairs_of(corners, noise=None):
    """Pairs of a model in metres on the ground, its x axis 37 degrees anticlockwise from true east."""
    geo = geo_of_east_north_up(LON, LAT, HEIGHT, turned(corners))
    east, north = pyproj.Proj("+proj=utm +zone=32 +ellps=GRS80")(geo[:, 0], geo[:, 1])
    on_map = np.column_stack([east, north, geo[:, 2]]) + (0 if noise is None else noise)
    return [ControlPair(ifc_m=tuple(a), map_m=tuple(b)) for a, b in zip(corners, on_map, strict=True)]


def turned(corners):
    c, s = np.cos(np.radians(TURN)), np.sin(np.radians(TURN))
    x, y, z = np.asarray(corners, dtype=float).T
    return np.column_stack([c * x - s * y, s * x + c * y, z])


@pytest.mark.parametrize("count", [2, 3, 6])
def test_pairs_place_the_model_in_true_metres(write_ifc, count):
    box = Box(size_m=(24.0, 11.0, 9.0))
    settings = IfcModelSettings(
        map_crs="EPSG:25832", vertical_datum="ellipsoidal", control=tuple(pairs_of(CORNERS[:count]))
    )
    building = load_ifc_building(write_ifc(Ifc(boxes=[box], milli=True)), settings=settings)
    assert building.georeference_level == "registry"
    assert f"placed by {count} pairs" in building.remarks
    assert_same_places(building, geo_of_east_north_up(LON, LAT, HEIGHT, turned(corners_of(box))))


def test_model_points_of_pairs_may_be_map_coordinates():
    """A model far from its zero that is turned a little against the map."""
    far = np.add(CORNERS, (456600.0, 5421000.0, 150.0))
    pairs = [ControlPair(ifc_m=tuple(a), map_m=pair.map_m) for a, pair in zip(far, pairs_of(CORNERS), strict=True)]
    placement, _ = fit_placement(pairs, "EPSG:25832", "ellipsoidal")
    off = placement.map_from_ifc(far) - [pair.map_m for pair in pairs]
    assert np.abs(off).max() < 0.001  # m


def test_noise_shows_in_the_residuals():
    sigma = 0.02
    found = []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0.0, sigma, CORNERS.shape)
        found.append(
            float(
                fit_placement(pairs_of(CORNERS, noise), "EPSG:25832", "ellipsoidal")[1]
                .split("residual sigma ")[1]
                .split()[0]
            )
        )
    assert 0.9 * sigma < np.sqrt(np.mean(np.square(found))) < 1.1 * sigma  # m, one coordinate


@pytest.mark.parametrize("wrong", [0, 3, 5])
def test_a_wrong_pair_is_named(wrong):
    noise = np.random.default_rng(wrong).normal(0.0, 0.01, CORNERS.shape)
    noise[wrong] += [0.5, -0.3, 0.0]
    with pytest.raises(
        GeoreferenceError, match=rf"pair {wrong + 1} of crs.control in the portfolio deviates by 0\.[567]\d\d m"
    ):
        fit_placement(pairs_of(CORNERS, noise), "EPSG:25832", "ellipsoidal")


@pytest.mark.parametrize(
    ("corners", "factor", "message"),
    [
        (CORNERS[:1], 1.0, "has 1 pair; at least 2 are needed"),
        (CORNERS[[0, 4]], 1.0, r"lie within 0\.00 m of one another in plan"),
        (CORNERS, 1000.0, "0.001 times as far apart on the map as in the model.*millimetres"),
        (CORNERS, 3.28084, r"0\.3048 times as far apart.*feet"),
    ],
)
def test_pairs_that_cannot_place_a_model(corners, factor, message):
    pairs = [ControlPair(ifc_m=tuple(factor * np.array(pair.ifc_m)), map_m=pair.map_m) for pair in pairs_of(corners)]
    with pytest.raises(GeoreferenceError, match=message):
        fit_placement(pairs, "EPSG:25832", "ellipsoidal")
