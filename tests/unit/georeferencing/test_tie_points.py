"""Which tie points are adjusted, what their dependence costs, and which of them belong to the model's faces."""

from dataclasses import replace

import numpy as np
import pytest

from facadelake.georeferencing.adjustment.parameters import AdjustmentState, initialise_state
from facadelake.georeferencing.adjustment.point_to_plane import match_points_to_surface
from facadelake.georeferencing.adjustment.tie_points import (
    TiePointSelection,
    build_block,
    choose_tie_points,
    estimate_tie_variance_factor,
)
from tests.unit.georeferencing.small_block import (
    NORMALS,
    PLANES_M,
    SITE_FROM_SFM,
    BoxSurface,
    SmallBlock,
    build_reconstruction,
    build_small_block,
    build_tie_point_problem,
)


@pytest.fixture(scope="module")
def block() -> SmallBlock:
    """A box seen all around."""
    return build_small_block(points=400)


def test_each_photograph_keeps_its_longest_tracks_and_no_more_than_it_needs(block: SmallBlock) -> None:
    reconstruction = build_reconstruction(block, np.random.default_rng(1), tie_px=0.0)
    ties = choose_tie_points(reconstruction, SITE_FROM_SFM, max_per_photo=20)
    length = np.bincount(block.point)
    for photo in range(len(block.cameras)):
        seen = np.unique(block.point[block.photo == photo])
        longest = np.sort(length[seen])[::-1][:20]
        kept = np.intersect1d(seen, ties.reconstruction_point)
        assert np.sort(length[kept])[::-1][:20].tolist() == longest.tolist()
    assert 20 < len(ties.reconstruction_point) <= 20 * len(block.cameras)
    everything = choose_tie_points(reconstruction, SITE_FROM_SFM)
    assert len(everything.photo) == len(block.photo)


def test_chosen_ties_are_the_reconstructions_in_site(block: SmallBlock) -> None:
    reconstruction = build_reconstruction(block, np.random.default_rng(1), tie_px=0.0, start_m=0.0)
    ties = choose_tie_points(reconstruction, SITE_FROM_SFM, max_per_photo=30)
    np.testing.assert_allclose(ties.xyz_site_m, block.xyz_m[ties.reconstruction_point], rtol=0, atol=1e-9)  # m
    for photo, node, xy in zip(ties.photo[::50], ties.point[::50], ties.xy_img[::50], strict=True):
        seen = block.cameras[photo].project_site(block.xyz_m[ties.reconstruction_point[node]][None])[0]
        np.testing.assert_allclose(xy, seen, rtol=0, atol=1e-6)  # px
    first = [ties.photo[ties.point == node].min() for node in range(len(ties.reconstruction_point))]
    assert first == sorted(first), "neighbours in the list share photographs"


def test_the_block_stands_where_the_similarity_puts_it(block: SmallBlock) -> None:
    reconstruction = build_reconstruction(block, np.random.default_rng(1), tie_px=0.0, start_m=0.0)
    found = build_block(reconstruction, SITE_FROM_SFM)
    np.testing.assert_allclose(found.centre_site_m, block.centres_m, rtol=0, atol=1e-9)  # m
    np.testing.assert_allclose(found.site_from_cam, block.rotations, rtol=0, atol=1e-12)
    assert (len(found.cameras), found.camera_of_photo.tolist()) == (1, [0] * 12)
    other = replace(
        reconstruction.photos[2], camera=replace(reconstruction.photos[2].camera, fx_px=3000.0, fy_px=3000.0)
    )
    two = replace(reconstruction, photos=(*reconstruction.photos[:2], other, *reconstruction.photos[3:]))
    assert build_block(two, SITE_FROM_SFM).camera_of_photo.tolist() == [0, 0, 1] + [0] * 9


