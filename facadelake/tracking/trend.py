"""Rate of growth of a size at the latest of three or more campaigns, and when it reaches a limit.

Three kinds of growth are held equally probable beforehand: by the same amount every year, by the same share every year,
and at a rate that wanders from year to year (an integrated random walk about a straight line; Wahba 1978, JRSS B 40).
Each has the probability with which it explains the sizes by their sigmas (Bayesian model averaging), so that the
interval of the rate widens where the sizes leave open whether growth accelerates. The future wanders as the past did.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from facadelake.core.arrays import BoolArray, Float64Array, Float64N

_DRAWS = 400
# How much a wandering rate may change within a year, as shares of the size: one is as probable as the other.
_SHARES = np.geomspace(0.02, 2.0, 9)
_LINE_REFUSED = 0.01  # probability of a misfit of a straight line that is as large, or larger
_INTERVAL = (2.5, 50.0, 97.5)
HORIZON_YEARS = 100.0
_AHEAD_YEARS = np.concatenate([[0.0], np.geomspace(0.01, HORIZON_YEARS, 400)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Trend:
    """Growth of a size: ``per_year`` at the latest of ``campaigns`` campaigns, with its 95 % interval (2,).

    ``mean_per_year``: slope over all campaigns (Theil-Sen). ``is_line``: whether one straight line explains the sizes.
    ``last_year`` of the latest size; the draws (d,) are of the size and the rate then, of what the rate wanders by, and
    of the share by which it grows with the size.
    """

    per_year: float
    interval_per_year: Float64Array
    mean_per_year: float
    is_line: bool
    campaigns: int
    last_year: float
    draws_size: Float64N
    draws_per_year: Float64N
    draws_wander: Float64N
    draws_share: Float64N


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fits:
    """Of m kinds of growth: log likelihood (m,), size and rate at the latest campaign (m, 2), covariance (m, 2, 2)."""

    log_likelihood: Float64N
    state: Float64Array
    covariance: Float64Array


def fit_trend(year: Float64N, size: Float64N, sigma: Float64N, common: Float64N | None = None) -> Trend | None:
    """Growth of a size over three or more campaigns, its interval from the sizes' own sigmas.

    Args:
        year: times (n,) in years.
        size: sizes (n,).
        sigma: one sigma of each (n,).
        common: one sigma (n,) of each by an error that all have in common, such as blur; None: there is none.

    Returns:
        The trend; None for fewer than three sizes of different times.
    """
    common = np.zeros(len(size)) if common is None else common
    known = np.isfinite(size) & (size > 0) & np.isfinite(sigma) & np.isfinite(common)
    year, size, sigma, common = (values[known] for values in (year, size, sigma, common))
    if len(np.unique(year)) < 3:
        return None
    order = np.argsort(year)
    year, size, sigma, common = (values[order] for values in (year, size, sigma, common))
    middle = float(np.median(size))
    error = np.diag(sigma**2) + np.outer(common, common)
    by_amount = _fit_growth(year, size, error, np.concatenate([[0.0], _SHARES * middle]))
    by_share = _fit_growth(year, np.log(size), error / np.outer(size, size), np.zeros(1))
    # The same density of the sizes, and of what is known of size and rate beforehand.
    in_units = 2 * np.log(middle) - np.log(size).sum()
    log_odds = np.concatenate([by_amount.log_likelihood, by_share.log_likelihood + in_units])
    prior = np.concatenate([[1.0], np.full(len(_SHARES), 1 / len(_SHARES)), [1.0]])
    weight = prior * np.exp(log_odds - log_odds.max())
    random = np.random.default_rng(0)
    kind = random.choice(len(weight), _DRAWS, p=weight / weight.sum())
    wander = np.concatenate([[0.0], _SHARES * middle, [0.0]])[kind]
    state = np.concatenate([by_amount.state, by_share.state])[kind]
    drawn = state + _draw_errors(np.concatenate([by_amount.covariance, by_share.covariance])[kind], random)
    is_share = kind == len(weight) - 1
    at_last, per_year = _convert_shares(drawn, is_share)
    low, median, high = np.percentile(per_year, _INTERVAL).tolist()
    first, second = np.triu_indices(len(year), 1)
    apart = year[second] != year[first]
    slopes = (size[second] - size[first])[apart] / (year[second] - year[first])[apart]
    return Trend(
        per_year=median,
        interval_per_year=np.array([low, high]),
        mean_per_year=float(np.median(slopes)),
        is_line=_measure_misfit(year, size, error) <= chi2.isf(_LINE_REFUSED, len(year) - 2),
        campaigns=len(year),
        last_year=float(year[-1]),
        draws_size=at_last,
        draws_per_year=per_year,
        draws_wander=wander,
        draws_share=np.where(is_share, drawn[:, 1], 0.0),
    )


def predict_limit(trend: Trend, limit: float) -> Float64Array | None:
    """Earliest, most likely and latest year (3,) at which a size reaches a limit; None where that cannot be said.

    It cannot be said where the trend's interval includes no growth. Infinite: not within a hundred years.
    """
    if trend.interval_per_year[0] <= 0:
        return None
    ahead = _AHEAD_YEARS
    # A wandering rate has its error at the time ahead; the draws have it of either sign.
    luck = trend.draws_wander * np.random.default_rng(1).normal(size=_DRAWS) / np.sqrt(3)
    size = trend.draws_size[:, None] + trend.draws_per_year[:, None] * ahead + luck[:, None] * ahead**1.5
    is_share = trend.draws_share != 0
    exponent = np.minimum(trend.draws_share[is_share, None] * ahead, 50.0)
    size[is_share] = trend.draws_size[is_share, None] * np.exp(exponent)
    reached = size >= limit
    years = np.where(reached.any(axis=1), ahead[reached.argmax(axis=1)], np.inf)
    return trend.last_year + np.percentile(years, _INTERVAL, method="nearest")


def _fit_growth(year: Float64N, size: Float64N, error: Float64Array, wander: Float64N) -> _Fits:
    """Sizes (n,) about a straight line from which the rate wanders by ``wander`` (m,) within a year.

    The line is unknown beforehand: likelihoods are those of its residuals (restricted).
    """
    since = year - year[0]
    span = float(since[-1])
    line = np.column_stack([np.ones(len(year)), year - year[-1]])
    low, high = np.minimum.outer(since, since), np.maximum.outer(since, since)
    variance = wander[:, None, None] ** 2
    inverse = np.linalg.inv(error + variance * low**2 * (3 * high - low) / 6)
    information = line.T @ inverse @ line
    cofactor = np.linalg.inv(information)
    coefficients = (cofactor @ line.T @ inverse) @ size
    residual = size - coefficients @ line.T
    log_likelihood = 0.5 * (
        np.linalg.slogdet(inverse)[1]
        - np.linalg.slogdet(information)[1]
        - np.einsum("mi,mij,mj->m", residual, inverse, residual)
    )
    # Covariance of the size and the rate at the end with the sizes, and their own, by the walk alone.
    with_sizes = variance * np.stack([since**2 * (3 * span - since) / 6, since**2 / 2])
    own = variance * np.array([[span**3 / 3, span**2 / 2], [span**2 / 2, span]])
    gain = with_sizes @ inverse
    remaining = np.eye(2) - gain @ line
    return _Fits(
        log_likelihood=log_likelihood,
        state=coefficients + np.einsum("mki,mi->mk", gain, residual),
        covariance=own - gain @ np.swapaxes(with_sizes, 1, 2) + remaining @ cofactor @ np.swapaxes(remaining, 1, 2),
    )


def _draw_errors(covariance: Float64Array, random: np.random.Generator) -> Float64Array:
    """One error (d, 2) of each covariance (d, 2, 2)."""
    sigma = np.sqrt(np.einsum("dii->di", covariance))
    correlation = np.clip(covariance[:, 0, 1] / (sigma[:, 0] * sigma[:, 1]), -1.0, 1.0)
    first, second = random.normal(size=(2, len(covariance)))
    errors: Float64Array = sigma * np.column_stack([first, correlation * first + np.sqrt(1 - correlation**2) * second])
    return errors


def _convert_shares(drawn: Float64Array, is_share: BoolArray) -> tuple[Float64N, Float64N]:
    """Size and rate (d,) of states (d, 2), of which some are a logarithm and a share a year."""
    size = np.where(is_share, np.exp(np.where(is_share, drawn[:, 0], 0.0)), drawn[:, 0])
    return size, np.where(is_share, size * drawn[:, 1], drawn[:, 1])


def _measure_misfit(year: Float64N, size: Float64N, error: Float64Array) -> float:
    """Chi-square of the sizes about the straight line of least squares."""
    line = np.column_stack([np.ones(len(year)), year - year[-1]])
    inverse = np.linalg.inv(error)
    residual = size - line @ np.linalg.solve(line.T @ inverse @ line, line.T @ inverse @ size)
    return float(residual @ inverse @ residual)
