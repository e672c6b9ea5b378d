"""Meshes of known walls, smooth and rough, segmented into facade planes."""

import numpy as np
import pytest

from facadelake.building.mesh.facade_planes import build_plane_elements, segment_facade_planes
from facadelake.building.storeys import StoreyLevel
from facadelake.building.surface.raycasting import Surface
from facadelake.core.geodesy import SiteOrigin

ORIGIN = SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0)


def grid(corner, across, upward, step_m=0.5):
    """A rectangle as a grid of triangles whose normals are across x upward."""
    corner, across, upward = (np.asarray(v, dtype=float) for v in (corner, across, upward))
    columns, rows = (max(1, round(np.linalg.norm(v) / step_m)) for v in (across, upward))
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    points = corner + u.ravel()[:, None] * across + v.ravel()[:, None] * upward
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = first, first + 1, first + columns + 2, first + columns + 1
    return points, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def mesh(*parts, noise_m=0.0, turn_deg=0.0):
    """Parts as one mesh with noise of ``noise_m`` at each vertex, rotated clockwise in plan."""
    vertices, triangles, count = [], [], 0
    for points, faces in parts:
        vertices.append(points)
        triangles.append(faces + count)
        count += len(points)
    angle = np.radians(-turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    points = np.vstack(vertices) @ turn.T
    return Surface.from_mesh(points + np.random.default_rng(3).normal(0, noise_m, points.shape), np.vstack(triangles))


def house(step_m=0.5):
    """20 m by 10 m by 6 m, without a ground, with a setback storey on its northern half."""
    return (
        grid([0, 0, 0], [20, 0, 0], [0, 0, 6], step_m),  # south
        grid([20, 0, 0], [0, 10, 0], [0, 0, 6], step_m),  # east
        grid([20, 10, 0], [-20, 0, 0], [0, 0, 9], step_m),  # north, up to the top
        grid([0, 10, 0], [0, -10, 0], [0, 0, 6], step_m),  # west
        grid([0, 0, 6], [20, 0, 0], [0, 5, 0], step_m),  # terrace
        grid([0, 5, 6], [20, 0, 0], [0, 0, 3], step_m),  # setback, facing south
        grid([20, 5, 6], [0, 5, 0], [0, 0, 3], step_m),
        grid([0, 10, 6], [0, -5, 0], [0, 0, 3], step_m),
        grid([0, 5, 9], [20, 0, 0], [0, 5, 0], step_m),  # roof
    )


EXPECTED_M2 = {
    "facade-S-1": 120, "facade-S-2": 60, "facade-N-1": 180, "facade-E-1": 75, "facade-W-1": 75, "level-1": 200,
}  # fmt: skip


@pytest.mark.parametrize(("step_m", "noise_m", "allowed"), [(100.0, 0.0, 1e-9), (0.5, 0.0, 1e-9), (0.25, 0.02, 0.06)])
def test_walls_of_a_house_coarse_fine_and_rough(step_m: float, noise_m: float, allowed: float) -> None:
    surface = mesh(*house(step_m), noise_m=noise_m)
    planes = segment_facade_planes(surface)
    area = np.bincount(planes.plane_of_triangle, weights=surface.areas_m2)
    found = dict(zip(planes.names, area, strict=True))
    assert {name for name in found if found[name] > 1.0} == set(EXPECTED_M2)
    for name, expected in EXPECTED_M2.items():
        assert abs(found[name] / expected - 1) <= allowed + 1e-9, name
    azimuth = dict(zip(planes.names, planes.azimuth_deg, strict=True))
    assert abs(azimuth["facade-S-1"] - 180) < 0.1 + 5 * noise_m  # deg
    assert np.isnan(azimuth["level-1"])


def test_a_wall_near_the_limit_of_a_compass_sector_is_named_by_its_fitted_plane() -> None:
    """22.5 degrees separate N from NE; the roughness of the normals is ten times the margin of 0.5 degrees."""
    for turn, name in ((22.0, "facade-S-1"), (23.0, "facade-SW-1")):
        surface = mesh(grid([0, 0, 0], [20, 0, 0], [0, 0, 6], 0.25), noise_m=0.03, turn_deg=turn)
        assert segment_facade_planes(surface).names[0] == name


def test_a_wall_with_reversed_winding_faces_the_open_side() -> None:
    parts = list(house(100.0))
    points, faces = parts[0]
    parts[0] = (points, faces[:, ::-1])
    walls = [
        *parts[:4],
        grid([0, 10, 0], [20, 0, 0], [0, -10, 0], 100.0),  # a ground, so that the inside is closed
        grid([0, 0, 6], [20, 0, 0], [0, 10, 0], 100.0),
    ]
    names = set(segment_facade_planes(mesh(*walls)).names)
    assert "facade-S-1" in names and "facade-N-2" not in names


def test_reveals_join_their_wall_and_rooms_are_inside() -> None:
    wall = [
        grid([0, 0, 0], [8, 0, 0], [0, 0, 6]), grid([12, 0, 0], [8, 0, 0], [0, 0, 6]),
        grid([8, 0.3, 0], [4, 0, 0], [0, 0, 6]),  # a niche of 30 cm, and its sides
        grid([8, 0, 0], [0, 0.3, 0], [0, 0, 6]), grid([12, 0.3, 0], [0, -0.3, 0], [0, 0, 6]),
        grid([20, 0, 0], [0, 10, 0], [0, 0, 6]), grid([20, 10, 0], [-20, 0, 0], [0, 0, 6]),
        grid([0, 10, 0], [0, -10, 0], [0, 0, 6]), grid([0, 0, 6], [20, 0, 0], [0, 10, 0]),
        grid([0, 0, 0], [0, 10, 0], [20, 0, 0]),
    ]  # fmt: skip
    room = [grid([15, 3, 1], [0, 4, 0], [0, 0, 3]), grid([5, 7, 1], [0, -4, 0], [0, 0, 3])]
    surface = mesh(*wall, *room)
    planes = segment_facade_planes(surface)
    area = dict(zip(planes.names, np.bincount(planes.plane_of_triangle, weights=surface.areas_m2), strict=True))
    # m2: the niche's back counts with the wall, and its sides may, with the triangles at their corners.
    assert 20 * 6 - 1e-6 < area["facade-S-1"] < 20 * 6 + 2 * 0.3 * 6 + 2
    assert abs(area["inside-1"] - 2 * 4 * 3) < 1e-6  # m2


def test_elements_have_storey_facade_class_and_geometry() -> None:
    surface = mesh(*house())
    planes = segment_facade_planes(surface)
    floors = (StoreyLevel(name="Ground floor", floor_site_m=0.0), StoreyLevel(name="Attic", floor_site_m=6.0))
    rows = {row["element_guid"]: row for row in build_plane_elements(planes, surface, ORIGIN, floors).to_pylist()}
    assert rows["facade-S-1"]["storey"] == "Ground floor" and rows["facade-S-2"]["storey"] == "Attic"
    assert rows["level-1"]["storey"] is None and rows["level-1"]["facade"] == "level"
    assert sum(row["triangles"] for row in rows.values()) == len(surface.triangles)
    assert all(row["ifc_class"] == "Surface" and row["geometry"] for row in rows.values())