def draw_correlated_errors(common: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals of unit variance, of which a share ``common`` is the same within a cell of 1000 px."""
    rng = np.random.default_rng(seed)
    photo = np.repeat(np.arange(8), 600)
    xy = rng.uniform(0, [6000, 4000], (len(photo), 2))
    cell = photo * 24 + (xy[:, 0] // 1000).astype(int) * 4 + (xy[:, 1] // 1000).astype(int)
    shared = rng.normal(0, 1, (8 * 24, 2))[cell]
    return np.sqrt(common) * shared + np.sqrt(1 - common) * rng.normal(0, 1, (len(photo), 2)), photo, xy


def test_independent_errors_are_not_inflated() -> None:
    found = [estimate_tie_variance_factor(*draw_correlated_errors(0.0, seed)) for seed in range(6)]
    assert min(found) >= 1.0
    assert max(found) < 1.25


def test_errors_that_neighbours_share_are_inflated_by_their_number() -> None:
    """25 points a cell, 20 % of the variance common: n |mean|^2 is 1 - 0.2 + 25 * 0.2 = 5.8 times a single one's."""
    found = np.mean([estimate_tie_variance_factor(*draw_correlated_errors(0.2, seed)) for seed in range(4)])
    assert 4.0 < found < 7.5
    assert 1.0 < np.mean([estimate_tie_variance_factor(*draw_correlated_errors(0.02, seed)) for seed in range(4)]) < 2.2


def test_outliers_and_empty_cells_do_not_inflate() -> None:
    residual, photo, xy = draw_correlated_errors(0.0, 1)
    residual[::10] += 40.0
    assert estimate_tie_variance_factor(residual, photo, xy) < 1.3
    assert estimate_tie_variance_factor(residual[:4], photo[:4], xy[:4]) == 1.0


def build_offset_points(block: SmallBlock, offset_m: np.ndarray) -> tuple[TiePointSelection, AdjustmentState]:
    """Ties and a state whose points stand ``offset_m`` (5,) off their planes."""
    reconstruction = build_reconstruction(block, np.random.default_rng(1), tie_px=0.0, start_m=0.0)
    ties = choose_tie_points(reconstruction, SITE_FROM_SFM)
    state = initialise_state(
        build_tie_point_problem(block, np.random.default_rng(1), tie_px=0.0, start_m=0.0, start_deg=0.0)
    )
    plane = block.plane[ties.reconstruction_point]
    return ties, replace(
        state, xyz_site_m=block.xyz_m[ties.reconstruction_point] + offset_m[plane][:, None] * NORMALS[plane]
    )


def test_points_belong_to_the_face_that_they_were_seen_on(block: SmallBlock) -> None:
    ties, state = build_offset_points(block, np.array([0.2, -0.1, 0.05, 0.0, -0.2]))
    walls = match_points_to_surface(ties, state, BoxSurface(), gate_m=0.3, model_sigma_m=0.02)
    plane = block.plane[ties.reconstruction_point[walls.point]]
    assert len(walls.point) > 350
    right = np.isclose(np.einsum("ij,ij->i", walls.normal_site, NORMALS[plane]), 1.0, rtol=0, atol=1e-9)
    assert right.mean() > 0.97  # at a corner a ray that passes the edge meets the other face
    np.testing.assert_allclose(walls.distance_m[right], PLANES_M[plane][right], rtol=0, atol=1e-9)  # m
    assert len(walls.wall_sigma_m) == 5
    for number in range(5):
        assert len(np.unique(plane[right & (walls.wall == number)])) == 1


def test_points_beyond_the_gate_belong_to_no_face(block: SmallBlock) -> None:
    ties, state = build_offset_points(block, np.array([0.4, 0.0, 0.0, 0.0, 0.0]))
    walls = match_points_to_surface(ties, state, BoxSurface(), gate_m=0.3, model_sigma_m=0.02)
    plane = block.plane[ties.reconstruction_point[walls.point]]
    assert (plane == 0).sum() <= 2
    assert (plane == 1).sum() > 60
    assert not len(
        match_points_to_surface(
            ties, state, BoxSurface(half_m=(1.0, 1.0), ground=False), gate_m=0.3, model_sigma_m=0.02
        ).point
    )
