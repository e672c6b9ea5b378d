"""Site, ECEF and EPSG codes against formulas that PROJ has no part in."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facadelake.core.errors import GeoreferenceError
from facadelake.core.geodesy import SiteOrigin, transform
from facadelake.core.proj.crs import ECEF, GEO, check_area_of_use, promote_to_3d

A, F = 6378137.0, 1 / 298.257223563  # WGS 84
E2 = F * (2 - F)
ORIGIN = SiteOrigin(lon_deg=8.4078, lat_deg=48.9405, height_ellipsoidal_m=180.0)


def ecef_closed(lon_deg: float, lat_deg: float, height_m: float) -> np.ndarray:
    """The closed formula of every textbook (NIMA TR8350.2, 4-14)."""
    lon, lat = np.radians([lon_deg, lat_deg])
    n = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    return np.array(
        [(n + height_m) * np.cos(lat) * np.cos(lon), (n + height_m) * np.cos(lat) * np.sin(lon),
         (n * (1 - E2) + height_m) * np.sin(lat)]
    )  # fmt: skip


places = st.tuples(st.floats(-180, 180), st.floats(-89.9, 89.9), st.floats(-400, 9000))


@given(places)
def test_ecef_is_the_closed_formula(place: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(transform(np.array([place]), GEO, ECEF)[0], ecef_closed(*place), rtol=0, atol=1e-6)  # m


@given(st.tuples(*[st.floats(-2000, 2000)] * 3))
def test_site_and_globe_are_inverse(xyz: tuple[float, float, float]) -> None:
    back = ORIGIN.site_from_geo(ORIGIN.geo_from_site(np.array([xyz])))[0]
    np.testing.assert_allclose(back, xyz, rtol=0, atol=1e-6)  # m


def test_site_axes_point_east_north_and_up() -> None:
    """A metre of each axis against the radii of curvature, which the transform does not use."""
    lat = np.radians(ORIGIN.lat_deg)
    prime = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    meridian = A * (1 - E2) / (1 - E2 * np.sin(lat) ** 2) ** 1.5
    geo = ORIGIN.geo_from_site(np.vstack([np.zeros(3), np.eye(3)]))
    step = geo[1:] - geo[0]
    assert step[0, 0] == pytest.approx(np.degrees(1 / ((prime + 180) * np.cos(lat))), rel=1e-6)
    assert step[1, 1] == pytest.approx(np.degrees(1 / (meridian + 180)), rel=1e-6)
    np.testing.assert_allclose(step[2], [0, 0, 1], rtol=0, atol=1e-8)


def test_ecef_from_site_agrees_with_the_closed_formula() -> None:
    """The origin itself, and a point 100 m up."""
    points = ORIGIN.ecef_from_site().apply(np.array([[0.0, 0, 0], [0, 0, 100]]))
    expected = [ecef_closed(8.4078, 48.9405, 180.0), ecef_closed(8.4078, 48.9405, 280.0)]
    np.testing.assert_allclose(points, expected, rtol=0, atol=1e-6)  # m


def test_map_coordinates_put_east_first() -> None:
    """UTM 32 from the series of the transverse Mercator at the central meridian: east is 500 km there."""
    on_meridian = SiteOrigin(lon_deg=9.0, lat_deg=48.0, height_ellipsoidal_m=0.0)
    east, north, height = on_meridian.map_from_site(np.zeros((1, 3)), "EPSG:25832")[0]
    # Length of the meridian to 48 deg on GRS 80 is 5 318 111.93 m by Helmert's series; times 0.9996.
    n = F / (2 - F)
    lat = np.radians(48.0)
    arc = (
        A
        / (1 + n)
        * (
            (1 + n**2 / 4 + n**4 / 64) * lat
            - 1.5 * (n - n**3 / 8) * np.sin(2 * lat)
            + 15 / 16 * (n**2 - n**4 / 4) * np.sin(4 * lat)
            - 35 / 48 * n**3 * np.sin(6 * lat)
        )
    )
    np.testing.assert_allclose([east, north, height], [500_000, 0.9996 * arc, 0], rtol=0, atol=0.002)  # m


@pytest.mark.parametrize(("lon", "lat"), [(48.0, 91.0), (456_630.0, 5_421_032.0), (181.0, 0.0)])
def test_an_origin_out_of_range_is_refused(lon: float, lat: float) -> None:
    with pytest.raises(GeoreferenceError, match=r"out of range .* swapped"):
        SiteOrigin(lon_deg=lon, lat_deg=lat, height_ellipsoidal_m=0.0)


def test_swapped_axes_do_not_pass_silently() -> None:
    with pytest.raises(GeoreferenceError, match="check the axis order"):
        transform(np.array([[456_630.0, 5_421_032.0, 180.0]]), GEO, "EPSG:25832")


def test_a_missing_grid_is_refused_not_guessed() -> None:
    """DHHN2016 heights need the German geoid grid, which no wheel carries; a ballpark would shift them by 48 m."""
    with pytest.raises(GeoreferenceError, match=r"(grid|no transformation).*"):
        ORIGIN.map_from_site(np.zeros((1, 3)), "EPSG:25832+7837")


def test_an_unknown_crs_is_named() -> None:
    with pytest.raises(GeoreferenceError, match="CRS 'EPSG:999999' is not known to PROJ"):
        promote_to_3d("EPSG:999999")


def test_no_points_are_no_points() -> None:
    assert transform(np.zeros((0, 3)), GEO, ECEF).shape == (0, 3)


@pytest.mark.parametrize(
    ("crs", "point"),
    [
        ("EPSG:25832", (456_630.0, 5_421_032.0)),
        ("EPSG:25832+7837", (456_630.0, 5_421_032.0)),
        ("EPSG:25832", (825_700.0, 5_392_000.0)),  # Passau: 1.5 deg outside the area, as all of eastern Bavaria
        ("EPSG:4258", (14.09, 46.36)),
        ("EPSG:5514", (-743_375.94, -1_043_172.85)),
        ("EPSG:3460", (1_700_000.0, 4_000_000.0)),  # Fiji, 177 deg west: the area crosses the date line
        ("EPSG:4978", (4_000_000.0, 600_000.0)),
        ("+proj=utm +zone=32 +datum=WGS84", (0.0, 0.0)),  # states no area
    ],
)
def test_points_in_the_area_of_use_pass(crs: str, point: tuple[float, float]) -> None:
    check_area_of_use(np.array([point]), crs)


@pytest.mark.parametrize(
    ("crs", "point", "remedy"),
    [
        ("EPSG:4258", (46.36, 14.09), r"latitude 33.26 to 84.73\); exchanged \(14.09, 46.36\) it would lie in it"),
        ("EPSG:25832+7837", (5_421_032.0, 456_630.0), r"exchanged \(456630, 5421032\) it would"),
        ("EPSG:5514", (743_375.94, 1_043_172.85), r"with the other sign \(-743375.94, -1043172.85\)"),
        ("EPSG:5514", (1_043_172.85, 743_375.94), r"exchanged and with the other sign \(-743375.94, -1043172.85\)"),
        ("EPSG:2056", (600_000.0, 200_000.0), r"Liechtenstein; Switzerland: .*47.81\); check the axis order, the unit"),
        ("EPSG:25832", (1e9, 1e9), "check the axis order"),
        ("EPSG:25832", (float("nan"), 0.0), "check the axis order"),
    ],
)
def test_points_outside_the_area_of_use_are_refused(crs: str, point: tuple[float, float], remedy: str) -> None:
    """The second point of the array is named, with the reading that would fit."""
    good = {"EPSG:4258": (14.0, 46.0), "EPSG:2056": (2.6e6, 1.2e6), "EPSG:5514": (-7e5, -1e6)}
    points = np.array([good.get(crs, (456_630.0, 5_421_032.0)), point])
    with pytest.raises(GeoreferenceError, match=remedy):
        check_area_of_use(points, crs)
