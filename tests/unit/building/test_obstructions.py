"""What hides the walls and is not in the model, by an as-built surface made by hand."""

from __future__ import annotations

import numpy as np

from facadelake.building.surface import Obstructions, Surface

# Two walls that meet in a corner at the origin: one faces south (y = 0, x < 0), one faces west (x = 0, y < 0).
CORNER = Surface.from_mesh(
    np.array([[-6, 0, 0], [0, 0, 0], [0, 0, 4], [-6, 0, 4], [0, -6, 0], [0, -6, 4]], dtype=np.float64),
    np.array([[0, 1, 2], [0, 2, 3], [4, 2, 1], [4, 5, 2]]),
)
CAMERA = np.array([-6.0, -6.0, 2.0])
PLACES = np.array([[-0.2, 0.0, 2.0], [0.0, -0.2, 2.0]])  # at the corner


def make_strip(*corners: tuple[float, float]) -> Surface:
    """An upright strip through points in plan, from z = 1.5 m to 2.5 m, with further points on the south wall."""
    plan = [*corners, *((-x, 0.0) for x in np.linspace(2, 6, 8))]
    vertices = np.array([[x, y, z] for x, y in plan for z in (1.5, 2.5)])
    triangles = []
    for left in range(0, 2 * (len(corners) - 1), 2):
        triangles += [[left, left + 2, left + 3], [left, left + 3, left + 1]]
    return Surface.from_mesh(vertices, np.array(triangles))


def test_a_triangle_across_a_corner_of_two_walls_is_no_obstruction() -> None:
    """Tie points are on both walls 1.2 m from the corner; the surface between them is 0.85 m before it."""
    bridge = make_strip((-1.2, 0.0), (0.0, -1.2))
    assert not Obstructions(bridge, CORNER, 0.01).find_hidden_points(CAMERA, PLACES).any()


def test_a_thing_in_the_corner_is_one() -> None:
    thing = make_strip((-1.2, 0.0), (-1.0, -1.0), (0.0, -1.2))
    assert Obstructions(thing, CORNER, 0.01).find_hidden_points(CAMERA, PLACES).all()
