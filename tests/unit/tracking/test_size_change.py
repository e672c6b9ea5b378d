"""Changes of size: calibrated, rarely called where there is none, found where a defect grew; limits."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from facadelake.severity import find_rule_file
from facadelake.tracking import (
    SizedDefects,
    compare_sized_pairs,
    compare_sizes,
    select_significant,
    summarise_sizes,
)
from facadelake.tracking.next_limit import find_next_limits
from facadelake.tracking.size_change import DefectSizes
from schemas.vocabulary import DefectClass, TrendQuantity
from tests.unit.lake.small_campaign import stage_tables

COUNT = 60
LONG = {"width_m": 0.3, "height_m": 0.1, "length_m": 0.3}
WIDE = {"width_m": 0.5, "height_m": 0.4, "area_m2": 0.2}


def make_sizes(
    size: list[float], share: list[float], pixel: list[float] | None = None, blur_px: float = 0.0
) -> DefectSizes:
    """Sizes with one sigma of each as a share of it, and what a pixel of blur adds to them."""
    return DefectSizes(
        log_size=np.log(size),
        sigma=np.array(share),
        per_blur_px=np.zeros(len(size)) if pixel is None else np.array(pixel),
        blur_px=np.full(len(size), blur_px),
    )


def simulate(rng: np.random.Generator, growth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Change of the logarithm, its sigma and whether it is called significant, of defects seen one to eight times."""
    true = np.exp(rng.normal(-0.5, 0.5, COUNT))
    times = rng.integers(1, 9, COUNT)
    defect = np.repeat(np.arange(COUNT), times)
    before, after = (
        summarise_sizes(
            np.log(size[defect]) + rng.normal(scale=0.08, size=len(defect)), np.zeros(len(defect)), defect, COUNT
        )
        for size in (true, true * growth)
    )
    change = compare_sizes(before, after)
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
    change = compare_sizes(make_sizes([np.nan, 1.0], [0.1, 0.1]), make_sizes([3.0, 3.0], [0.1, np.nan]))
    assert np.isnan(change.log_change).all() and not select_significant(change.p_value).any()


def test_the_scatter_of_unchanged_defects_scales_the_sigmas_up_and_down() -> None:
    rng = np.random.default_rng(0)
    for scatter in (0.03, 0.12):
        sizes = np.exp(rng.normal(-0.5, 0.5, 200))
        again = sizes * np.exp(rng.normal(scale=scatter, size=200))
        change = compare_sizes(*(make_sizes(one.tolist(), [0.05 / np.sqrt(2)] * 200) for one in (sizes, again)))
        assert change.scale == pytest.approx(scatter / 0.05, rel=0.15)
        assert 0.9 <= np.mean(np.abs(change.log_change) <= 2 * change.sigma) <= 0.99


def test_few_defects_do_not_make_errors_small() -> None:
    sizes = make_sizes([0.5] * 8, [0.1] * 8)
    assert compare_sizes(sizes, sizes).scale > 0.7


def test_a_width_does_not_grow_because_the_pixels_do() -> None:
    """The demo's crack D06: 15.6 and 40.2 mm wide, from 5.8 and 11.6 mm a pixel, with 2.7 px of unknown blur."""
    near, far = make_sizes([15.6], [0.15], [5.8], 2.7), make_sizes([40.2], [0.15], [11.6])
    assert compare_sizes(near, far).p_value[0] > 0.05
    # From the same distance, the blur is in both widths.
    same = compare_sizes(near, make_sizes([40.2], [0.15], [5.8], 2.7))
    assert same.p_value[0] < 0.01 and same.sigma[0] == pytest.approx(0.15 * np.sqrt(2))


def test_the_error_of_a_change_has_that_of_either_size() -> None:
    """A width of 40 +- 8 mm that is 10 +- 2 mm now has shrunk by 30 +- 8 mm, not by +- 3 mm."""
    crack = [DefectClass.CRACK]
    before, after = (
        SizedDefects(defect_class=crack, sizes={quantity: make_sizes([size], [0.2]) for quantity in TrendQuantity})
        for size in (40.0, 10.0)
    )
    (change,) = compare_sized_pairs(before, after).changes
    found = change[TrendQuantity.CRACK_WIDTH]
    assert found.change == pytest.approx(-30.0) and found.sigma == pytest.approx(np.hypot(8.0, 2.0))


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
    assert found.size == limit  # to the digits of the rule pack, whatever the steps of the search


def test_the_worst_grade_has_no_next_limit() -> None:
    table = stage_tables()["defects"].slice(0, 1)
    row = {**table.to_pylist()[0], "defect_class": "crack", "length_m": 30.0, "width_m": 30.0}
    one = pa.Table.from_pylist([row], schema=table.schema)
    assert find_next_limits(one, [TrendQuantity.LENGTH], find_rule_file("extent_v1")) == [None]
