"""Mutual neighbours among descriptors, and the similarity that a small share of pairs agrees on."""

import numpy as np
import pytest

from facadelake.georeferencing.campaign import descriptor_matching as descriptor_pairs
from facadelake.georeferencing.campaign.descriptor_matching import match_descriptors
from facadelake.georeferencing.campaign.similarity_search import search_similarity
from tests.unit.georeferencing.two_campaigns import change_light, draw_descriptors, draw_facade_points, draw_similarity


def test_mutual_pairs_are_those_of_brute_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent path: all distances at once in float64; tiles small enough that every border is crossed."""
    monkeypatch.setattr(descriptor_pairs, "_TILE_ROWS", 64)
    monkeypatch.setattr(descriptor_pairs, "_TILE_COLUMNS", 50)
    rng = np.random.default_rng(1)
    a = draw_descriptors(300, rng)
    b = np.concatenate([change_light(a[rng.permutation(300)[:180]], rng), draw_descriptors(40, rng)])
    unit_a, unit_b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a.astype(float), b.astype(float)))
    distance = np.linalg.norm(unit_a[:, None] - unit_b, axis=2)
    nearest, sorted_ = distance.argmin(axis=1), np.sort(distance, axis=1)
    mutual = distance.argmin(axis=0)[nearest] == np.arange(300)
    ratio = sorted_[:, 0] / sorted_[:, 1]
    expected = {(i, int(nearest[i])): ratio[i] for i in np.flatnonzero(mutual & (ratio <= 0.9))}
    found = match_descriptors(a, b, max_ratio=0.9)
    assert dict.fromkeys(zip(found.a.tolist(), found.b.tolist(), strict=True)).keys() == expected.keys()
    assert 150 < len(found) <= 180
    ratios = [expected[pair] for pair in zip(found.a.tolist(), found.b.tolist(), strict=True)]
    np.testing.assert_allclose(found.ratio, ratios, rtol=0, atol=1e-3)
    assert (np.diff(found.ratio) >= 0).all()


def test_what_looks_alike_twice_is_no_pair() -> None:
    rng = np.random.default_rng(2)
    a = draw_descriptors(50, rng)
    assert len(match_descriptors(a, np.concatenate([a, a[:20]]), max_ratio=0.9)) == 30
    assert len(match_descriptors(a, a[:1], max_ratio=0.9)) == 0  # nothing to compare the nearest with
    assert len(match_descriptors(a[:0], a, max_ratio=0.9)) == 0


@pytest.mark.parametrize("share", [0.6, 0.1])
def test_the_shared_similarity_is_found_among_wrong_pairs(share: float) -> None:
    rng = np.random.default_rng(3)
    target, truth = draw_facade_points(3000, rng), draw_similarity(4)
    right = rng.random(3000) < share
    source = truth.invert().apply(
        np.where(right[:, None], target + rng.normal(0, 0.01, (3000, 3)), draw_facade_points(3000, rng))
    )
    found = search_similarity(source, target, np.full(3000, 0.10))
    assert found is not None
    assert found.agrees[right].mean() > 0.99
    assert found.agrees[~right].mean() < 0.01
    off_m = np.linalg.norm(found.target_from_source.apply(source[right]) - truth.apply(source[right]), axis=1)
    assert 1e-6 < off_m.max() < 0.01  # m


def test_pairs_without_a_common_similarity_give_none_or_a_handful() -> None:
    rng = np.random.default_rng(5)
    found = search_similarity(
        draw_facade_points(500, rng), draw_facade_points(500, rng)[rng.permutation(500)], np.full(500, 0.10)
    )
    assert found is None or found.agrees.sum() < 15


def test_points_on_a_line_fix_no_similarity() -> None:
    line = np.linspace(0, 20, 200)[:, None] * np.array([1.0, 0.2, 0.1])
    assert search_similarity(line, line, np.full(200, 0.05)) is None
