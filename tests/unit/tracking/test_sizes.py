"""Sigmas of sizes follow from pixels, incidence and the blur that a campaign tells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from benchmarks.synthetic_history import HistoryRecipe, draw_history
from facadelake.tracking import link_history, read_sizes
from facadelake.tracking.size_change import DefectSizes
from schemas.vocabulary import TrendQuantity

SEEN = {
    "defect_id": "D1", "length_m": 0.5, "width_m": 0.4, "height_m": 0.3, "area_m2": 0.12, "gsd_mm": 4.0,
    "incidence_deg": 0.0, "distance_m": 10.0, "normal_x": 0.0, "normal_y": -1.0, "normal_z": 0.0,
    "covariance_site": [0.0] * 9, "crack_width_mm": 12.0,
}  # fmt: skip
CRACK = {
    "defect_id": "D1", "crack_width_mm": 12.0, "crack_width_sigma_mm": 1.0, "crack_width_blur_mm": float("nan"),
    "crack_width_outcome": "measured",
}  # fmt: skip


def read(quantity: TrendQuantity, *, defect: dict[str, Any] | None = None, **seen: Any) -> DefectSizes:
    """The size of one defect, seen once."""
    table = pa.Table.from_pylist([{**CRACK, **(defect or {})}])
    return read_sizes(table, pa.Table.from_pylist([{**SEEN, **seen}]))[quantity]


@pytest.mark.parametrize("quantity", [TrendQuantity.LENGTH, TrendQuantity.AREA])
def test_coarse_and_oblique_sightings_are_less_certain(quantity: TrendQuantity) -> None:
    near, coarse, oblique = (
        read(quantity, **seen).sigma[0] for seen in ({}, {"gsd_mm": 40.0}, {"incidence_deg": 70.0})
    )
    assert coarse > 1.1 * near and oblique > 1.1 * near


def test_an_uncertain_distance_is_an_uncertain_size() -> None:
    far_off = np.diag([0.0, 2.0**2, 0.0]).ravel().tolist()  # 2 m of 10 m along the normal
    sigmas = [read(TrendQuantity.LENGTH, covariance_site=one).sigma[0] for one in ([0.0] * 9, far_off)]
    assert np.sqrt(sigmas[1] ** 2 - sigmas[0] ** 2) == pytest.approx(0.2)


def test_the_blur_that_a_campaign_tells_is_kept_apart() -> None:
    told = read(
        TrendQuantity.CRACK_WIDTH, defect={"crack_width_sigma_mm": np.hypot(1.0, 10.0), "crack_width_blur_mm": 10.0}
    )
    untold = read(TrendQuantity.CRACK_WIDTH)
    assert told.sigma[0] == pytest.approx(untold.sigma[0]) == pytest.approx(np.hypot(1.0, 0.3 * 4.0) / 12.0)
    assert told.per_blur_px[0] == untold.per_blur_px[0] == 4.0
    assert told.blur_px[0] == 2.5 and untold.blur_px[0] == 1.0


def test_blur_that_one_campaign_tells_counts_in_all() -> None:
    history = draw_history(HistoryRecipe(defects=10, campaigns=2), 0)
    width = TrendQuantity.CRACK_WIDTH
    second = history.records[1]
    blurred = replace(second.sizes[width], blur_px=np.full(len(second.tracked.defects), 2.5))
    linked = link_history([history.records[0], replace(second, sizes={**second.sizes, width: blurred})], 100.0)
    assert all((one.sizes[width].blur_px == 2.5).all() for one in linked.campaigns)
