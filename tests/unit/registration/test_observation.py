"""Detections on a wall whose geometry is known: positions, extents, outcomes."""

import numpy as np
import pytest
import shapely

from facadelake.building.surface.raycasting import Surface
from facadelake.core.errors import InputDataError
from facadelake.core.geodesy import transform
from facadelake.core.proj.crs import GEO
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings
from schemas.vocabulary import ObservationOutcome
from tests.unit.registration.wall_scene import look_at

SETTINGS = RegistrationSettings()
AHEAD = look_at([0.0, -10.0, 2.0], [0.0, 0.0, 2.0])


def box_of(posed, centre, width_m, height_m):
    """The box around a rectangle on the wall y = 0, by projecting its corners."""
    u, v = np.meshgrid([-width_m / 2, width_m / 2], [-height_m / 2, height_m / 2])
    corners = np.asarray(centre) + np.column_stack([u.ravel(), np.zeros(4), v.ravel()])
    pixels = posed.project_site(corners)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return (low[0], low[1], high[0] - low[0], high[1] - low[1])


def one(detections, posed, wall, settings=SETTINGS):
    rows = observe_detections(detections, posed, wall, Surface(wall), settings).to_pylist()
    assert len(rows) == 1
    return rows[0]


def test_square_on_position_and_extent_follow_from_similar_triangles(wall, detections_of):
    box = box_of(AHEAD, [1.2, 0, 3.5], 0.3, 0.2)
    row = one(detections_of(("a", "p", "crack", box)), {"p": AHEAD}, wall)
    assert row["observation_outcome"] == "registered"
    np.testing.assert_allclose(
        [row["x_site_m"], row["y_site_m"], row["z_site_m"]], [1.2, 0.0, 3.5], rtol=0, atol=1e-6
    )  # m
    np.testing.assert_allclose([row["normal_x"], row["normal_y"], row["normal_z"]], [0, -1, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose([row["width_m"], row["height_m"]], [0.3, 0.2], rtol=0, atol=1e-6)  # m
    np.testing.assert_allclose(row["area_m2"], 0.06, rtol=0, atol=1e-6)  # m2
    np.testing.assert_allclose(row["distance_m"], np.hypot(10, np.hypot(1.2, 1.5)), rtol=0, atol=1e-6)  # m
    np.testing.assert_allclose(row["gsd_mm"], 1000 * 10 / 1500, rtol=0, atol=1e-6)  # mm
    np.testing.assert_allclose(
        row["incidence_deg"], np.degrees(np.arctan(np.hypot(1.2, 1.5) / 10)), rtol=0, atol=1e-6
    )  # deg
    assert (row["element_guid"], row["storey"], row["facade"]) == ("high", "First floor", "S")
    assert row["target_share"] == 1.0
    assert row["defect_id"] is None


def test_the_globe_and_the_map_agree_with_the_site(wall, detections_of):
    row = one(detections_of(("a", "p", "crack", (900, 700, 30, 30))), {"p": AHEAD}, wall)
    site = wall.origin.site_from_geo(np.array([[row["lon_deg"], row["lat_deg"], row["height_ellipsoidal_m"]]]))[0]
    np.testing.assert_allclose(site, [row["x_site_m"], row["y_site_m"], row["z_site_m"]], rtol=0, atol=1e-4)  # m
    point = shapely.from_wkb(row["geometry"])
    assert (point.x, point.y, point.z) == (row["lon_deg"], row["lat_deg"], row["height_ellipsoidal_m"])
    back = transform(np.array([[row["east_map_m"], row["north_map_m"], row["height_map_m"]]]), "EPSG:25832", GEO)
    np.testing.assert_allclose(back[0, :2], [row["lon_deg"], row["lat_deg"]], rtol=0, atol=1e-9)  # deg
    np.testing.assert_allclose(back[0, 2], row["height_ellipsoidal_m"], rtol=0, atol=1e-4)  # m


@pytest.mark.parametrize("angle_deg", [20.0, 45.0, 70.0])
def test_obliquely_the_extent_on_the_wall_stays(wall, detections_of, angle_deg):
    """One depth a photograph (the paper's Algorithm 1) is wrong here by the cosine of the incidence."""
    a = np.radians(angle_deg)
    posed = look_at([-15 * np.sin(a), -15 * np.cos(a), 2.0], [0.0, 0.0, 2.0])
    box = box_of(posed, [0.0, 0, 2.0], 0.4, 0.3)
    row = one(detections_of(("a", "p", "crack", box)), {"p": posed}, wall)
    np.testing.assert_allclose(
        row["width_m"], 0.4, rtol=0, atol=0.02
    )  # m: the box is wider than the rectangle at its centre
    np.testing.assert_allclose(row["incidence_deg"], angle_deg, rtol=0, atol=0.5)  # deg
    by_one_depth = box[2] * row["gsd_mm"] / 1000
    assert abs(by_one_depth - 0.4 * np.cos(a)) < 0.02  # m


def test_every_accepted_detection_has_a_row_with_an_outcome(wall, detections_of):
    shallow = look_at([-60.0, -6.0, 2.0], [0.0, 0.0, 2.0])
    ahead = (990, 740, 20, 20)
    made = detections_of(
        ("a", "p", "crack", ahead),
        ("b", "nowhere", "crack", ahead),
        ("c", "p", "crack", (1990, 740, 100, 20)),
        ("d", "p", "crack", (990, 10, 20, 20)),
        ("e", "shallow", "crack", ahead),
    )
    rows = observe_detections(made, {"p": AHEAD, "shallow": shallow}, wall, Surface(wall), SETTINGS).to_pylist()
    assert [(row["detection_id"], row["observation_outcome"]) for row in rows] == [
        ("a", "registered"), ("b", "unlocalised"), ("c", "outside"), ("d", "off_target"), ("e", "grazing"),
    ]  # fmt: skip
    # Occlusion and masks are outcomes of exclusion.
    not_of_observe = {ObservationOutcome.OCCLUDED, ObservationOutcome.MASKED}
    assert {row["observation_outcome"] for row in rows} == set(ObservationOutcome) - not_of_observe
    assert [row["reason"] for row in rows] == [
        None,
        "the photograph has no measured pose; see table poses",
        "the box's centre at (2040.0, 750.0) px is outside the photograph of 2000 x 1500 px",
        "0.0% of the rays hit the building; the limit is 50%",
        "the incidence is 84.3 deg; the limit is 80 deg",
    ]
    assert rows[3]["x_site_m"] is None
    assert rows[4]["incidence_deg"] > SETTINGS.grazing_above_deg


def test_a_box_that_mostly_misses_is_off_target_though_its_centre_hits(wall, detections_of):
    edge = AHEAD.project_site(np.array([[0.0, 0, 6.0]]))[0]
    box = (edge[0] - 200, edge[1] - 390, 400, 800)  # the wall's top runs just above the box's centre
    row = one(detections_of(("a", "p", "crack", box)), {"p": AHEAD}, wall)
    assert row["observation_outcome"] == "registered"
    assert 0.4 < row["target_share"] < 0.6
    strict = RegistrationSettings(target_share_min=0.7)
    assert (
        one(detections_of(("a", "p", "crack", box)), {"p": AHEAD}, wall, strict)["observation_outcome"] == "off_target"
    )


def test_what_was_not_accepted_is_not_observed(wall, detections_of):
    refused = detections_of(("a", "p", "crack", (900, 700, 30, 30)), detection_outcome="bad_box", reason="no width")
    assert len(observe_detections(refused, {"p": AHEAD}, wall, Surface(wall), SETTINGS)) == 0


def test_a_patch_ends_where_the_depth_jumps(wall, detections_of):
    """A pillar of 0.4 m is 2 m in front of the wall: a box of 1 m around it has the width of the pillar."""
    pillar = np.array([[-0.2, -2, 0], [0.2, -2, 0], [0.2, -2, 4], [-0.2, -2, 4]], dtype=float)
    surface = Surface.from_mesh(
        np.vstack([wall.vertices_site_m, pillar]),
        np.vstack([wall.triangles, [[8, 9, 10], [8, 10, 11]]]),
        np.array([0, 0, 1, 1, 1, 1]),
    )
    box = (1000 - 75, 750 - 50, 150, 100)
    row = observe_detections(
        detections_of(("a", "p", "crack", box)), {"p": AHEAD}, wall, surface, SETTINGS
    ).to_pylist()[0]
    np.testing.assert_allclose(row["y_site_m"], -2.0, rtol=0, atol=1e-6)  # m
    assert 0.2 < row["width_m"] <= 0.4 + 1e-6  # m, sampled by 11 rays
    np.testing.assert_allclose(row["height_m"], 100 * 8 / 1500, rtol=0, atol=1e-6)  # m
    assert row["target_share"] == 1.0


def test_the_result_does_not_depend_on_the_batches(wall, detections_of):
    cameras = {f"p{i}": look_at([i - 3.0, -9.0 - i, 2.0], [0.0, 0.0, 2.0]) for i in range(4)}
    made = detections_of(*[(f"d{i:02d}", f"p{i % 4}", "crack", (500 + 30 * i, 700, 40, 30)) for i in range(20)])
    whole = observe_detections(made, cameras, wall, Surface(wall), SETTINGS)
    small = observe_detections(made, cameras, wall, Surface(wall), RegistrationSettings(detections_per_cast=3))
    numbers = [field.name for field in whole.schema if field.type == "double" and not field.name.startswith("crack_")]
    for name in whole.schema.names:
        if name in numbers:
            np.testing.assert_allclose(
                small.column(name).to_numpy(), whole.column(name).to_numpy(), rtol=0, atol=1e-9
            )  # m, deg: the last bits depend on how sums are blocked
        elif name not in ("covariance_site", "patch", "geometry"):
            assert small.column(name).equals(whole.column(name)), name
    shapes = [shapely.from_wkb(table.column("patch").to_pylist()) for table in (whole, small)]
    assert shapely.equals_exact(*shapes, tolerance=1e-9).all()  # deg, m


def test_settings_out_of_range_are_refused():
    with pytest.raises(InputDataError, match="odd"):
        RegistrationSettings(rays_per_side=10)
    with pytest.raises(InputDataError, match="out of range"):
        RegistrationSettings(grazing_above_deg=120.0)


def test_a_surface_nearer_than_anyone_flies_is_not_what_the_photograph_shows(wall, detections_of):
    # By the error of its pose the camera is 0.3 m from a wall that in reality is beside it.
    near = look_at([0.0, -0.3, 2.0], [0.0, 0.0, 2.0])
    box = box_of(near, [0.0, 0, 2.0], 0.01, 0.01)
    assert one(detections_of(("a", "p", "crack", box)), {"p": near}, wall)["observation_outcome"] == "off_target"
    allowed = one(detections_of(("a", "p", "crack", box)), {"p": near}, wall, RegistrationSettings(near_m=0.0))
    assert allowed["observation_outcome"] == "registered"
    np.testing.assert_allclose(allowed["distance_m"], 0.3, rtol=0, atol=1e-6)  # m


@pytest.mark.parametrize("size", [(0.0, 20.0), (20.0, 0.0), (-5.0, 20.0), (np.nan, 20.0)])
def test_a_box_without_area_is_a_row_and_the_rest_goes_on(wall, detections_of, size):
    """As a detector may make them: a COCO file's are refused on import."""
    made = detections_of(("a", "p", "crack", (990, 740, *size)), ("b", "p", "crack", (990, 740, 20, 20)))
    rows = observe_detections(made, {"p": AHEAD}, wall, Surface(wall), SETTINGS).to_pylist()
    assert [row["observation_outcome"] for row in rows] == ["outside", "registered"]
    assert "no area" in rows[0]["reason"]
