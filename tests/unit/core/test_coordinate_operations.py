"""The operation between two datums: PROJ's own choice by area, published pairs, and formulas without PROJ."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyproj
import pytest
from pyproj.aoi import AreaOfInterest

from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import compute_operation_sigma, find_operation, transform
from facadelake.core.proj.crs import ECEF, ELLIPSOID_OF_CRS, GEO, combine_crs, get_crs_name
from facadelake.core.proj.operations import UNKNOWN_ACCURACY_M, require_best
from tests.unit.core.proj_grids import write_constant_shift

PLACES = {
    "Prague": ("EPSG:5514", 14.413719, 50.085346),
    "Bratislava": ("EPSG:5514", 17.11, 48.15),
    "Madrid": ("EPSG:23030", -3.70, 40.42),
    "Bergen": ("EPSG:23032", 5.33, 60.39),
    "Birmingham": ("EPSG:27700", -1.90, 52.48),
    "Hanover": ("EPSG:31467", 9.73, 52.37),
    "Cologne": ("EPSG:31466", 6.96, 50.94),
    "Bern": ("EPSG:2056", 7.44, 46.95),
    "Los Angeles": ("EPSG:2229", -118.24, 34.05),
    "Los Angeles, metres": ("EPSG:6423", -118.24, 34.05),
    "Tokyo": ("EPSG:30169", 139.69, 35.69),
    "Karlsruhe": ("EPSG:25832", 8.40, 49.00),
}


@pytest.mark.parametrize("place", PLACES)
def test_the_operation_is_that_of_proj_for_the_area(place: str) -> None:
    """PROJ's own choice, by the area of interest, is a path of its own: one call that takes no list of operations."""
    crs, lon, lat = PLACES[place]
    x, y = pyproj.Proj(crs)(lon, lat)
    chosen = pyproj.Transformer.from_crs(
        pyproj.CRS(crs), "EPSG:4326", always_xy=True, allow_ballpark=False,
        area_of_interest=AreaOfInterest(lon - 0.001, lat - 0.001, lon + 0.001, lat + 0.001),
    )  # fmt: skip
    expected = chosen.transform(x, y)
    found = transform(np.array([[x, y, 0.0]]), crs, GEO)[0]
    np.testing.assert_allclose(found[:2], expected, rtol=0, atol=2e-8)  # degrees: 2 mm, for the height of the ellipsoid
    # PROJ inverts a rotation of seconds of arc to first order: millimetres.
    np.testing.assert_allclose(transform(found[None], GEO, crs)[0], [x, y, 0.0], rtol=0, atol=0.01)  # m or feet


def test_the_published_pair_of_krovak() -> None:
    """lon 14.413719, lat 50.085346 is east -743375.94, north -1043172.85; the first operation listed is 9.9 m off."""
    geo = transform(np.array([[-743_375.94, -1_043_172.85, 250.0]]), "EPSG:5514", GEO)[0]
    np.testing.assert_allclose(geo, [14.413719, 50.085346, 250.0], rtol=0, atol=6e-7)  # degrees, the digits published


def test_ed50_in_madrid_by_the_parameters_of_the_spanish_survey() -> None:
    """Seven parameters of the Instituto Geografico Nacional for the peninsula, applied by hand to geocentric ED50."""
    a, f = 6_378_388.0, 1 / 297.0  # International 1924
    lon, lat = pyproj.Proj("EPSG:23030")(440_000.0, 4_474_000.0, inverse=True)
    xyz = geocentric(a, f, lon, lat, 0.0)
    rx, ry, rz = np.radians(np.array([-1.244, -0.020, -1.144]) / 3600)
    rotation = np.array([[1, -rz, ry], [rz, 1, -rx], [-ry, rx, 1]])
    expected = np.array([-131.0, -100.3, -163.4]) + (1 + 9.39e-6) * rotation @ xyz
    own = combine_crs("EPSG:23030", ELLIPSOID_OF_CRS)
    found = transform(np.array([[440_000.0, 4_474_000.0, 0.0]]), own, ECEF)[0]
    assert np.linalg.norm(found - expected) < 0.01  # m


def geocentric(a: float, f: float, lon_deg: float, lat_deg: float, height_m: float) -> np.ndarray:
    """The closed formula, for any ellipsoid."""
    lon, lat = np.radians([lon_deg, lat_deg])
    e2 = f * (2 - f)
    n = a / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return np.array(
        [(n + height_m) * np.cos(lat) * np.cos(lon), (n + height_m) * np.cos(lat) * np.sin(lon),
         (n * (1 - e2) + height_m) * np.sin(lat)]
    )  # fmt: skip


