"""Changes of size: calibrated, rarely called where there is none, found where a defect grew; trends and limits."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from facadelake.severity import find_rule_file
from facadelake.tracking import compare_sizes, fit_trend, select_significant, summarise_sizes
from facadelake.tracking.next_limit import find_next_limits
from facadelake.tracking.trend import predict_limit
from schemas.vocabulary import TrendQuantity
from tests.unit.lake.small_campaign import stage_tables

COUNT = 60
LONG = {"width_m": 0.3, "height_m": 0.1, "length_m": 0.3}
WIDE = {"width_m": 0.5, "height_m": 0.4, "area_m2": 0.2}


def simulate(rng: np.random.Generator, growth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Change of the logarithm, its sigma and whether it is called significant, of defects seen one to eight times."""
    true = np.exp(rng.normal(-0.5, 0.5, COUNT))
    times = rng.integers(1, 9, COUNT)
    defect = np.repeat(np.arange(COUNT), times)
    before, after = (
        summarise_sizes(np.log(size[defect]) + rng.normal(scale=0.08, size=len(defect)), defect, COUNT)
        for size in (true, true * growth)
    )
    change = compare_sizes(before.log_size, before.sigma, after.log_size, after.sigma)
    return change.log_change, change.sigma, select_significant(change.p_value)


def test_growth_is_found_and_hardly_ever_invented_and_its_error_is_calibrated() -> None:
    false, found, inside = [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        growth = np.where(rng.random(COUNT) < 0.3, 1.4, 1.0)
        change, sigma, significant = simulate(rng, growth)
        false.append(significant[growth == 1].mean())
        found.append(significant[growth > 1].mean())
        inside.append((np.abs(change - np.log(growth)) < 2 * sigma).mean())
    assert np.mean(false) <= 0.02
    assert np.mean(found) >= 0.9
    assert 0.9 <= np.mean(inside) <= 0.99


def test_unknown_sizes_are_neither_changed_nor_an_error() -> None:
    nan = np.array([np.nan, 0.0])
    change = compare_sizes(nan, np.array([0.1, 0.1]), np.array([1.0, 1.0]), np.array([0.1, np.nan]))
    assert np.isnan(change.log_change).all() and not select_significant(change.p_value).any()


def test_a_trend_has_an_interval_that_covers_the_truth() -> None:
    inside = []
    year = np.array([0.0, 1.0, 2.0, 3.0])
    for seed in range(200):
        size = 1 + 0.2 * year + np.random.default_rng(seed).normal(scale=0.05, size=4)
        trend = fit_trend(year, size, np.full(4, 0.05))
        assert trend is not None
        inside.append(trend.interval_per_year[0] <= 0.2 <= trend.interval_per_year[1])
    assert 0.9 <= np.mean(inside) <= 0.99


def test_a_limit_is_predicted_with_an_interval_or_not_at_all() -> None:
    year = np.array([0.0, 1.0, 2.0, 3.0])
    growing = fit_trend(year, 1 + 0.2 * year, np.full(4, 0.02))
    assert growing is not None
    predicted = predict_limit(growing, 2.0)
    assert predicted is not None and predicted[0] < predicted[1] < predicted[2]
    assert abs(predicted[1] - 5.0) < 0.05
    steady = fit_trend(year, np.ones(4), np.full(4, 0.05))
    assert steady is not None and predict_limit(steady, 2.0) is None
    assert fit_trend(year[:2], np.ones(2), np.full(2, 0.1)) is None


@pytest.mark.parametrize(
    ("rules", "defect_class", "quantity", "size", "limit", "severity"),
    [
        (
            "extent_v1",
            "crack",
            TrendQuantity.LENGTH,
            {"width_m": 0.3, "height_m": 0.1, "length_m": 0.3},
            0.5,
            "moderate",
        ),
        ("bre251_v1", "crack", TrendQuantity.CRACK_WIDTH, {"crack_width_mm": 3.0}, 5.0, "moderate"),
        (
            "extent_v1",
            "moisture",
            TrendQuantity.AREA,
            {"width_m": 0.5, "height_m": 0.4, "area_m2": 0.2},
            0.8,
            "moderate",
        ),
    ],
)
def test_the_next_limit_is_that_of_the_rule_pack(
    rules: str, defect_class: str, quantity: TrendQuantity, size: dict[str, float], limit: float, severity: str
) -> None:
    table = stage_tables()["defects"].slice(0, 1)
    row = {**table.to_pylist()[0], "defect_class": defect_class, "crack_width_outcome": "measured", **size}
    one = pa.Table.from_pylist([row], schema=table.schema)
    (found,) = find_next_limits(one, [quantity], find_rule_file(rules))
    assert found is not None and found.severity == severity
    assert found.size == pytest.approx(limit, rel=0.01)


def test_the_worst_grade_has_no_next_limit() -> None:
    table = stage_tables()["defects"].slice(0, 1)
    row = {**table.to_pylist()[0], "defect_class": "crack", "length_m": 30.0, "width_m": 30.0}
    one = pa.Table.from_pylist([row], schema=table.schema)
    assert find_next_limits(one, [TrendQuantity.LENGTH], find_rule_file("extent_v1")) == [None]
