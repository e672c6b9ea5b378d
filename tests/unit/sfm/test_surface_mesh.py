"""The as-built surface of a synthetic block: two walls that meet, seen from in front."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import Delaunay

from facadelake.core.camera import Camera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.sfm.free_space import walk_rays
from facadelake.sfm.reconstruction import LocalisedPhoto, Reconstruction
from facadelake.sfm.surface_mesh import mesh_tie_points, read_mesh

CAMERA = Camera(width_px=100, height_px=100, fx_px=100, fy_px=100, cx_px=50, cy_px=50)


def corner(noise: float, count: int = 1500) -> Reconstruction:
    """Walls y = 0 (x from -5 to 0) and x = 0 (y from -5 to 0), both 5 high, seen by cameras on the inside."""
    rng = np.random.default_rng(1)
    uv = rng.uniform(0, 5, (count, 2))
    first = rng.random(count) < 0.5
    xyz = np.where(first[:, None], np.column_stack([-uv[:, 0], 0 * uv[:, 0], uv[:, 1]]),
                   np.column_stack([0 * uv[:, 0], -uv[:, 0], uv[:, 1]]))  # fmt: skip
    xyz = xyz + rng.normal(0, noise, xyz.shape)
    centres = np.array([[-6.0, -6, 2], [-8, -4, 3], [-4, -8, 1], [-7, -7, 4], [-5, -6, 2.5]])
    photos = tuple(
        LocalisedPhoto(
            photo_id=str(k), camera=CAMERA, sfm_from_cam=Similarity(rotation=np.eye(3), translation=centre),
            reprojection_error_px=0.5, tie_points=count,
        )
        for k, centre in enumerate(centres)
    )  # fmt: skip
    return Reconstruction(
        photos=photos,
        unlocalised=(),
        xyz_sfm=xyz,
        rgb=np.zeros((count, 3), np.uint8),
        image_point_photo=np.tile(np.arange(5), count),
        image_point_tie_point=np.repeat(np.arange(count), 5),
        image_point_xy_img=np.zeros((5 * count, 2)),
        mean_reprojection_error_px=0.5,
        costs=(),
    )


def test_the_mesh_lies_on_the_walls_and_faces_the_cameras() -> None:
    vertices, triangles = mesh_tie_points(corner(noise=0.01))
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1) / 2
    # 2 x 25 square units of wall; noise folds it a little, gaps at the rim take a little away.
    assert 44 < area.sum() < 60
    middle = (a + b + c) / 3
    off = np.minimum(np.abs(middle[:, 0]), np.abs(middle[:, 1]))
    assert 1e-4 < np.average(off, weights=area) < 0.03
    towards = np.einsum("ij,ij->i", normal, np.array([-6.0, -6, 2]) - middle) > 0
    assert np.average(towards, weights=area) > 0.98


def test_a_point_that_floats_in_seen_space_is_not_joined_to_the_wall() -> None:
    """A gross error amid the rays of hundreds of wall points: nothing solid can be there."""
    block = corner(noise=0.005)
    block.xyz_sfm[7] = [-3.0, -3.0, 2.5]
    vertices, triangles = mesh_tie_points(block)
    used = vertices[np.unique(triangles)]
    assert np.linalg.norm(used - [-3.0, -3.0, 2.5], axis=1).min() > 0.5


def test_rays_cross_each_tetrahedron_on_their_way_once() -> None:
    """Along each ray, the lengths between crossings, found by sampling, agree with the facets walked through."""
    rng = np.random.default_rng(2)
    points = np.vstack([rng.uniform(-1, 1, (60, 3)), 10 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T])
    delaunay = Delaunay(points)
    origin, end = np.array([[-3.0, -2.5, 0.3]]), np.array([4])
    found = walk_rays(delaunay, origin, points[end], end, np.array([0.05]))
    samples = origin + np.linspace(0, 0.999999, 200_001)[:, None] * (points[end] - origin)
    met = delaunay.find_simplex(samples)
    walked = np.append(found.tetrahedron, delaunay.neighbors[found.tetrahedron[-1], found.facet[-1]])
    seen = met[np.concatenate([[True], met[1:] != met[:-1]])]
    assert len(seen) > 5
    np.testing.assert_array_equal(walked, seen)
    assert found.camera_tetrahedra.tolist() == [met[0]]
    length = float(np.linalg.norm(points[end] - origin))
    changes = np.flatnonzero(met[1:] != met[:-1]) / 200_000
    np.testing.assert_allclose(found.distance_to_end, length * (1 - changes), rtol=0, atol=1e-3)


def test_too_few_points_or_no_mesh_are_errors(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="20 tie points have three image points or more; a surface needs 50"):
        mesh_tie_points(corner(noise=0.01, count=20))
    with pytest.raises(InputDataError, match="holds no as-built mesh"):
        read_mesh(tmp_path)