def test_an_ellipsoidal_height_is_that_of_a_gnss_receiver() -> None:
    """Bern, origin of the Swiss map, by swisstopo's constants: the Bessel ellipsoid lies 49.6 m above WGS 84's."""
    bern = np.array([[2_600_000.0, 1_200_000.0, 550.0]])
    bessel = geocentric(6_377_397.155, 1 / 299.1528128, 7 + 26 / 60 + 22.50 / 3600, 46 + 57 / 60 + 8.66 / 3600, 550.0)
    own = transform(bern, combine_crs("EPSG:2056", ELLIPSOID_OF_CRS), GEO)
    shifted = bessel + np.array([674.374, 15.056, 405.346])
    np.testing.assert_allclose(transform(own, GEO, ECEF)[0], shifted, rtol=0, atol=0.01)  # m
    assert own[0, 2] == pytest.approx(599.6, abs=0.1)  # m
    gnss = transform(bern, "EPSG:2056", GEO)
    assert gnss[0, 2] == 550.0
    np.testing.assert_allclose(transform(gnss, GEO, "EPSG:2056"), bern, rtol=0, atol=1e-4)  # m
    # The same plumb line: both heights are of one point on the map.
    np.testing.assert_allclose(
        transform(np.array([[*gnss[0, :2], own[0, 2]]]), GEO, "EPSG:2056")[0, :2], bern[0, :2], rtol=0, atol=2e-3
    )  # m: the normals of the two ellipsoids differ by 5 seconds of arc


def test_gnss_heights_pass_between_maps() -> None:
    """Madrid: the ellipsoids of ED50 and of WGS 84 lie 72 m apart there."""
    there = transform(np.array([[440_000.0, 4_474_000.0, 700.0]]), "EPSG:23030", "EPSG:25830")
    assert there[0, 2] == pytest.approx(700.0, abs=0.01)
    own = transform(np.array([[440_000.0, 4_474_000.0, 700.0]]), combine_crs("EPSG:23030", ELLIPSOID_OF_CRS), GEO)
    assert own[0, 2] - 700.0 == pytest.approx(72.0, abs=0.5)
    back = transform(there, "EPSG:25830", "EPSG:23030")
    np.testing.assert_allclose(back, [[440_000.0, 4_474_000.0, 700.0]], rtol=0, atol=2e-3)  # m


def test_sigma_of_an_operation() -> None:
    karlsruhe = {"lon_deg": 8.4, "lat_deg": 49.0}
    expected = {
        ("EPSG:25832", "EPSG:25833"): (0, 0),
        ("EPSG:31467", "EPSG:31468"): (0, 0),
        (GEO, ECEF): (0, 0),
        ("EPSG:32632", "EPSG:25832"): (0, 1),  # null by convention: told, not added
        (ECEF, "EPSG:25832"): (0, 1),
        ("EPSG:31467", GEO): (3, 0),
    }
    for (source, target), (sigma_m, convention_m) in expected.items():
        found = compute_operation_sigma(source, target, **karlsruhe)
        assert (found.sigma_m.tolist(), found.convention_m) == ([sigma_m] * 3, convention_m), source
    unknown = "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=3500000 +ellps=bessel +towgs84=598,74,418,0.2,0.05,-2.5,6.7"
    operation = find_operation(unknown, GEO, **karlsruhe)
    assert (operation.accuracy_m, operation.sigma_m) == (None, UNKNOWN_ACCURACY_M)
    assert "accuracy unknown to PROJ, 25 m assumed" in operation.describe()


def test_a_missing_grid_is_named_with_how_to_get_it_and_may_be_accepted() -> None:
    operation = find_operation("EPSG:31467", GEO, lon_deg=9.73, lat_deg=52.37)
    with pytest.raises(GeoreferenceError) as raised:
        require_best(operation, None)
    assert str(raised.value) == (
        "the best transformation from DHDN / 3-degree Gauss-Kruger zone 3 to WGS 84 here, DHDN to WGS 84 (4) (1 m), "
        "needs the grid de_adv_BETA2007.tif, which is not installed: install it (apt install proj-data, or pyproj sync "
        "--file de_adv_BETA2007.tif), or accept DHDN to WGS 84 (2) (accuracy 3 m) with "
        "crs.accept_operation_accuracy_m: 3 in the portfolio"
    )
    with pytest.raises(GeoreferenceError, match=r"accept_operation_accuracy_m: 3 in the portfolio \(it is 2\)"):
        require_best(operation, 2.0)
    require_best(operation, 3.0)
    require_best(find_operation("EPSG:5514", GEO, lon_deg=14.4, lat_deg=50.1), None)  # no better one exists


