"""Whether the stated covariance of a camera's centre holds its true error: by hand, and by sampled errors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from facadelake.core.errors import SchemaError
from facadelake.evaluation.campaigns.covariance_consistency import CHI_SQUARE_95
from facadelake.evaluation.campaigns.figures import CampaignFigures
from tests.unit.evaluation.campaigns.campaigns import CRS, ORIGIN, Array, Made, evaluate_tables, tables, write_truth

TURN = Rotation.from_euler("xyz", [20, -35, 70], degrees=True).as_matrix()
AXES_M = np.array([0.002, 0.01, 0.05])  # an ellipsoid 25 times as long as thick, askew
ELLIPSOID_M2 = TURN @ np.diag(AXES_M**2) @ TURN.T


def figures_of(errors_m: Mapping[str, Array], covariance_m2: Mapping[str, Array], folder: Path) -> CampaignFigures:
    true = {name: np.array([float(k), -15.0, 3.0]) for k, name in enumerate(errors_m)}
    found = {name: true[name] + error for name, error in errors_m.items()}
    made = Made(centres_true_m=true, centres_found_m=found, points_true_m={}, covariance_m2=covariance_m2)
    return evaluate_tables(**tables(made), truth=write_truth(folder / "truth", made), origin=ORIGIN, map_crs=CRS)


def test_the_limit_is_the_95_percent_quantile() -> None:
    assert pytest.approx(chi2.ppf(0.95, 3), rel=0, abs=5e-4) == CHI_SQUARE_95


@pytest.mark.parametrize(("sigmas", "share"), [(2.79, 1.0), (2.80, 0.0)])
def test_errors_along_the_ellipsoids_axes(sigmas: float, share: float, tmp_path: Path) -> None:
    """The 95 % ellipsoid's half axes are 2.796 sigmas long (the root of 7.815)."""
    errors = {f"{k}{sign:+d}.jpg": sign * sigmas * AXES_M[k] * TURN[:, k] for k in range(3) for sign in (1, -1)}
    covariance = dict.fromkeys(errors, ELLIPSOID_M2)
    assert figures_of(errors, covariance, tmp_path).coverage_2sigma == share


@pytest.mark.parametrize(("stated", "low", "high"), [(1.0, 0.917, 0.983), (0.5, 0.344, 0.492), (2.0, 0.997, 1.0)])
def test_sampled_errors(stated: float, low: float, high: float, tmp_path: Path) -> None:
    """Drawn by the ellipsoid's factor, without its covariance; sigmas stated half or double are found out.

    Half: 0.418 lie within 1.398 sigmas (chi-square of 1.954 with 3 degrees of freedom); the bounds are three of the
    sample's standard errors.
    """
    drawn = np.random.default_rng(11).normal(size=(400, 3)) * AXES_M @ TURN.T
    errors = {f"{k:04d}.jpg": error for k, error in enumerate(drawn)}
    covariance = dict.fromkeys(errors, stated**2 * ELLIPSOID_M2)
    share = figures_of(errors, covariance, tmp_path).coverage_2sigma
    assert share is not None
    assert low <= share <= high


def test_poses_without_a_covariance_are_not_counted(tmp_path: Path) -> None:
    errors = {"in.jpg": 1.0 * AXES_M[0] * TURN[:, 0], "out.jpg": 9.0 * AXES_M[0] * TURN[:, 0], "none.jpg": np.ones(3)}
    covariance = dict.fromkeys(["in.jpg", "out.jpg"], ELLIPSOID_M2)
    some = figures_of(errors, covariance, tmp_path)
    assert (some.coverage_2sigma, some.camera_error.n) == (0.5, 3)
    assert json.loads(json.dumps(some.convert_to_json()))["coverage_2sigma"] == 0.5
    assert figures_of(errors, {}, tmp_path).coverage_2sigma is None


def test_what_is_no_covariance_is_refused(tmp_path: Path) -> None:
    errors = {"a.jpg": np.zeros(3)}
    with pytest.raises(SchemaError, match=r"covariance of a.jpg in table poses is not that of a centre"):
        figures_of(errors, {"a.jpg": np.diag([1.0, -1.0, 1.0])}, tmp_path)
    made = Made(centres_true_m=errors, centres_found_m=errors, points_true_m={}, covariance_m2={"a.jpg": np.eye(3)})
    short = tables(made)
    at = short["poses"].schema.get_field_index("covariance")
    short["poses"] = short["poses"].set_column(
        at, short["poses"].schema.field(at), pa.array([[1.0] * 9], pa.list_(pa.float64()))
    )
    with pytest.raises(SchemaError, match="36 numbers"):
        evaluate_tables(**short, truth=write_truth(tmp_path / "truth", made), origin=ORIGIN, map_crs=CRS)
