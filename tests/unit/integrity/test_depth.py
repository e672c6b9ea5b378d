"""SSIM against Eq. 12 written out, the paper's misprint, and views of known geometry."""

import numpy as np
import pytest

from facadelake.building.surface.raycasting import Surface
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity
from facadelake.integrity.depth import SIGMA_PX, WINDOW_PX, compare_depth
from facadelake.integrity.views import IntegritySettings, compare_views


def window():
    """The Gaussian window, made from its formula."""
    u = np.arange(WINDOW_PX) - WINDOW_PX // 2
    weights = np.exp(-(u[:, None] ** 2 + u[None] ** 2) / (2 * SIGMA_PX**2))
    return weights / weights.sum()


def equation_12(a, b, *, printed):
    """Mean over all whole windows of Eq. 12, corrected or as ``printed`` with a plus; depths count from the nearest."""
    low = min(a.min(), b.min())
    data_range = max(a.max(), b.max()) - low
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    w, values = window(), []
    for i in range(a.shape[0] - WINDOW_PX + 1):
        for j in range(a.shape[1] - WINDOW_PX + 1):
            x, y = (image[i : i + WINDOW_PX, j : j + WINDOW_PX] - low for image in (a, b))
            mu_x, mu_y = (w * x).sum(), (w * y).sum()
            var_x, var_y = (w * (x - mu_x) ** 2).sum(), (w * (y - mu_y) ** 2).sum()
            cov = (w * (x - mu_x) * (y - mu_y)).sum()
            below = (mu_x**2 + mu_y**2 + c1) * (var_x + var_y + c2)
            first, second = 2 * mu_x * mu_y + c1, 2 * cov + c2
            values.append((first + second if printed else first * second) / below)
    return float(np.mean(values))


@pytest.fixture
def depths():
    rng = np.random.default_rng(2)
    columns, rows = np.meshgrid(np.arange(48), np.arange(40))
    model = 12 + 0.05 * columns + 1.5 * (columns > 20) - 0.02 * rows
    return model, model + 0.1 * rng.normal(size=model.shape) + 0.3 * (rows > 25)


def test_ssim_is_equation_12_corrected_and_not_as_printed(depths):
    found = compare_depth(*depths).ssim
    np.testing.assert_allclose(found, equation_12(*depths, printed=False), rtol=0, atol=1e-9)
    assert abs(found - equation_12(*depths, printed=True)) > 0.1
    model = depths[0]
    assert abs(equation_12(model, model, printed=True) - 1) > 0.1  # as printed, an image is unlike itself


def test_an_image_is_like_itself_and_a_shuffled_one_is_not(depths):
    model, _ = depths
    same = compare_depth(model, model)
    assert (same.ssim, same.compared_share, same.difference_median_m) == (pytest.approx(1.0, abs=1e-12), 1.0, 0.0)
    other = np.random.default_rng(0).permutation(model.ravel()).reshape(model.shape)
    assert -0.2 < compare_depth(model, other).ssim < 0.3


def test_holes_neither_count_nor_leak(depths):
    """Values where a surface is missing have no influence on the windows beside it."""
    model, as_built = (image.copy() for image in depths)
    as_built[:, 30:] = np.inf
    model[:5] = np.inf
    found = compare_depth(model, as_built)
    inside = equation_12(model[5:, :30], as_built[5:, :30], printed=False)
    np.testing.assert_allclose(found.ssim, inside, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.compared_share, 30 / 48, rtol=0, atol=1e-12)
    assert found.windows == (35 - 10) * (30 - 10)


def test_nothing_in_common():
    empty = np.full((40, 40), np.inf)
    found = compare_depth(np.full((40, 40), 5.0), empty)
    assert np.isnan(found.ssim)
    assert (found.windows, found.compared_share) == (0, 0.0)
    assert compare_depth(empty, np.full((40, 40), 5.0)).compared_share == 0.0


def wall(y_m, half_m=8.0):
    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]) * half_m + [0, y_m, 0]
    return Surface.from_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.fixture
def posed():
    """Two cameras 10 m in front of the wall y = 0: one faces it, one faces away."""
    camera = Camera(width_px=640, height_px=480, fx_px=480, fy_px=480, cx_px=320, cy_px=240)
    at = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    away = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])
    eye = np.array([0.0, -10, 0])
    return {
        "at": PosedCamera(camera=camera, site_from_cam=Similarity(rotation=at, translation=eye)),
        "away": PosedCamera(camera=camera, site_from_cam=Similarity(rotation=away, translation=eye)),
    }


def test_a_wall_built_20_cm_too_far_back(posed):
    rows = {row["photo_id"]: row for row in compare_views(posed, wall(0.0), wall(0.2)).to_pylist()}
    at = rows["at"]
    assert at["integrity_outcome"] == "compared"
    np.testing.assert_allclose(at["depth_difference_median_m"], 0.2, rtol=0, atol=1e-6)  # m
    np.testing.assert_allclose(at["depth_difference_p95_m"], 0.2, rtol=0, atol=1e-6)  # m
    assert at["compared_share"] > 0.95
    assert rows["away"]["integrity_outcome"] == "too_little_surface"
    assert "the model covers 0.0%" in rows["away"]["reason"]


def test_a_view_with_little_as_built_surface_has_that_reason(posed):
    row = compare_views({"at": posed["at"]}, wall(0.0), wall(0.0, half_m=0.5)).to_pylist()[0]
    assert row["integrity_outcome"] == "too_little_surface"
    assert row["ssim"] is None
    assert "less than 10%" in row["reason"]
    np.testing.assert_allclose(row["compared_share"], 1.0**2 / (480 / 480 * 10 * 640 / 480 * 10), rtol=0.1)


def test_settings_out_of_range():
    with pytest.raises(InputDataError, match="out of range"):
        IntegritySettings(width_px=4)
