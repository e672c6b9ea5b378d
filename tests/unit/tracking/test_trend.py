"""Rates of growth hold the truth whether growth is steady or accelerates, and so do the dates of limits."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.drawn_growth import count_held_trends
from facadelake.tracking import fit_trend, predict_limit

YEAR = np.array([0.0, 1.0, 2.0, 3.0])


@pytest.mark.parametrize("kind", ["by the same amount", "by the same share"])
@pytest.mark.parametrize("campaigns", [3, 4, 6])
def test_intervals_hold_the_truth(kind: str, campaigns: int) -> None:
    counts = count_held_trends(kind, campaigns, 100)
    assert counts.rates_held >= 90
    assert counts.dates_held >= 0.9 * counts.dates > 60


def test_the_latest_rate_of_accelerating_growth_is_inside_its_interval() -> None:
    """Hardly any growth, then half as much again in half a year: the mean slope says 2042, the last two sizes 2029."""
    year = np.array([25.25, 25.8, 26.28, 26.78])
    size = np.array([0.100, 0.101, 0.103, 0.155])
    trend = fit_trend(year, size, 0.03 * size)
    assert trend is not None and not trend.is_line
    latest = (size[3] - size[2]) / (year[3] - year[2])
    low, high = trend.interval_per_year
    assert low < latest < high
    assert trend.per_year > 2 * trend.mean_per_year
    predicted = predict_limit(trend, 0.4)
    by_latest_rate = year[3] + (0.4 - size[3]) / latest
    assert predicted is None or predicted[0] < by_latest_rate < predicted[2]


def test_steady_growth_is_a_line_and_its_limit_is_predicted() -> None:
    growing = fit_trend(YEAR, 1 + 0.2 * YEAR, np.full(4, 0.02))
    assert growing is not None and growing.is_line
    assert growing.per_year == pytest.approx(0.2, abs=0.02) and growing.mean_per_year == pytest.approx(0.2)
    predicted = predict_limit(growing, 2.0)
    assert predicted is not None and predicted[0] < predicted[1] < predicted[2]
    assert predicted[1] == pytest.approx(5.0, abs=0.3)


def test_without_growth_no_date_is_said() -> None:
    steady = fit_trend(YEAR, np.ones(4), np.full(4, 0.05))
    assert steady is not None and predict_limit(steady, 2.0) is None


def test_a_limit_beyond_a_hundred_years_has_no_date() -> None:
    slow = fit_trend(YEAR, 1 + 0.001 * YEAR, np.full(4, 1e-4))
    assert slow is not None
    predicted = predict_limit(slow, 3.0)
    assert predicted is not None and np.isinf(predicted[1])


def test_a_limit_that_is_reached_already_is_of_the_latest_campaign() -> None:
    growing = fit_trend(YEAR, 1 + 0.2 * YEAR, np.full(4, 0.01))
    assert growing is not None
    predicted = predict_limit(growing, 1.2)
    assert predicted is not None and (predicted == 3.0).all()


def test_a_trend_needs_three_times() -> None:
    assert fit_trend(YEAR[:2], np.ones(2), np.full(2, 0.1)) is None
    assert fit_trend(np.array([0.0, 1.0, 1.0]), np.ones(3), np.full(3, 0.1)) is None
    assert fit_trend(YEAR, np.array([1.0, np.nan, 1.0, np.nan]), np.full(4, 0.1)) is None


def test_widths_that_grow_with_the_pixels_are_no_trend() -> None:
    pixel = np.array([4.0, 6.0, 8.0, 10.0])
    width, sigma = 5 + 2 * pixel, np.full(4, 0.5)
    naive, trend = fit_trend(YEAR, width, sigma), fit_trend(YEAR, width, sigma, 2.0 * pixel)
    assert naive is not None and naive.interval_per_year[0] > 0
    assert trend is not None and trend.interval_per_year[0] < 0 < trend.interval_per_year[1]
