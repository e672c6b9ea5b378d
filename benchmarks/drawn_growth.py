"""Drawn sizes of one defect over three to six campaigns: how often trends and dates of limits hold the truth.

Sizes grow by a factor of 1.3 to 4 over the campaigns, half a year or a year apart: by the same amount, by the same
share, in proportion to time squared, or in steps. They are measured with a sigma of 2, 5 or 10 %. The limit is 1.2 to 2
times the latest size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64N
from facadelake.tracking import Trend, fit_trend, predict_limit

Growth = Callable[[Float64N], Float64N]
_STEPS = 3.0  # on average over the campaigns
_AHEAD_YEARS = np.concatenate([[0.0], np.geomspace(0.001, 100.0, 20_000)])
_AHEAD_TOLERANCE = 0.02  # of the time ahead: dates are found on a grid


@dataclass(kw_only=True)
class TrendCounts:
    """Trends, of which ``rates_held`` hold the latest true rate; ``dates`` that were said, of which ``dates_held`` hold
    the true one and ``ends`` have a latest one."""

    trends: int = 0
    rates_held: int = 0
    dates: int = 0
    dates_held: int = 0
    ends: int = 0


def count_held_trends(kind: str, campaigns: int, seeds: int) -> TrendCounts:
    """Draw histories of a ``kind`` of growth (``GROWTHS``) and count what holds."""
    counts = TrendCounts()
    for seed in range(seeds):
        rng = np.random.default_rng([seed, campaigns])
        year: Float64N = np.arange(campaigns, dtype=np.float64) * float(rng.choice([0.5, 1.0]))
        growth = GROWTHS[kind](rng, float(year[-1]))
        true = growth(year)
        sigma = float(rng.choice([0.02, 0.05, 0.10])) * true
        trend = fit_trend(year, true + sigma * rng.normal(size=campaigns), sigma)
        assert trend is not None
        low, high = trend.interval_per_year
        counts.trends += 1
        counts.rates_held += bool(low <= _find_latest_rate(kind, growth, year) <= high)
        _count_date(counts, trend, growth, float(true[-1] * rng.uniform(1.2, 2.0)))
    return counts


def _find_latest_rate(kind: str, growth: Growth, year: Float64N) -> float:
    """The rate at the latest campaign; of growth in steps, since the campaign before."""
    before = year[-2] if kind == "in steps" else year[-1] - 1e-4
    sizes = growth(np.array([before, year[-1]]))
    return float((sizes[1] - sizes[0]) / (year[-1] - before))


def _count_date(counts: TrendCounts, trend: Trend, growth: Growth, limit: float) -> None:
    predicted = predict_limit(trend, limit)
    if predicted is None:
        return
    reached = growth(trend.last_year + _AHEAD_YEARS) >= limit
    ahead = float(_AHEAD_YEARS[reached.argmax()]) if reached.any() else np.inf
    low, _, high = predicted - trend.last_year
    counts.dates += 1
    counts.dates_held += bool(low * (1 - _AHEAD_TOLERANCE) <= ahead <= high * (1 + _AHEAD_TOLERANCE))
    counts.ends += bool(np.isfinite(high))


def _draw_line(rng: np.random.Generator, span: float) -> Growth:
    rate = (_draw_factor(rng) - 1) / span
    return lambda year: np.asarray(1 + rate * year, dtype=np.float64)


def _draw_share(rng: np.random.Generator, span: float) -> Growth:
    share = np.log(_draw_factor(rng)) / span
    return lambda year: np.asarray(np.exp(share * year), dtype=np.float64)


def _draw_square(rng: np.random.Generator, span: float) -> Growth:
    rate = (_draw_factor(rng) - 1) / span**2
    return lambda year: np.asarray(1 + rate * year**2, dtype=np.float64)


def _draw_steps(rng: np.random.Generator, span: float) -> Growth:
    height = (_draw_factor(rng) - 1) / _STEPS
    steps = np.cumsum(rng.exponential(span / _STEPS, 1000))
    return lambda year: np.asarray(1 + height * np.searchsorted(steps, year), dtype=np.float64)


def _draw_factor(rng: np.random.Generator) -> float:
    return float(rng.uniform(1.3, 4.0))


GROWTHS: dict[str, Callable[[np.random.Generator, float], Growth]] = {
    "by the same amount": _draw_line,
    "by the same share": _draw_share,
    "with time squared": _draw_square,
    "in steps": _draw_steps,
}