def test_installed_grids_are_found_and_enter_the_code_version(tmp_path: Path) -> None:
    """A grid that shifts by 3.6 seconds of latitude, in a folder of PROJ_DATA, under the name that PROJ looks for."""
    grid = tmp_path / "de_adv_BETA2007.tif"
    write_constant_shift(grid, south_deg=47, north_deg=56, west_deg=5, east_deg=16, shift_s=3.6)
    code = (
        "import json, numpy as np\n"
        "from facadelake.core.geodesy import find_operation, transform\n"
        "from facadelake.core.proj.crs import GEO\n"
        "from facadelake.core.code_version import compute_code_version\n"
        "from facadelake.core.proj.grids import list_installed_grids\n"
        "operation = find_operation('EPSG:31467', GEO, lon_deg=9.73, lat_deg=52.37)\n"
        "geo = transform(np.array([[3549764.0, 5803907.0, 60.0]]), 'EPSG:31467', GEO)[0].tolist()\n"
        "print(json.dumps([operation.name, operation.grids, geo, list_installed_grids(),"
        " compute_code_version('facadelake.core.geodesy').sha256]))"
    )
    found = {}
    for name, folder in {"with": str(tmp_path), "without": ""}.items():
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PROJ_DATA": folder},
            capture_output=True,
            text=True,
            check=True,
        )
        found[name] = json.loads(done.stdout)
    operation, grids, geo, installed, code_version = found["with"]
    assert (operation, grids) == ("DHDN to WGS 84 (4)", ["de_adv_BETA2007.tif"])
    assert [grid.name, grid.stat().st_size] in installed
    lon, lat = pyproj.Proj("EPSG:31467")(3_549_764.0, 5_803_907.0, inverse=True)
    np.testing.assert_allclose(geo, [lon, lat + 0.001, 60.0], rtol=0, atol=1e-7)
    assert found["without"][0] == "DHDN to WGS 84 (2)"
    assert found["without"][4] != code_version


def test_a_crs_without_a_name_is_named_by_its_proj_string() -> None:
    assert get_crs_name(pyproj.CRS("EPSG:25832")) == "ETRS89 / UTM zone 32N"
    assert get_crs_name(pyproj.CRS("+proj=utm +zone=32 +datum=WGS84 +units=m")).startswith("+proj=utm +zone=32")


def test_heights_without_an_operation_are_not_to_be_renamed_ellipsoidal() -> None:
    """PROJ has no geoid model of DHHN92; the same number taken as ellipsoidal is 48 m off in Karlsruhe."""
    with pytest.raises(GeoreferenceError) as raised:
        transform(np.array([[456_639.25, 5_421_033.5, 130.0]]), "EPSG:25832+5783", GEO)
    assert str(raised.value).endswith(
        ": PROJ knows none whose area of use contains the place; check the CRS and the vertical datum"
    )


@pytest.mark.parametrize(
    ("crs", "place"),
    [
        ("EPSG:3912", (14.5, 46.05)),  # MGI 1901 / Slovene National Grid: 7 mm
        ("EPSG:8352", (17.1, 48.15)),  # S-JTSK [JTSK03] / Krovak: 5 mm
        ("EPSG:24200", (-76.8, 18.0)),  # JAD69 / Jamaica National Grid: 5 mm
        ("EPSG:3019", (12.0, 57.7)),  # RT90: 3 mm
        ("EPSG:3303", (-138.6, -10.5)),  # Fatu Iva 72 / UTM zone 7S: 217 mm
        ("EPSG:25832", (8.4, 48.9)),
        ("EPSG:2056", (7.4, 46.9)),
    ],
)
def test_round_trips_return_to_a_tenth_of_a_millimetre(crs: str, place: tuple[float, float]) -> None:
    """PROJ inverts a Helmert transformation by its signs alone, off by what the comments say."""
    there = transform(np.array([[*place, 100.0], [place[0] + 0.001, place[1] + 0.001, 900.0]]), GEO, crs)
    back = transform(transform(there, crs, GEO), GEO, crs)
    np.testing.assert_allclose(back, there, rtol=0, atol=1e-4)  # m
    geo = transform(there, crs, GEO)
    again = transform(transform(geo, GEO, crs), crs, GEO)
    np.testing.assert_allclose(again[:, :2], geo[:, :2], rtol=0, atol=1e-9)  # deg, 0.1 mm
    np.testing.assert_allclose(again[:, 2], geo[:, 2], rtol=0, atol=1e-4)  # m


def test_a_proj_string_without_a_datum_is_named() -> None:
    """As pyproj and epsg.io write EPSG:25832; the remedy was to check the vertical datum."""
    with pytest.raises(GeoreferenceError) as raised:
        transform(np.array([[507_771.0, 5_399_070.4, 482.9]]), "+proj=utm +zone=32 +ellps=GRS80 +units=m +no_defs", GEO)
    assert " states an ellipsoid and no datum: give an EPSG code such as EPSG:25832, or +datum=WGS84" in str(
        raised.value
    )
