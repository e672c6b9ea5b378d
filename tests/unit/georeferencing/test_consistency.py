"""The same surface is distinguished from a similar one, and a bent block is not taken for the latter."""

from dataclasses import replace

import numpy as np
import pytest

from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.campaign.consistency import (
    compute_chi_square,
    compute_misfit,
    count_shared_cells,
    extend_agreement_by_bending,
    remove_bending,
)
from facadelake.georeferencing.campaign.matching import match_reference
from tests.unit.georeferencing.test_reference_matching import build_true_reference
from tests.unit.georeferencing.two_campaigns import (
    ORIGIN,
    build_campaign,
    change_light,
    draw_descriptors,
    draw_facade_points,
    draw_similarity,
)  # fmt: skip

BAY_M = 6.0


def build_similar_facades(built_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A wall of bays; the earlier campaign sees the first, the later one the second, whose windows look the same.

    Returns both campaigns' points and descriptors; ``built_m`` is how exactly the windows were built alike.
    """
    rng = np.random.default_rng(21)
    windows = np.column_stack([rng.uniform(0, BAY_M, 400), -rng.uniform(0, 0.1, 400), rng.uniform(0, 9, 400)])
    windows = windows[(windows[:, 0] % 2.0 < 0.8) & (windows[:, 2] % 3.0 < 1.5)]
    wall = np.column_stack([rng.uniform(0, BAY_M, 900), np.zeros(900), rng.uniform(0, 9, 900)])
    looks = draw_descriptors(len(windows), rng)
    first = np.concatenate([windows, wall])
    alike = windows + rng.normal(0, built_m, windows.shape)
    second = np.concatenate([alike, wall[::-1] * [1, 1, 0.99]]) + np.array([BAY_M, 0, 0])
    return (
        first,
        np.concatenate([looks, draw_descriptors(900, rng)]),
        second,
        np.concatenate([change_light(looks, rng), draw_descriptors(900, rng)]),
    )


@pytest.mark.parametrize(("built_m", "far"), [(0.03, "[3-9]\\.\\d times"), (0.0, "[01]\\.\\d times")])
def test_windows_of_another_bay_are_not_the_same_windows(built_m: float, far: str) -> None:
    """By their centimetres where they were built by hand, and by the walls between them however they were built."""
    rng = np.random.default_rng(22)
    first, looks_first, second, looks_second = build_similar_facades(built_m)
    earlier = build_campaign(first, looks_first, draw_similarity(1), rng)
    later = build_campaign(second, looks_second, draw_similarity(2), rng)
    message = f"surface that looks alike: residuals are {far} .* in \\d+ of the \\d+ cells"
    with pytest.raises(GeoreferenceError, match=message):
        match_reference(later.reconstruction, later.descriptors, build_true_reference(earlier), origin=ORIGIN)


def test_a_bent_block_still_finds_its_building() -> None:
    """A doming of 6 cm is ten times the points' sigmas, yet no sign of another surface."""
    rng = np.random.default_rng(23)
    xyz, looks = draw_facade_points(1500, rng), draw_descriptors(1500, rng)
    earlier = build_campaign(xyz, looks, draw_similarity(1), rng)
    later = build_campaign(xyz, change_light(looks, rng), draw_similarity(2), rng)
    site = later.site_from_sfm.apply(later.reconstruction.xyz_sfm)
    dome = 0.06 * ((site[:, :1] - 10) / 10) ** 2 * [0.0, 1.0, 0.5]
    bent = replace(later.reconstruction, xyz_sfm=later.site_from_sfm.invert().apply(site + dome))
    found = match_reference(bent, later.descriptors, build_true_reference(earlier), origin=ORIGIN)
    assert 0.5 < found.misfit < 1.3
    assert len(found.point) > 1300
    assert 0.01 < np.linalg.norm(found.residual_m, axis=1).mean() < 0.04  # m: left to the adjustment, not hidden


def test_bending_is_taken_out_and_scatter_is_left() -> None:
    rng = np.random.default_rng(24)
    xyz = draw_facade_points(3000, rng)
    covariance = np.broadcast_to(np.diag([0.005, 0.01, 0.005]) ** 2, (3000, 3, 3))
    scatter = rng.normal(0, [0.005, 0.01, 0.005], (3000, 3))
    bending = 0.002 * (xyz[:, :1] - 3) * (xyz[:, 2:] + 1) * [1, 2, 3]
    wrong = rng.random(3000) < 0.05
    residual = scatter + bending + np.where(wrong[:, None], 0.2, 0.0)
    left = remove_bending(xyz, residual, covariance)
    np.testing.assert_allclose(left[~wrong], scatter[~wrong], rtol=0, atol=0.004)  # m
    assert 0.95 < compute_misfit(compute_chi_square(left[~wrong], covariance[~wrong])) < 1.05
    assert compute_misfit(compute_chi_square(residual, covariance)) > 3
    few = xyz[:, 0] < 4  # 4 x 9 m: too small a part to separate bending from the offsets of single windows
    np.testing.assert_array_equal(remove_bending(xyz[few], residual[few], covariance[few]), residual[few])


def test_a_stretched_block_keeps_its_right_pairs() -> None:
    """A focal length 9 % off, as four photographs leave it: a similarity joins a part, the rest follows."""
    rng = np.random.default_rng(25)
    xyz = draw_facade_points(2000, rng)
    wrong = rng.random(2000) < 0.3
    stretch = (xyz - [10, 5, 4]) * [0.0, 0.02, 0.06] + rng.normal(0, 0.01, (2000, 3))
    residual = np.where(wrong[:, None], rng.uniform(-5, 5, (2000, 3)), stretch)
    tolerance = np.full(2000, 0.12)
    joined = np.linalg.norm(residual, axis=1) < tolerance
    assert joined[~wrong].mean() < 0.6
    found = extend_agreement_by_bending(xyz, residual, joined, tolerance)
    assert found[~wrong].mean() > 0.99
    assert found[wrong].mean() < 0.01


def test_places_are_counted_where_both_campaigns_have_points() -> None:
    place = np.column_stack([np.arange(6), np.zeros(6), np.zeros(6)]) + 0.5
    earlier, later = np.repeat(place[:4], 3, axis=0), np.repeat(place[1:], 3, axis=0)
    assert count_shared_cells(later, earlier, place[[1, 5]]) == (1, 3)
    assert count_shared_cells(later[::3], earlier, place) == (0, 0)  # one point does not make a place
