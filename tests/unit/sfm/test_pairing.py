"""Which photographs are matched."""

import numpy as np
import pytest

from facadelake.core.errors import InputDataError
from facadelake.georeferencing.gps.priors import rotation_from_attitude
from facadelake.sfm.pairing import choose_pairs, direction_from_yaw_pitch, find_uncertain_positions
from facadelake.sfm.settings import ReconstructionSettings


def strip(n: int) -> np.ndarray:
    """Photographs every 2 m on a line."""
    return np.column_stack([2.0 * np.arange(n), np.zeros(n), np.full(n, 5.0)])


UNKNOWN = np.full((60, 3), np.nan)
ALL_FAR = np.zeros(60, dtype=bool)
FEW = ReconstructionSettings(exhaustive_up_to=10, neighbours=6)


def test_small_sets_are_matched_exhaustively() -> None:
    pairs = choose_pairs(UNKNOWN[:9], UNKNOWN[:9], ALL_FAR[:9], FEW)
    assert len(pairs) == 36
    assert all(i < j for i, j in pairs)


def test_large_sets_are_matched_with_neighbours_only() -> None:
    pairs = choose_pairs(strip(60), UNKNOWN, ALL_FAR, FEW)
    assert pairs == sorted(set(pairs))
    # Six nearest on a line are three on either side; at the ends up to six on one side.
    assert max(j - i for i, j in pairs) == 6
    assert {(20, 21), (20, 22), (20, 23)} <= set(pairs)
    assert len(pairs) < 60 * 5


def test_opposite_views_are_not_matched() -> None:
    """Two rows back to back: each photograph's partner behind it is nearest, but sees the other side."""
    xyz = np.vstack([strip(30), strip(30) + np.array([0, 0.5, 0])])
    yaw = np.array([0.0] * 30 + [180.0] * 30)
    pairs = choose_pairs(xyz, direction_from_yaw_pitch(yaw, np.zeros(60)), ALL_FAR, FEW)
    across = [(i, j) for i, j in pairs if (i < 30) != (j < 30)]
    assert across == [(28, 30), (29, 30), (29, 31)]  # the sequence alone joins them


def test_a_photograph_without_position_has_its_sequence_and_is_uncertain() -> None:
    xyz = strip(60)
    xyz[17] = np.nan
    pairs = set(choose_pairs(xyz, UNKNOWN, ALL_FAR, FEW))
    assert {j for i, j in pairs if i == 17} | {i for i, j in pairs if j == 17} == set(range(12, 23)) - {17}
    assert np.flatnonzero(find_uncertain_positions(xyz, np.full((60, 3), 0.5), FEW)).tolist() == [17]


def test_positions_that_do_not_identify_neighbours_are_uncertain() -> None:
    """Six neighbours lie within 6 m (12 m at the strip's ends): a sigma of 2.5 m tells them apart, 7 m does not."""
    sigma = np.full((60, 3), 2.5)
    sigma[30] = 7.0
    assert np.flatnonzero(find_uncertain_positions(strip(60), sigma, FEW)).tolist() == [30]
    cut_off = strip(60)
    cut_off[10:14] = cut_off[10]
    assert np.flatnonzero(find_uncertain_positions(cut_off, np.full((60, 3), 0.5), FEW)).tolist() == [10, 11, 12, 13]
    hovering = strip(60)
    hovering[11] = hovering[10]
    assert not find_uncertain_positions(hovering, np.full((60, 3), 0.5), FEW).any()
    assert not find_uncertain_positions(UNKNOWN[:9], UNKNOWN[:9], FEW).any()  # all pairs are matched


@pytest.mark.parametrize("placed", [True, False])
def test_pairs_grow_with_the_photographs_not_their_square(placed: bool) -> None:
    """A facade of ten rows: four times the photographs, about four times the pairs."""

    def count(n: int) -> int:
        step, row = np.divmod(np.arange(n), 10)
        xyz = np.column_stack([2.0 * step, np.zeros(n), 2.0 * row]) if placed else np.full((n, 3), np.nan)
        direction = np.tile([0.0, 1.0, 0.0], (n, 1))
        return len(choose_pairs(xyz, direction, np.arange(n) % 5 == 0, FEW))

    assert 3.8 < count(400) / count(100) < 4.4


def test_a_close_range_photograph_meets_those_whose_view_holds_its_place() -> None:
    """Two facades at a corner; close to the first stands a photograph, nearer to those that look at the second."""
    first = np.column_stack([2.0 * np.arange(20), np.full(20, -12.0), np.full(20, 5.0)])  # looking north at y = 0
    second = np.column_stack([np.full(20, 41.0), 1.0 - 0.4 * np.arange(20), np.full(20, 5.0)])  # looking east
    close = np.array([[38.0, -2.0, 5.0]])
    direction = np.array([[0.0, 1, 0]] * 20 + [[1.0, 0, 0]] * 20 + [[0.0, 1, 0]])
    role = np.array([False] * 40 + [True])
    settings = ReconstructionSettings(exhaustive_up_to=10, neighbours=4)
    xyz = np.vstack([first, second, close])
    pairs = choose_pairs(xyz, direction, role, settings, half_view_deg=np.full(41, 35.0))
    partners = {i for i, j in pairs if j == 40} - {38, 39}  # those before it in the sequence
    assert {18, 19} <= partners


def test_close_range_photographs_meet_the_others() -> None:
    """A crowd of close-range photographs, whose nearest neighbours are all close-range."""
    xyz = np.vstack([strip(40), [[20.0 + 0.01 * k, 3.0, 5.0] for k in range(20)]])
    close = np.array([False] * 40 + [True] * 20)
    pairs = choose_pairs(xyz, UNKNOWN, close, FEW)
    for k in range(45, 60):
        assert any(i < 40 for i, j in pairs if j == k)


def test_the_viewing_direction_is_the_optical_axis_of_the_attitude() -> None:
    """East is yaw 90; and a camera tilted down 30 deg looks down by its sine."""
    np.testing.assert_allclose(
        direction_from_yaw_pitch(np.array([90.0]), np.array([0.0]))[0], [1, 0, 0], rtol=0, atol=1e-12
    )
    down = direction_from_yaw_pitch(np.array([35.0]), np.array([-30.0]))[0]
    assert down[2] == pytest.approx(-0.5)
    rotation = rotation_from_attitude(35.0, -30.0, 0.0)
    np.testing.assert_allclose(rotation[:, 2], down, rtol=0, atol=1e-12)
    assert abs(rotation[2, 0]) < 1e-12  # without roll the camera's x is level
    assert rotation[2, 1] < 0  # and its y points down
    assert rotation_from_attitude(35.0, -30.0, 10.0)[2, 0] == pytest.approx(
        -np.sin(np.radians(10)) * np.cos(np.radians(30))
    )


def test_settings_refuse_the_impossible() -> None:
    with pytest.raises(InputDataError, match="max_image_px is 100; it must be 400 or more"):
        ReconstructionSettings(max_image_px=100)
    assert ReconstructionSettings(threads=1).cache_key == ReconstructionSettings(threads=2).cache_key
