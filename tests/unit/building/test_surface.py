"""Rays against planes, spheres and boxes whose hits have a closed form."""

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from facadelake.building.surface.raycasting import MISS, Surface
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import ModelError
from facadelake.core.frames import Similarity

UNIT = st.floats(-1, 1, allow_nan=False)
VECTOR = st.tuples(UNIT, UNIT, UNIT).map(np.array).filter(lambda v: np.linalg.norm(v) > 0.1)


def rotation(vector):
    return cv2.Rodrigues(np.asarray(vector, dtype=np.float64))[0]


def square(half_m, turn, middle):
    """A square of 2 * half_m in the plane x, y, rotated and translated."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half_m
    return corners @ turn.T + middle, np.array([[0, 1, 2], [0, 2, 3]])


@settings(max_examples=60, deadline=None)
@given(VECTOR, st.floats(-20, 20), st.floats(-20, 20), st.floats(3, 80), st.floats(-0.9, 0.9), st.floats(-0.9, 0.9))
def test_a_ray_hits_a_rotated_plane_at_the_computed_point(vector, x, y, distance, u, v):
    turn, middle = rotation(vector), np.array([x, y, 5.0])
    surface = Surface.from_mesh(*square(10.0, turn, middle))
    target = middle + turn @ [10 * u, 10 * v, 0]
    eye = target + turn @ [1.0, 0.5, 2.0] / np.linalg.norm([1.0, 0.5, 2.0]) * distance
    hits = surface.cast(eye[None], (target - eye)[None])
    assert hits.hit.all()
    np.testing.assert_allclose(hits.xyz_site_m[0], target, rtol=0, atol=1e-9)  # m
    np.testing.assert_allclose(hits.distance_m[0], distance, rtol=0, atol=1e-9)  # m
    np.testing.assert_allclose(hits.normal_site[0], turn[:, 2], rtol=0, atol=1e-12)  # faces the eye
    behind = surface.cast(eye[None], (eye - target)[None])
    assert behind.triangle[0] == MISS
    assert behind.element[0] == MISS
    assert np.isinf(behind.distance_m[0])
    assert np.isnan(behind.xyz_site_m[0]).all()


@settings(max_examples=30, deadline=None)
@given(VECTOR)
def test_the_normal_faces_the_ray_on_both_sides_of_a_sheet(vector):
    turn = rotation(vector)
    surface = Surface.from_mesh(*square(1.0, turn, np.zeros(3)))
    for side in (1.0, -1.0):
        eye = side * 4.0 * turn[:, 2]
        hits = surface.cast(eye[None], -eye[None])
        np.testing.assert_allclose(hits.normal_site[0], side * turn[:, 2], rtol=0, atol=1e-12)


def test_precision_is_kept_far_from_the_origin():
    """At 5e5 and 5e6 m the spacing of float32 is half a metre."""
    offset = np.array([456639.1363, 5421033.3718, 178.2501])
    corners, triangles = square(5.0, rotation([0.4, 0.2, -0.7]), offset)
    turn = rotation([0.4, 0.2, -0.7])
    rng = np.random.default_rng(5)
    targets = offset + np.column_stack([rng.uniform(-4.5, 4.5, (200, 2)), np.zeros(200)]) @ turn.T
    eyes = targets + turn @ [3.0, -2.0, 12.0]
    hits = Surface.from_mesh(corners, triangles).cast(eyes, targets - eyes)
    assert np.linalg.norm(hits.xyz_site_m - targets, axis=1).max() < 1e-6  # m


def test_a_sphere_is_hit_at_its_radius_and_missed_outside():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=3.0)
    surface = Surface.from_mesh(ball.vertices, ball.faces)
    rng = np.random.default_rng(1)
    eyes = rng.normal(size=(500, 3))
    eyes *= 10 / np.linalg.norm(eyes, axis=1, keepdims=True)
    at_centre = surface.cast(eyes, -eyes)
    # Flat facets lie inside the sphere by at most their sagitta, 0.6 mm here, and never outside.
    assert (at_centre.distance_m > 7.0 - 1e-9).all()
    assert (at_centre.distance_m < 7.0 + 0.002).all()  # m
    sideways = np.cross(eyes, [0.3, 0.5, 0.8])
    sideways *= 3.05 / np.linalg.norm(sideways, axis=1, keepdims=True)
    passing = surface.cast(eyes + sideways, -eyes)
    assert not passing.hit.any()


def test_a_turned_box_keeps_its_elements_and_its_first_face_hides_the_rest():
    turn = rotation([0.2, -0.5, 0.9])
    box = trimesh.creation.box(extents=[2, 4, 6])
    near, far = box.vertices @ turn.T, box.vertices @ turn.T + turn @ [10.0, 0, 0]
    surface = Surface.from_mesh(
        np.vstack([near, far]), np.vstack([box.faces, box.faces + 8]), np.repeat([7, 9], len(box.faces))
    )
    eyes = np.array([turn @ [-5.0, 0.3, 0.2], turn @ [20.0, 0.3, 0.2], turn @ [4.0, 0.3, 0.2]])
    ways = np.array([turn @ [1.0, 0, 0], turn @ [-1.0, 0, 0], turn @ [1.0, 0, 0]])
    hits = surface.cast(eyes, ways)
    assert hits.element.tolist() == [7, 9, 9]
    np.testing.assert_allclose(hits.distance_m, [4.0, 9.0, 5.0], rtol=0, atol=1e-9)  # m


def test_a_distance_beside_and_above_an_edge():
    corners, triangles = square(2.0, np.eye(3), np.zeros(3))
    surface = Surface.from_mesh(corners, triangles)
    points = np.array([[0.5, -0.5, 3.0], [5.0, 0, 4.0], [0.1, 0.2, 0.0]])
    np.testing.assert_allclose(surface.measure_distance(points), [3.0, 5.0, 0.0], rtol=0, atol=1e-5)  # m
    np.testing.assert_allclose(surface.find_closest_points(points).xyz_site_m[1], [2.0, 0, 0], rtol=0, atol=1e-5)  # m


def test_depth_is_along_the_axis_and_follows_the_lens_distortion():
    """A wall square to the axis has one depth in every pixel, whatever the distortion."""
    camera = Camera(
        width_px=640, height_px=480, fx_px=500, fy_px=510, cx_px=330, cy_px=235, k1=-0.12, k2=0.03, p1=0.001
    )
    surface = Surface.from_mesh(*square(3.0, np.eye(3), np.array([0.0, 0.0, 8.0])))
    posed = PosedCamera(camera=camera, site_from_cam=Similarity.make_identity())
    depth, element = surface.render_depth(posed, 0.25)
    assert depth.shape == (120, 160)
    seen = np.isfinite(depth)
    np.testing.assert_allclose(depth[seen], 8.0, rtol=0, atol=1e-9)  # m
    assert (element[seen] == 0).all()
    assert (element[~seen] == MISS).all()
    corner = camera.project(np.array([[-3.0, -3.0, 8.0], [3.0, 3.0, 8.0]])) / 4
    rows, columns = np.nonzero(seen)
    np.testing.assert_allclose(
        [columns[rows == 60].min(), columns[rows == 60].max() + 1], corner[:, 0], rtol=0, atol=2.0
    )  # px
    np.testing.assert_allclose(
        [rows[columns == 80].min(), rows[columns == 80].max() + 1], corner[:, 1], rtol=0, atol=2.0
    )  # px


def test_no_triangles_is_an_error():
    with pytest.raises(ModelError, match="no triangles"):
        Surface.from_mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
