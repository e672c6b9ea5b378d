"""Widths of one crack in several photographs: their stated errors must explain how they differ."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from facadelake.core.arrays import Float64N, RowIndices
from facadelake.deduplication.crack_width import describe_width_blur, estimate_crack_widths, estimate_unknown_blur

TRUE_MM = 8.0


def photograph_cracks(blur_px: float, seed: int = 1) -> tuple[RowIndices, Float64N, Float64N, Float64N]:
    """Ten cracks of 8 mm in eight photographs each of 3 to 11 mm/px; ``blur_px`` of each is measured as width."""
    rng = np.random.default_rng(seed)
    group, gsd = np.repeat(np.arange(10), 8), rng.uniform(3.0, 11.0, 80)
    sigma = 0.1 * gsd
    return group, TRUE_MM + blur_px * gsd + rng.normal(0, sigma), sigma, gsd


def make_rows(width: Float64N, sigma: Float64N, gsd: Float64N) -> pa.Table:
    return pa.table(
        {
            "crack_width_mm": width, "crack_width_max_mm": width, "crack_width_sigma_mm": sigma,
            "crack_width_limit_mm": gsd, "gsd_mm": gsd, "crack_width_outcome": ["measured"] * len(width),
        }
    )  # fmt: skip


@pytest.mark.parametrize("blur_px", [0.8, 2.5])
def test_widths_that_grow_with_the_pixels_tell_an_unknown_blur(blur_px: float) -> None:
    found = estimate_unknown_blur(*photograph_cracks(blur_px))
    assert found == pytest.approx(blur_px, rel=0, abs=0.1)  # px


def test_widths_without_unknown_blur_are_not_said_to_be_overstated() -> None:
    group, width, sigma, gsd = photograph_cracks(0.0)
    found = estimate_crack_widths(make_rows(width, sigma, gsd), group, np.ones(80), 10)
    assert np.isnan(found.blur_mm).all()
    assert describe_width_blur([None, None]) == ""


def test_widths_without_unknown_blur_keep_their_errors() -> None:
    found = [estimate_unknown_blur(*photograph_cracks(0.0, seed)) for seed in range(200)]
    assert np.mean(np.array(found) > 0) < 0.02  # by chance: three sigmas, on one side
    group, width, sigma, gsd = photograph_cracks(0.0)
    assert estimate_unknown_blur(group[:4], width[:4], sigma[:4], gsd[:4]) == 0.0  # too few
    assert estimate_unknown_blur(np.arange(80), width, sigma, gsd) == 0.0  # no crack is measured twice
    assert estimate_unknown_blur(group[:0], width[:0], sigma[:0], gsd[:0]) == 0.0


def test_the_stated_error_holds_the_true_width() -> None:
    group, width, sigma, gsd = photograph_cracks(2.5)
    found = estimate_crack_widths(make_rows(width, sigma, gsd), group, np.ones(80), 10)
    error = found.width_mm - TRUE_MM
    assert (error > 5 * 0.1 * 11.0).any()  # by far more than the errors in the photographs
    assert (np.abs(error) <= 2 * found.sigma_mm).all()
    nearest = np.array([gsd[group == k].min() for k in range(10)])
    np.testing.assert_allclose(found.blur_mm, 2.5 * nearest, rtol=0.1, atol=0)
    assert describe_width_blur(found.blur_mm.tolist()) == (
        f"the widths of 10 cracks may be overstated, by about {found.blur_mm.min():.0f} to {found.blur_mm.max():.0f} "
        "mm: they grow with the size of the pixels, so blur that the photographs do not tell (a soft rim, sharpening, "
        "a steep tone curve) is measured as width; it is in their sigmas: photograph the cracks from nearer to measure "
        "them"
    )
    honest = photograph_cracks(0.0)
    found = estimate_crack_widths(make_rows(*honest[1:]), honest[0], np.ones(80), 10)
    assert (found.sigma_mm < 1.2).all()  # mm: nothing is added
