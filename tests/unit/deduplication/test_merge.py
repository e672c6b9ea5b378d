"""Observations to defects: the corrected Algorithm 1, its gate, its order, and where it puts a defect."""

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facadelake.building.surface.raycasting import Surface
from facadelake.deduplication.clustering import cluster_observations
from facadelake.deduplication.merge import merge_observations
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.settings import MergeSettings
from facadelake.registration.observation import observe_detections
from facadelake.registration.settings import RegistrationSettings
from tests.unit.registration.wall_scene import look_at

MERGE = MergeSettings()


def place_observations(x_m, photo, size_m=0.2, defect_class=None):
    """Observations at positions along a wall y = 0, seen square-on."""
    n = len(x_m)
    return ObservationArrays(
        xyz_site_m=np.column_stack([x_m, np.zeros(n), np.zeros(n)]),
        normal_site=np.tile([0.0, -1, 0], (n, 1)),
        ray_site=np.tile([0.0, 1, 0], (n, 1)),
        distance_m=np.full(n, 10.0),
        width_m=np.full(n, size_m),
        height_m=np.full(n, size_m),
        gsd_m=np.full(n, 0.003),
        photo=np.asarray(photo),
        defect_class=np.zeros(n, dtype=np.int64) if defect_class is None else np.asarray(defect_class),
        box_img=np.full((n, 4), np.nan),
        pose_covariance_m2=np.zeros((n, 3, 3)),
    )


def cluster(observations):
    return cluster_observations(observations, MERGE).group.tolist()


def paper_algorithm_1(x_m, threshold_m):
    """Algorithm 1 as printed: a detection is new if it is far from any earlier defect."""
    defects = []
    for x in x_m:
        if not defects or any(abs(x - known) > threshold_m for known in defects):
            defects.append(x)
    return len(defects)


def test_new_only_if_far_from_all_where_the_paper_counts_again():
    x, photo = np.array([0.0, 5.0, 0.01, 5.01, 0.02, 5.02]), np.array([0, 0, 1, 1, 2, 2])
    assert cluster(place_observations(x, photo)) == [0, 1, 0, 1, 0, 1]
    assert paper_algorithm_1(x, threshold_m=0.5) == 6  # two defects, seen three times each


def test_neighbours_20_cm_apart_stay_apart_where_the_papers_half_metre_joins_them():
    rng = np.random.default_rng(3)
    true = np.repeat([0.0, 0.2, 0.4], 8)
    observations = place_observations(true + rng.normal(0, 0.02, 24), np.tile(np.arange(8), 3))
    assert cluster(observations) == np.repeat([0, 1, 2], 8).tolist()
    assert paper_algorithm_1(observations.xyz_site_m[:, 0], threshold_m=0.5) == 1


def test_two_detections_of_one_photograph_never_join():
    assert cluster(place_observations(np.array([0.0, 0.01, 0.02]), np.array([4, 4, 5]))) == [0, 1, 1]


def test_two_classes_at_one_place_are_two_defects():
    observations = place_observations(np.array([0.0, 0.0]), np.array([0, 1]), defect_class=[0, 1])
    assert cluster(observations) == [0, 1]


def test_a_chain_of_neighbours_does_not_become_one():
    """Each in the gate of the next, the ends a metre apart: at least half the pairs of two groups must agree."""
    x = np.arange(0, 1.01, 0.1)
    groups = cluster(place_observations(x, np.arange(len(x))))
    for group in set(groups):
        assert np.ptp(x[np.array(groups) == group]) < 0.35  # m


