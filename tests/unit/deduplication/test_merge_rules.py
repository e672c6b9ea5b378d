"""Rules of merging: neighbours, classes, seams, and defects behind parts of the model."""

import numpy as np
import pyarrow as pa
import pytest

from facadelake.building.surface.raycasting import Surface
from facadelake.deduplication.clustering import cluster_observations
from facadelake.deduplication.merges_table import build_merges_table
from facadelake.deduplication.rear_surface import reassign_to_rear_surface
from facadelake.deduplication.settings import MergeSettings
from tests.unit.deduplication.merging import make_observations
from tests.unit.registration.wall_scene import make_rectangle

SETTINGS = MergeSettings()


def cluster(observations):
    return cluster_observations(observations, SETTINGS).group.tolist()


@pytest.mark.parametrize("size_m", [0.03, 0.15, 0.35])
@pytest.mark.parametrize("jitter", [0.0, 0.05])
def test_defects_20_cm_apart_stay_apart_small_and_large_exact_and_noisy(size_m, jitter):
    """Sixty pairs, each seen by four to eight photographs, some of which miss one of the two."""
    rng = np.random.default_rng(int(1000 * size_m) + int(100 * jitter))
    places, photo, truth = [], [], []
    for pair in range(60):
        angle = rng.uniform(0, 2 * np.pi)
        for member in range(2):
            centre = np.array([5.0 * pair, 2.0]) + 0.2 * member * np.array([np.cos(angle), np.sin(angle)])
            for number in range(rng.integers(4, 9)):
                if rng.random() > 0.07:
                    places.append(centre + rng.normal(0, np.hypot(jitter * size_m, 0.005), 2))
                    photo.append(10 * pair + number)
                    truth.append(2 * pair + member)
    found = np.array(cluster(make_observations(places, photo, size_m=size_m)))
    assert len(np.unique(found)) == 120
    assert len(np.unique(np.column_stack([found, truth]), axis=0)) == 120


def test_a_single_wrong_class_is_outvoted():
    observations = make_observations([(0, 1), (0.01, 1), (0, 1.01), (0.01, 1.01)], [0, 1, 2, 3], kinds=[0, 0, 1, 0])
    assert cluster(observations) == [0, 0, 0, 0]


@pytest.mark.parametrize(
    ("photo", "kinds"),
    [
        ([0, 1, 2, 0], [0, 0, 0, 1]),  # one photograph shows both
        ([0, 1, 2, 3, 4], [0, 0, 0, 1, 1]),  # two photographs agree on the other class
        ([0, 1], [0, 1]),  # no majority
    ],
)
def test_two_classes_at_one_place_from_exact_boxes_are_two_defects(photo, kinds):
    found = cluster(make_observations([(0, 1)] * len(photo), photo, kinds=kinds))
    assert len(set(found)) == 2
    assert len({(group, kind) for group, kind in zip(found, kinds, strict=True)}) == 2


def test_class_outliers_never_become_the_majority():
    """Two of one class and two outliers of other classes: one joins, as with both no class had the majority."""
    found = cluster(make_observations([(0, 1)] * 4, [0, 1, 2, 3], kinds=[0, 0, 1, 2]))
    assert found[0] == found[1]
    assert sorted(found.count(group) for group in set(found)) == [1, 3]


def test_an_outlier_beside_the_defect_is_not_assigned():
    assert cluster(make_observations([(0, 1), (0.01, 1), (0.2, 1)], [0, 1, 2], kinds=[0, 0, 1])) == [0, 0, 1]


def test_outliers_of_two_neighbours_are_not_a_third_defect():
    """Each of two neighbours was given the same wrong class once, in different photographs."""
    places = [(0, 1)] * 4 + [(0.14, 1)] * 4
    observations = make_observations(places, [0, 1, 2, 3, 1, 2, 3, 4], kinds=[1, 0, 0, 0, 0, 0, 0, 1])
    alone = make_observations([places[0], places[7]], [0, 4], kinds=[1, 1])
    assert cluster(alone) == [0, 0]  # without their companions they would be one
    assert cluster(observations) == [0, 0, 0, 0, 1, 1, 1, 1]


# A crack 1 m long; in photograph 0 a drain pipe hides its centre, or a tile ends there.
HALVES = [(-0.28, 2.0), (0.28, 2.0)]
HALF_SIZE = (0.44, 0.1)
BOXES_APART = [(100, 100, 147, 33), (287, 100, 147, 33)]
BOXES_MEETING = [(100, 100, 167, 33), (267, 100, 167, 33)]


def test_parts_cut_by_an_occluder_are_one_where_other_photographs_show_the_whole():
    whole = [(0.0, 2.0), (0.01, 2.0)]
    size = np.array([HALF_SIZE, HALF_SIZE, (1.0, 0.1), (1.0, 0.1)])
    observations = make_observations(
        HALVES + whole, [0, 0, 1, 2], size_m=size, boxes=BOXES_APART + [(0, 0, 300, 33)] * 2
    )
    found = cluster_observations(observations, SETTINGS)
    assert found.group.tolist() == [0, 0, 0, 0]
    assert found.unit.tolist() == [0, 0, 1, 2]
    np.testing.assert_allclose(found.unit_observations.width_m[0], 1.0, rtol=0, atol=1e-9)  # m
    np.testing.assert_allclose(found.unit_observations.xyz_site_m[0], [0, 0, 2], rtol=0, atol=1e-9)  # m


