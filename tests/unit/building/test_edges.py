"""Edges of small meshes, counted by hand."""

import numpy as np
import pytest

from facadelake.building.surface.edges import ModelEdges, extract_model_edges
from facadelake.core.arrays import Float64Array

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1.0]])
_BOX = np.array(
    [
        *([0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4]),
        *([1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]),
    ]
)


def _boxes(*corners_and_sizes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> ModelEdges:
    vertices = np.vstack([np.array(corner) + _CORNERS * np.array(size) for corner, size in corners_and_sizes])
    triangles = np.vstack([_BOX + 8 * k for k in range(len(corners_and_sizes))])
    owner = np.repeat(np.arange(len(corners_and_sizes)), len(_BOX))
    return extract_model_edges(vertices, triangles, owner)


def _sorted_pieces(edges: ModelEdges) -> list[tuple[float, ...]]:
    ends = np.sort(np.stack([edges.start_site_m, edges.end_site_m], axis=1).round(6), axis=1)
    return sorted(tuple(piece.ravel().tolist()) for piece in ends)


def test_a_box_has_twelve_edges_and_no_diagonals() -> None:
    edges = _boxes(((10.0, 20.0, 30.0), (4.0, 1.0, 3.0)))
    assert len(edges.feature) == 12
    np.testing.assert_allclose(sorted(edges.length_m), [1.0] * 4 + [3.0] * 4 + [4.0] * 4, rtol=0, atol=1e-9)  # m
    assert len(np.unique(edges.feature)) == 12  # 1 m and more apart: each moves on its own


def test_edges_of_abutting_elements_become_one_piece_and_one_feature() -> None:
    """Two boxes end to end: the long edges run through; those of the seam are there once."""
    edges = _boxes(((0.0, 0.0, 0.0), (2.0, 1.0, 3.0)), ((2.0, 0.0, 0.0), (3.0, 1.0, 3.0)))
    np.testing.assert_allclose(sorted(edges.length_m), [1.0] * 6 + [3.0] * 6 + [5.0] * 4, rtol=0, atol=1e-9)  # m


def test_a_gap_separates_pieces_but_not_the_feature() -> None:
    """Two sills on one level, 1 m apart, are two pieces that move together."""
    edges = _boxes(((0.0, 0.0, 1.0), (1.0, 0.1, 0.05)), ((2.0, 0.0, 1.0), (1.0, 0.1, 0.05)))
    lengthwise = np.abs(edges.start_site_m - edges.end_site_m)[:, 0] > 0.5
    assert lengthwise.sum() == 8
    assert len(np.unique(edges.feature[lengthwise])) == 1


def test_rungs_of_a_ladder_do_not_chain_into_one_feature() -> None:
    edges = _boxes(*[((0.0, 0.0, 0.2 * k), (2.0, 0.01, 0.01)) for k in range(12)])
    heights = [edges.start_site_m[edges.feature == f, 2] for f in np.unique(edges.feature)]
    assert max(np.ptp(z) for z in heights) <= 2 * 0.25  # m: each within the radius of its leader
    assert len(heights) >= 4


@pytest.mark.parametrize(("sides", "vertical"), [(6, 6), (40, 0)])
def test_a_curve_made_of_flat_pieces_has_no_creases_along_it(sides: int, vertical: int) -> None:
    """A prism of 6 sides turns by 60 degrees at each; one of 40 by 9 is a cylinder."""
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)])
    vertices = np.vstack([ring, ring + np.array([0, 0, 2.0])])
    k = np.arange(sides)
    after = (k + 1) % sides
    triangles = np.vstack([np.column_stack([k, after, after + sides]), np.column_stack([k, after + sides, k + sides])])
    edges = extract_model_edges(vertices, triangles, np.zeros(len(triangles), dtype=np.int64))
    upright = np.abs(edges.end_site_m - edges.start_site_m)[:, 2] > 1.0
    assert upright.sum() == vertical
    assert (~upright).sum() == 2 * sides  # the open rims are free borders


def test_the_same_edges_wherever_the_building_stands_and_however_it_is_turned() -> None:
    sizes = (
        ((0.0, 0.0, 0.0), (2.0, 1.0, 3.0)),
        ((2.0, 0.0, 0.0), (3.0, 1.0, 3.0)),
        ((0.5, -0.2, 1.0), (1.0, 0.2, 0.3)),
    )
    here = _boxes(*sizes)
    angle = np.radians(33.0)
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    offset = np.array([300.0, -200.0, 50.0])

    def transform_points(points: Float64Array) -> Float64Array:
        return points @ rotation.T + offset

    vertices = transform_points(np.vstack([np.array(corner) + _CORNERS * np.array(size) for corner, size in sizes]))
    triangles = np.vstack([_BOX + 8 * k for k in range(3)])
    there = extract_model_edges(vertices, triangles, np.repeat(np.arange(3), 12))
    back = ModelEdges(
        start_site_m=(there.start_site_m - offset) @ rotation,
        end_site_m=(there.end_site_m - offset) @ rotation,
        feature=there.feature,
    )
    np.testing.assert_allclose(_sorted_pieces(back), _sorted_pieces(here), rtol=0, atol=1e-5)  # m
    assert len(np.unique(there.feature)) == len(np.unique(here.feature))


def test_a_flat_sheet_has_its_border_alone_and_an_empty_mesh_nothing() -> None:
    sheet = np.array([[0, 0, 0], [4, 0, 0], [4, 0, 3], [0, 0, 3.0]])
    border = extract_model_edges(sheet, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(2, dtype=np.int64))
    np.testing.assert_allclose(sorted(border.length_m), [3, 3, 4, 4], rtol=0, atol=1e-9)  # m
    nothing = extract_model_edges(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64))
    assert len(nothing.feature) == 0