@settings(max_examples=40, deadline=None)
@given(st.permutations(range(12)), st.integers(0, 1000))
def test_groups_do_not_depend_on_the_order_of_equal_input(order, seed):
    """Sorted by id before, so any order of rows gives the same sets."""
    rng = np.random.default_rng(seed)
    x, photo = rng.uniform(0, 1.0, 12), rng.integers(0, 6, 12)
    straight = cluster(place_observations(x, photo))
    index = np.asarray(order)
    shuffled = cluster(place_observations(x[index], photo[index]))
    sets = {frozenset(np.flatnonzero(np.array(straight) == g).tolist()) for g in set(straight)}
    again = {frozenset(index[np.array(shuffled) == g].tolist()) for g in set(shuffled)}
    assert sets == again


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_no_group_holds_a_photograph_twice(seed):
    rng = np.random.default_rng(seed)
    photo = rng.integers(0, 5, 40)
    groups = np.array(cluster(place_observations(rng.uniform(0, 2, 40), photo)))
    for group in np.unique(groups):
        assert len(set(photo[groups == group])) == (groups == group).sum()


def test_relief_separates_oblique_observations_in_a_known_direction():
    """10 cm of relief, seen from 45 degrees left and right: the hits are 20 cm apart along the wall, not upward."""
    rays = np.array([[1.0, 1, 0], [-1.0, 1, 0]]) / np.sqrt(2)
    base = replace(place_observations(np.array([-0.1, 0.1]), np.array([0, 1])), ray_site=rays)
    upward = replace(base, xyz_site_m=np.array([[0.0, 0, -0.1], [0, 0, 0.1]]))
    assert cluster(base) == [0, 0]
    assert cluster(upward) == [0, 1]


def test_a_campaign_with_an_offset_from_the_model_still_merges(wall, detections_of):
    """All cameras 0.8 m too far forward and 0.5 m to the side, as with GPS alone; one defect in three photographs."""
    real = {f"p{i}": look_at([-6.0 + 6 * i, -8.0, 2.0], [0.0, 0.0, 1.5]) for i in range(3)}
    placed = {name: look_at(p.centre_site_m + np.array([0.5, 0.8, 0]), [0.5, 0.8, 1.5]) for name, p in real.items()}
    made = []
    for name, posed in real.items():
        u, v = posed.project_site(np.array([[0.2, 0.0, 1.4]]))[0]
        made.append((name, name, "crack", (u - 15, v - 15, 30, 30)))
    detections = detections_of(*made)
    observations = observe_detections(detections, placed, wall, Surface(wall), RegistrationSettings())
    strict = merge_observations(observations, detections, wall, placed, prefix="x")
    wide = merge_observations(observations, detections, wall, placed, prefix="x", settings=MergeSettings(offset_m=1.0))
    assert len(strict.defects) == 3
    assert len(wide.defects) == 1
    row = wide.defects.to_pylist()[0]
    assert abs(row["y_site_m"]) < 0.02  # m: it stays on the wall, though its rays cross 0.8 m behind it
    np.testing.assert_allclose([row["x_site_m"], row["z_site_m"]], [0.7, 1.4], rtol=0, atol=0.15)  # m: moved aside


def test_large_patches_may_differ_by_more_than_the_ceiling():
    far = np.array([0.0, 0.9])
    assert cluster(place_observations(far, np.array([0, 1]), size_m=3.0)) == [0, 0]
    assert cluster(place_observations(far, np.array([0, 1]), size_m=0.3)) == [0, 1]


def test_nothing_to_merge():
    assert cluster(place_observations(np.zeros(0), np.zeros(0, dtype=np.int64))) == []


# From detections to tables


@pytest.fixture
def inspected(wall, detections_of):
    """Four defects on the wall, each seen by three cameras, with boxes drawn by projection."""
    cameras = {f"p{i}": look_at([-4.0 + 4 * i, -10.0, 2.5], [0.0, 0.0, 3.0]) for i in range(3)}
    places = {"A": (-2.0, 4.5), "B": (-1.8, 4.5), "C": (1.0, 4.5), "D": (0.0, 1.0)}
    made = []
    for name, (x, z) in places.items():
        for photo, posed in cameras.items():
            u, v = posed.project_site(np.array([[x, 0.0, z]]))[0]
            made.append((f"{name}-{photo}", photo, "crack", (u - 10, v - 10, 20, 20)))
    detections = detections_of(*made)
    observations = observe_detections(detections, cameras, wall, Surface(wall), RegistrationSettings())
    return detections, observations, cameras


