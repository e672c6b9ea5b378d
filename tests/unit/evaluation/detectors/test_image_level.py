"""AUROC and average precision of whole photographs, by hand and by counting pairs."""

from __future__ import annotations

import numpy as np
import pytest

from facadelake.evaluation.detectors.image_level import compute_auroc, compute_image_average_precision


def test_by_hand() -> None:
    scores, positive = np.array([0.9, 0.8, 0.7, 0.6, 0.5]), [True, False, True, False, False]
    assert compute_auroc(scores, positive) == pytest.approx(5 / 6)  # of six pairs one is the wrong way round
    assert compute_image_average_precision(scores, positive) == pytest.approx((1 + 2 / 3) / 2)


def test_equal_scores_are_guesses() -> None:
    scores, positive = np.zeros(10), [True] * 3 + [False] * 7
    assert compute_auroc(scores, positive) == 0.5
    assert compute_image_average_precision(scores, positive) == pytest.approx(0.3)
    assert compute_image_average_precision(scores, positive[::-1]) == pytest.approx(0.3)


def test_by_pairs() -> None:
    random = np.random.default_rng(5)
    scores, positive = random.integers(0, 6, 60) / 5, random.random(60) < 0.4
    pairs = [(a > b) + 0.5 * (a == b) for a in scores[positive] for b in scores[~positive]]
    assert compute_auroc(scores, positive) == pytest.approx(float(np.mean(pairs)), abs=1e-12)


def test_one_kind_alone_has_none() -> None:
    assert np.isnan(compute_auroc(np.ones(3), [True] * 3)) and np.isnan(
        compute_image_average_precision(np.ones(3), [False] * 3)
    )