def test_neighbours_in_line_are_two_where_others_see_two():
    size = np.tile(HALF_SIZE, (6, 1))
    places, photo = HALVES * 3, [0, 0, 1, 1, 2, 2]
    found = cluster(make_observations(places, photo, size_m=size, boxes=BOXES_APART * 3))
    assert found == [0, 1, 0, 1, 0, 1]


def test_boxes_that_meet_at_a_seam_are_one_unless_others_see_two():
    places, size = [(-0.25, 2.0), (0.25, 2.0)], np.tile([0.5, 0.1], (2, 1))
    assert cluster(make_observations(places, [0, 0], size_m=size, boxes=BOXES_MEETING)) == [0, 0]
    twice = make_observations(places * 2, [0, 0, 1, 1], size_m=np.tile(size, (2, 1)), boxes=BOXES_MEETING + BOXES_APART)
    assert cluster(twice) == [0, 1, 0, 1]
    uneven = [(100, 100, 167, 33), (267, 90, 167, 60)]  # a corner: they touch, but their sides do not continue
    assert cluster(make_observations(places, [0, 0], size_m=size, boxes=uneven)) == [0, 1]


def test_every_join_is_explained_once():
    rng = np.random.default_rng(2)
    places = np.repeat([(0, 1), (0.2, 1), (3, 1)], 5, axis=0) + rng.normal(0, 0.01, (15, 2))
    kinds = [0, 0, 0, 0, 1, *[0] * 10]
    observations = make_observations(places, np.tile(np.arange(5), 3), kinds=kinds)
    found = cluster_observations(observations, SETTINGS)
    names = pa.array([f"d{i:02d}" for i in range(15)])
    defects = pa.array([f"D{group}" for group in found.group])
    rows = build_merges_table(names, defects, observations, found, SETTINGS).to_pylist()
    joined = {row["detection_id"] for row in rows if row["merge_decision"] == "joined"}
    joined |= {row["other_detection_id"] for row in rows if row["merge_decision"] == "joined"}
    assert joined == set(names.to_pylist())
    assert all((row["defect_id"] == row["other_defect_id"]) == (row["merge_decision"] == "joined") for row in rows)
    reasons = {row["merge_reason"] for row in rows if "d04" in (row["detection_id"], row["other_detection_id"])}
    assert "outvoted" in reasons
    assert all(row["merge_reason"] in ("same_photograph", "too_far", "other_class", "group_disagrees")
               for row in rows if row["merge_decision"] == "apart")  # fmt: skip
    assert all(row["appearance_score"] is None for row in rows)
    assert len(rows) <= 15 * 3


# Rear surfaces


def observe_behind_pillar(eyes, place):
    """Observations of ``place`` on the wall y = 0 from ``eyes``; a pillar on their rays is in the model only."""
    pillar = make_rectangle([-0.6, -2, 0], [1.2, 0, 0], [0, 0, 4])
    wall = make_rectangle([-10, 0, 0], [20, 0, 0], [0, 0, 6])
    surface = Surface.from_mesh(
        np.vstack([wall, pillar]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]), np.array([0, 0, 1, 1])
    )
    rays = np.asarray(place, dtype=float) - eyes
    hits = surface.cast(eyes, rays)
    observations = make_observations(hits.xyz_site_m[:, [0, 2]], np.arange(len(eyes)), eyes=eyes)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    made = {"xyz_site_m": hits.xyz_site_m, "ray_site": rays, "distance_m": hits.distance_m}
    return surface, hits.element, type(observations)(**{**vars(observations), **made})


def test_rays_that_intersect_behind_a_part_of_the_model_are_reassigned_to_the_rear_surface():
    eyes = np.array([[-2.0, -10, 2], [-0.5, -10, 2], [0.5, -10, 2], [2, -10, 2]])
    surface, element, observations = observe_behind_pillar(eyes, [0.1, 0.0, 2.0])
    assert element.tolist() == [1, 1, 1, 1]
    first = cluster_observations(observations, SETTINGS)
    reassigned = reassign_to_rear_surface(observations, first, SETTINGS, surface)
    assert reassigned is not None
    assert reassigned.element.tolist() == [0] * len(reassigned.rows)
    assert sorted(reassigned.rows.tolist()) == [0, 1, 2, 3]
    np.testing.assert_allclose(reassigned.observations.xyz_site_m, np.tile([0.1, 0, 2], (4, 1)), rtol=0, atol=1e-6)  # m
    assert cluster(reassigned.observations) == [0, 0, 0, 0]


def test_a_defect_on_the_pillar_stays_there():
    eyes = np.array([[-2.0, -10, 2], [-0.5, -10, 2], [0.5, -10, 2], [2, -10, 2]])
    surface, element, observations = observe_behind_pillar(eyes, [0.1, -2.0, 2.0])
    assert element.tolist() == [1, 1, 1, 1]
    assert (
        reassign_to_rear_surface(observations, cluster_observations(observations, SETTINGS), SETTINGS, surface) is None
    )


def test_with_gps_alone_nothing_is_reassigned():
    eyes = np.array([[-2.0, -10, 2], [-0.5, -10, 2], [0.5, -10, 2], [2, -10, 2]])
    surface, _, observations = observe_behind_pillar(eyes, [0.1, 0.0, 2.0])
    doubtful = MergeSettings(offset_m=2.0)
    assert (
        reassign_to_rear_surface(observations, cluster_observations(observations, doubtful), doubtful, surface) is None
    )