def test_defects_have_their_place_their_element_and_a_stable_name(wall, inspected):
    detections, observations, cameras = inspected
    result = merge_observations(observations, detections, wall, cameras, prefix="tower-2026-04")
    rows = result.defects.to_pylist()
    # South facade: seen from outside, west is to the left; the upper storey comes first.
    assert [row["defect_id"] for row in rows] == [f"tower-2026-04-D{i:04d}" for i in (1, 2, 3, 4)]
    found = np.array([[row["x_site_m"], row["y_site_m"], row["z_site_m"]] for row in rows])
    expected = [[-2.0, 0, 4.5], [-1.8, 0, 4.5], [1.0, 0, 4.5], [0.0, 0, 1.0]]
    # The boxes are centred on the images of the points: 0.5 mm from the centres of what they enclose.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)  # m
    assert [row["photo_count"] for row in rows] == [3, 3, 3, 3]
    assert [row["storey"] for row in rows] == ["First floor"] * 3 + ["Ground floor"]
    assert {row["facade"] for row in rows} == {"S"}
    assert rows[0]["element_name"] == "high wall"
    assert (rows[0]["severity"], rows[0]["severity_rule"]) == ("ungraded", "none")
    assert rows[3]["best_photo_id"] == "p1"  # square-on
    assert all(0 <= row["spread_m"] < 1e-3 for row in rows)  # m
    of_defect = {row["detection_id"]: row["defect_id"] for row in result.observations.to_pylist()}
    assert of_defect["B-p2"] == "tower-2026-04-D0002"


def test_a_facade_named_by_its_degrees_is_walked_along_from_its_own_left(wall, inspected):
    """Where two facades face south their names state the bearing; west is to the left as on any south facade."""
    detections, _, cameras = inspected
    elements = wall.elements
    for name, values in (("facade", ["S-170", "S-170"]), ("facade_azimuth_deg", [170.0, 170.0])):
        place = elements.schema.get_field_index(name)
        field = elements.schema.field(place)
        elements = elements.set_column(place, field, pa.array(values, field.type))
    turned = replace(wall, elements=elements)
    seen = observe_detections(detections, cameras, turned, Surface(turned), RegistrationSettings())
    rows = merge_observations(seen, detections, turned, cameras, prefix="x").defects.to_pylist()
    assert {row["facade"] for row in rows} == {"S-170"}
    assert [round(row["x_site_m"], 1) for row in rows] == [-2.0, -1.8, 1.0, 0.0]  # m


def test_shuffled_rows_give_the_same_tables(wall, inspected):
    detections, observations, cameras = inspected
    order = pa.array(np.random.default_rng(0).permutation(len(observations)))
    straight = merge_observations(observations, detections, wall, cameras, prefix="x")
    shuffled = merge_observations(observations.take(order), detections.take(order), wall, cameras, prefix="x")
    assert straight.defects.equals(shuffled.defects)
    assert straight.observations.sort_by("detection_id").equals(shuffled.observations.sort_by("detection_id"))


def test_what_is_not_registered_belongs_to_no_defect(wall, detections_of):
    camera = look_at([0.0, -10.0, 2.5], [0.0, 0.0, 3.0])
    detections = detections_of(("a", "gone", "crack", (10, 10, 20, 20)), ("b", "p", "crack", (990, 5, 20, 20)))
    observations = observe_detections(detections, {"p": camera}, wall, Surface(wall), RegistrationSettings())
    result = merge_observations(observations, detections, wall, {"p": camera}, prefix="x")
    assert len(result.defects) == 0
    assert result.observations.column("defect_id").to_pylist() == [None, None]
    assert len(result.observations) == 2


def test_ten_thousand_observations_merge_in_seconds():
    """Nearly linear: pairs come from a spatial index, never from a table of all with all."""
    rng = np.random.default_rng(8)
    true = np.repeat(np.arange(2000) * 1.0, 5)
    observations = place_observations(true + rng.normal(0, 0.015, len(true)), np.tile(np.arange(5), 2000))
    groups = np.array(cluster(observations))
    assert groups.tolist() == np.repeat(np.arange(2000), 5).tolist()
