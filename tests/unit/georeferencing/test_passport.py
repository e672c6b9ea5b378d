"""The points of the passport; doming against the model."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from facadelake.core.geodesy import SiteOrigin
from facadelake.georeferencing.adjustment.adjust import adjust_block
from facadelake.georeferencing.adjustment.adjusted_block import AdjustedBlock
from facadelake.georeferencing.adjustment.control_observations import ControlObservations
from facadelake.georeferencing.model_comparison import compare_with_model
from facadelake.georeferencing.passport import PassportPoint, build_points_table
from schemas.vocabulary import PointKind
from tests.unit.georeferencing.small_block import (
    SITE_FROM_SFM,
    BoxSurface,
    build_marked_points,
    build_no_attitudes,
    build_no_positions,
    build_reconstruction,
    build_small_block,
)

GOOD = np.array([0.02, 0.03, 0.05])


def test_points_are_told_in_site_and_on_the_globe() -> None:
    origin = SiteOrigin(lon_deg=8.4, lat_deg=48.9, height_ellipsoidal_m=180.0)
    point = PassportPoint(
        name="G1", kind=PointKind.HELD_OUT, xyz_site_m=np.array([3.0, 4.0, 5.0]),
        residual_site_m=np.array([0.01, -0.02, 0.03]), used=False,
    )  # fmt: skip
    row = build_points_table([point], origin).to_pylist()[0]
    geo = np.array([[row["lon_deg"], row["lat_deg"], row["height_ellipsoidal_m"]]])
    np.testing.assert_allclose(origin.site_from_geo(geo)[0], [3.0, 4.0, 5.0], rtol=0, atol=1e-5)  # m
    assert (row["residual_east_m"], row["residual_north_m"], row["residual_up_m"]) == (0.01, -0.02, 0.03)
    assert (row["point_kind"], row["point_used"]) == ("held_out", False)
    assert build_points_table([], origin).num_rows == 0


@pytest.fixture(scope="module")
def held() -> AdjustedBlock:
    """A block of 600 points held by control points; its building is the model exactly."""
    block = build_small_block(points=600)
    rng = np.random.default_rng(3)
    marked = build_marked_points(block, rng, points=np.arange(0, 600, 40), survey_m=0.005, mark_px=0.5)
    evidence = ControlObservations(positions=build_no_positions(), attitudes=build_no_attitudes(), marked=marked)
    return adjust_block(build_reconstruction(block, rng, tie_px=0.5), SITE_FROM_SFM, evidence)


def bend_block(adjusted: AdjustedBlock, away_m: Callable[[np.ndarray], np.ndarray]) -> AdjustedBlock:
    """The same block with the points of each facade moved out of it by ``away_m`` of their place along it."""
    state = adjusted.solution.state
    xyz = state.xyz_site_m.copy()
    for axis, half in ((0, 5.0), (1, 4.0)):
        for side in (-1, 1):
            on = np.abs(xyz[:, axis] - side * half) < 0.1
            xyz[on, axis] += side * away_m(xyz[on, 1 - axis])
    return replace(adjusted, solution=replace(adjusted.solution, state=replace(state, xyz_site_m=xyz)))


def test_a_block_that_is_not_bent_shows_no_doming(held: AdjustedBlock) -> None:
    fit = compare_with_model(held, BoxSurface())
    assert fit is not None
    assert 0.001 < fit.residual_m < 0.02
    assert 1e-5 < fit.doming_sigma_m < 0.01
    assert abs(fit.doming_m) < 3.5 * fit.doming_sigma_m + 0.003  # m; control itself errs by millimetres


@pytest.mark.parametrize("sagitta_m", [0.06, -0.06])
def test_a_bent_block_shows_its_sagitta(held: AdjustedBlock, sagitta_m: float) -> None:
    """Every facade bulges like one sphere: ``sagitta_m`` over the half of the longest, 5 m."""
    before, after = compare_with_model(held, BoxSurface()), compare_with_model(
        bend_block(held, lambda u: sagitta_m * (u / 5.0) ** 2), BoxSurface()
    )  # fmt: skip
    assert before is not None and after is not None
    assert abs(after.doming_m - sagitta_m) < 3.5 * after.doming_sigma_m + 0.004  # m
    assert after.doming_sigma_m < 0.01


def test_a_wall_that_leans_or_stands_off_is_not_bent(held: AdjustedBlock) -> None:
    after = compare_with_model(bend_block(held, lambda u: 0.1 + 0.01 * u), BoxSurface())
    assert after is not None
    assert abs(after.doming_m) < 3.5 * after.doming_sigma_m + 0.004  # m
    assert 0.07 < after.residual_m < 0.14


def test_a_model_of_another_place_says_nothing(held: AdjustedBlock) -> None:
    assert compare_with_model(held, BoxSurface(half_m=(1.0, 1.0), ground=False)) is None
