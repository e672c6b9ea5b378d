"""What came to the figures later: honesty of observations and defects, missed and doubled check points, Table 2."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from facadelake.core.errors import SchemaError
from facadelake.evaluation.campaigns.check_points import count_check_points
from facadelake.evaluation.campaigns.covariance_consistency import CHI_SQUARE_50, compute_covariance_consistency
from facadelake.evaluation.campaigns.figures import CampaignFigures
from facadelake.evaluation.campaigns.paper_table2 import PAPER_MAE, PAPER_RMSE
from tests.unit.evaluation.campaigns.campaigns import (
    CRS,
    ORIGIN,
    Array,
    Made,
    MadeObservation,
    evaluate_tables,
    pixel,
    tables,
    write_truth,
)

CAMERA = np.array([0.0, -15.0, 3.0])


def figures_of(made: Made, folder: Path) -> CampaignFigures:
    return evaluate_tables(**tables(made), truth=write_truth(folder / "truth", made), origin=ORIGIN, map_crs=CRS)


def make_observation(
    shows: str | None, xyz: Array, defect: str, box_at: Array | None = None, **more: object
) -> MadeObservation:
    box = pixel(CAMERA, xyz if box_at is None else box_at)
    return MadeObservation(photo="a.jpg", shows=shows, xyz_site_m=xyz, box_centre_px=box, defect=defect, **more)  # type: ignore[arg-type]


def made_of(points: dict[str, Array], made_observations: list[MadeObservation], defects: dict[str, Array]) -> Made:
    centres = {"a.jpg": CAMERA}
    return Made(
        centres_true_m=centres,
        centres_found_m=centres,
        points_true_m=points,
        observations=made_observations,
        defects_m=defects,
    )


def test_two_known_errors_by_hand(tmp_path: Path) -> None:
    """Errors of 3 cm east and 4 cm up with sigmas of 1 cm: 9 and 16 normalised squares, neither inside 7.815.

    With sigmas of 2 cm: 2.25 and 4, both inside; their mean over three degrees of freedom is 6.25 / 6.
    """
    points = {"C1": np.array([0.0, 0.0, 2.0]), "C2": np.array([4.0, 0.0, 5.0])}
    errors = {"C1": np.array([0.03, 0.0, 0.0]), "C2": np.array([0.0, 0.0, 0.04])}
    made_observations = [
        make_observation(name, points[name] + errors[name], f"D{name}", covariance_m2=np.eye(3) * 0.01**2)
        for name in points
    ]
    made = made_of(points, made_observations, {f"D{name}": points[name] + errors[name] for name in points})
    made = replace(made, covariance_m2={f"D{name}": np.eye(3) * 0.02**2 for name in points})
    figures = figures_of(made, tmp_path)
    single, merged = figures.consistency_observations, figures.consistency_defects
    assert (single.n, single.inside_2sigma, merged.n, merged.inside_2sigma) == (2, 0.0, 2, 1.0)
    assert single.nees == pytest.approx((9 + 16) / 6, rel=0, abs=1e-6)
    assert merged.nees == pytest.approx(6.25 / 6, rel=0, abs=1e-6)
    assert merged.median_ratio == pytest.approx(3.125 / 2.366, rel=0, abs=1e-6)
    assert (figures.element_correct_share, figures.element_correct_share_defects) == (1.0, 1.0)
    content = figures.convert_to_json()
    assert (content["coverage_2sigma_observations"], content["coverage_2sigma_defects"]) == (0.0, 1.0)
    table = figures.table2
    # 3 cm right and 0; 0 and 4 cm up: per axis, and the diagonal from the same samples.
    assert table.defects.horizontal.mae == pytest.approx(1.5, rel=0, abs=1e-5)  # cm
    assert table.defects.vertical.mae == pytest.approx(2.0, rel=0, abs=1e-5)  # cm
    assert table.defects.diagonal.mae == pytest.approx(3.5, rel=0, abs=1e-5)  # cm
    assert table.defects.diagonal.rmse == pytest.approx(np.sqrt((9 + 16) / 2), rel=0, abs=1e-5)  # cm
    assert table.defects_3d.rmse == pytest.approx(table.defects.diagonal.rmse or 0, rel=0, abs=1e-5)


def test_honest_too_sure_and_too_cautious() -> None:
    """Drawn by a covariance with off-diagonal terms; bounds are three standard errors of 2,000 draws."""
    factor = np.array([[0.02, 0, 0], [0.01, 0.01, 0], [-0.03, 0.004, 0.002]])
    errors = np.random.default_rng(5).normal(size=(2000, 3)) @ factor.T
    true = factor @ factor.T
    honest = compute_covariance_consistency(errors, [true] * 2000)
    assert honest.inside_2sigma is not None and 0.935 < honest.inside_2sigma < 0.965
    assert honest.nees is not None and 0.945 < honest.nees < 1.055  # variance of chi-square/3 is 2/3
    assert honest.median_ratio is not None and 0.92 < honest.median_ratio < 1.08
    assert honest.p95_ratio is not None and 0.92 < honest.p95_ratio < 1.08
    sure = compute_covariance_consistency(errors, [true / 4] * 2000)
    assert sure.nees == pytest.approx(4 * honest.nees, rel=1e-9)
    assert compute_covariance_consistency(errors, [None] * 2000).inside_2sigma is None
    assert pytest.approx(chi2.ppf(0.5, 3), rel=0, abs=5e-4) == CHI_SQUARE_50


def test_missed_doubled_false_and_neighbours(tmp_path: Path) -> None:
    """C1 twice, C2 and C3 (0.2 m apart) in one defect, C4 detected in no defect, C5 not detected, one false defect."""
    points = {
        "C1": np.array([0.0, 0.0, 2.0]), "C2": np.array([3.0, 0.0, 2.0]), "C3": np.array([3.2, 0.0, 2.0]),
        "C4": np.array([-3.0, 0.0, 2.0]), "C5": np.array([6.0, 0.0, 2.0]), "C6": np.array([-0.3, 0.0, 2.0]),
    }  # fmt: skip
    made_observations = [
        make_observation("C1", points["C1"], "D1"),
        make_observation("C1", points["C1"], "D2"),
        make_observation("C6", points["C6"], "D6"),
        make_observation("C2", points["C2"], "D3"),
        make_observation("C3", points["C3"], "D3"),
        replace(make_observation("C4", points["C4"], "D4"), outcome="off_target", defect=None),
        make_observation(None, np.array([8.0, 0.0, 5.0]), "D5"),
    ]
    defects = dict.fromkeys(("D1", "D2", "D3", "D5", "D6"), points["C1"])
    found = figures_of(made_of(points, made_observations, defects), tmp_path).check_points
    assert (found.total, found.detected, found.duplicated, found.false_defects) == (6, 5, 1, 1)
    assert (found.missed, found.lost) == (3, 2)  # C3 (D3 shows C2 by name), C4 and C5; C5 was not detected
    assert (found.near_pairs, found.near_apart, found.nearest_apart_m) == (2, 1, pytest.approx(0.3, rel=0, abs=1e-6))


def test_nothing_found() -> None:
    found = count_check_points(
        xyz_true_site_m={"C1": np.zeros(3)}, detected_check_points=[], check_point_by_defect=[], members=[]
    )
    assert (found.missed, found.lost, found.near_pairs, found.nearest_apart_m) == (1, 0, 0, None)


def test_the_papers_table_contradicts_itself_and_ours_does_not(tmp_path: Path) -> None:
    """Its diagonal exceeds what any samples of its axes can have; a round trip of (3, 4) px at 5 mm is (1.5, 2) cm."""
    assert PAPER_MAE[2] > PAPER_MAE[0] + PAPER_MAE[1]
    assert abs(PAPER_RMSE[2] - np.hypot(PAPER_RMSE[0], PAPER_RMSE[1])) > 1
    point = np.array([1.0, 0.0, 2.0])
    right = pixel(CAMERA, point)
    seen = MadeObservation(
        photo="a.jpg", shows="C1", xyz_site_m=point, box_centre_px=(right[0] + 3, right[1] - 4), defect="D1"
    )
    figures = figures_of(made_of({"C1": point}, [seen], {"D1": point + np.array([0.03, 0.0, 0.0])}), tmp_path)
    table = figures.table2
    # The defect was merged to 3 cm right of it: 5.6 px of 2800 px at 15 m, so 2.6 px right of its box and 4 px below.
    assert figures.roundtrip_defects_px.mean == pytest.approx(np.hypot(2.6, 4.0), rel=0, abs=1e-6)  # px
    assert table.round_trip_defects.horizontal.mean == pytest.approx(1.3, rel=0, abs=1e-6)  # cm
    parts = [table.round_trip.horizontal.mean, table.round_trip.vertical.mean, table.round_trip.diagonal.mean]
    assert parts == pytest.approx([-1.5, 2.0, 2.5], rel=0, abs=1e-6)  # cm
    assert table.observations_3d.mae == pytest.approx(0.0, rel=0, abs=1e-6)  # cm
    assert [row[0] for row in table.format_rows()] == ["horizontal", "vertical", "diagonal", "3D"]


def test_a_position_without_positive_variances_is_refused(tmp_path: Path) -> None:
    point = np.array([1.0, 0.0, 2.0])
    flat = make_observation("C1", point, "D1", covariance_m2=np.diag([1e-4, 0.0, 1e-4]))
    with pytest.raises(SchemaError, match="positive definite"):
        figures_of(made_of({"C1": point}, [flat], {}), tmp_path)
