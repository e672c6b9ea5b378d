from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from facadelake.core.tables import get_stage_schema, table_from_rows
from facadelake.reporting.inspection import Inspection
from facadelake.reporting.page.passport import render_passport
from facadelake.reporting.passport.facts import FactStatus, list_passport_facts, summarise_passport
from facadelake.reporting.passport.figure import draw_passport
from facadelake.reporting.passport.views import (
    NORTH,
    UP,
    DrawingScales,
    choose_scales,
    collect_geometry,
    compute_extent,
    draw_view,
)
from facadelake.reporting.plan import draw_model
from tests.unit.reporting.painted_wall import NASTY_NAME, PaintedWall, make_inspection

CENTIMETRES: dict[str, Any] = {
    "control": "gcp", "method": "control points", "map_crs": "EPSG:25832", "vertical_datum": "ellipsoidal",
    "georeference_level": "50", "reference_campaign": None, "points_used": 6, "points_total": 6,
    "residual_mean_m": 0.005, "residual_max_m": 0.01, "check_points": 6, "check_residual_mean_m": 0.019,
    "check_residual_max_m": 0.04, "sigma_east_m": 0.009, "sigma_north_m": 0.010, "sigma_up_m": 0.009,
    "gps_offset_east_m": 1.25, "gps_offset_north_m": -0.84, "gps_offset_up_m": 1.95, "gps_offset_sigma_m": 0.1,
    "tie_sigma_px": 0.32, "tie_variance_factor": 2.5, "model_residual_m": 0.034, "doming_m": -0.012,
    "doming_sigma_m": 0.008, "edge_features": None, "edge_score": None, "edge_score_runner_up": None, "remarks": "",
    "crs_operation": "ETRS89 to WGS 84 (1)", "crs_operation_accuracy_m": 1.0, "control_operation": None,
    "control_operation_accuracy_m": None, "control_operation_sigma_m": None,
}  # fmt: skip


def assess_passport(**changes: Any) -> tuple[FactStatus, str, dict[str, FactStatus]]:
    row = CENTIMETRES | changes
    facts = list_passport_facts(row, get_stage_schema("poses").empty_table(), placement_sigma_max_m=0.5)
    assert all(fact.value and fact.meaning for fact in facts)
    assert all(fact.limit for fact in facts if fact.status)  # assessed facts have a limit
    return *summarise_passport(row, facts), {fact.name: fact.status for fact in facts}


def test_summary_of_a_good_passport() -> None:
    verdict, sentence, facts = assess_passport()
    assert verdict is FactStatus.GOOD
    assert sentence == "Good: georeferenced by control points, largest standard deviation 10 mm (north)"
    assert not {FactStatus.CHECK, FactStatus.POOR} & set(facts.values())


@pytest.mark.parametrize(
    ("changes", "fact"),
    [
        ({"check_residual_max_m": 0.10}, "independent points"),  # three sigmas of block and survey: 71 mm
        ({"check_points": 0, "check_residual_mean_m": None, "check_residual_max_m": None}, "independent points"),
        ({"points_used": 5}, "control points"),
        ({"residual_mean_m": 0.031}, "control points"),
        ({"control": "campaign", "residual_mean_m": 0.031, "points_used": 500, "points_total": 900}, "shared points"),
        ({"sigma_up_m": 0.031}, "weakest direction"),
        ({"doming_m": 0.03, "doming_sigma_m": 0.01}, "doming"),
        ({"model_residual_m": 0.11}, "distance to the model"),
        ({"tie_sigma_px": 1.1}, "tie points"),
        ({"edge_features": 40, "edge_score": 0.2, "edge_score_runner_up": 0.21}, "edges of the model"),
    ],
)
def test_summary_names_the_facts_to_be_checked(changes: dict[str, Any], fact: str) -> None:
    verdict, sentence, facts = assess_passport(**changes)
    assert verdict is FactStatus.CHECK
    assert [name for name, one in facts.items() if one is FactStatus.CHECK] == [fact]
    assert f"check {fact}" in sentence


def test_facts_within_their_limits_are_not_flagged() -> None:
    for changes in (
        {"doming_m": 0.03, "doming_sigma_m": 0.02},  # less than two of its sigmas
        {"doming_m": None, "doming_sigma_m": None},
        {"control": "campaign", "points_used": 500, "points_total": 900, "reference_campaign": "2026-04"},
        {"control": "model", "points_used": 500, "points_total": 900, "residual_mean_m": 0.05},
        {"edge_features": 40, "edge_score": 0.3, "edge_score_runner_up": None},
    ):
        assert assess_passport(**changes)[0] is FactStatus.GOOD, changes


def test_no_doming_has_no_sign_of_minus() -> None:
    row = CENTIMETRES | {"doming_m": -0.0002}
    facts = list_passport_facts(row, get_stage_schema("poses").empty_table(), placement_sigma_max_m=0.5)
    assert [fact.value for fact in facts if fact.name == "doming"] == ["+0 mm ± 8 mm"]


def test_summary_of_a_position_with_errors_of_metres() -> None:
    verdict, sentence, facts = assess_passport(
        control="gps", method="the photographs' GPS", sigma_up_m=3.0, sigma_east_m=2.0
    )
    assert (verdict, facts["standard deviation"]) == (FactStatus.POOR, FactStatus.POOR)
    assert sentence.startswith(
        "Accuracy below requirement: georeferenced by the photographs' GPS, largest standard deviation 3.00 m"
    )


def draw_axes(inspection: Inspection, up: np.ndarray) -> tuple[Any, DrawingScales]:
    axes = Figure().add_subplot()
    place = collect_geometry(inspection)
    scales = DrawingScales(ellipses=10.0, residuals=50.0)
    draw_view(axes, inspection, place, up, compute_extent(inspection, place), scales)
    return axes, scales


@pytest.mark.parametrize(("up", "axis"), [(NORTH, 1), (UP, 2)])
def test_arrows_point_from_the_surveyed_to_the_adjusted_position(
    painted: PaintedWall, up: np.ndarray, axis: int
) -> None:
    """The check point was given at (7, 0, 3) and is 12 mm west, 5 mm north and 15 mm below of it in the block."""
    axes, scales = draw_axes(make_inspection(painted, [], []), up)
    arrows = [child for child in axes.get_children() if isinstance(child, Quiver)]
    ends = {(a.X[0], a.Y[0]): (a.U[0], a.V[0]) for a in arrows}
    given, away = (7.0, 0.0, 3.0), (-0.012, 0.005, -0.015)
    expected = (away[0] * scales.residuals, away[axis] * scales.residuals)
    assert ends[given[0], given[axis]] == pytest.approx(expected, rel=0, abs=1e-9)  # m


def test_ellipses_hold_95_of_100_cameras(painted: PaintedWall) -> None:
    """Camera a's ellipse by sampling: 95 % of the places that its covariance allows lie inside what is drawn."""
    turn = cv2.Rodrigues(np.array([0.3, -0.2, 0.8]))[0]
    factor = turn * [0.01, 0.03, 0.06]
    inspection = make_inspection(painted, [], [])
    rows = inspection.poses.to_pylist()
    whole = np.eye(6)
    whole[:3, :3] = factor @ factor.T
    rows[0]["covariance"] = whole.ravel().tolist()
    rows[1]["covariance"] = None
    inspection = replace(inspection, poses=table_from_rows("poses", rows))
    samples = np.random.default_rng(5).normal(size=(4000, 3)) @ factor.T
    for up in (NORTH, UP):
        axes, scales = draw_axes(inspection, up)
        (ellipses,) = [child for child in axes.get_children() if isinstance(child, EllipseCollection)]
        angle = np.radians(ellipses.get_angles()[0])
        seen = samples @ np.column_stack([[1.0, 0.0, 0.0], up]) * scales.ellipses
        along = seen @ [np.cos(angle), np.sin(angle)] / (ellipses.get_widths()[0] / 2)
        beside = seen @ [-np.sin(angle), np.cos(angle)] / (ellipses.get_heights()[0] / 2)
        assert len(ellipses.get_widths()) == 1  # the other camera states none
        assert 0.935 < (along**2 + beside**2 <= 1).mean() < 0.965
        assert np.std(along) == pytest.approx(np.std(beside), rel=0.08)  # and it lies along them


@pytest.mark.parametrize(("up", "nearest_x_m"), [(NORTH, 0.0), (UP, 4.0)])
def test_the_model_is_seen_from_above_and_from_the_south(
    painted: PaintedWall, up: np.ndarray, nearest_x_m: float
) -> None:
    """Two triangles: one at the north and top, one at the south and bottom; the nearer one is drawn last."""
    north_top = np.array([[0.0, 9.0, 8.0], [1.0, 9.5, 8.0], [0.0, 9.5, 9.0]])
    south_low = np.array([[4.0, 0.0, 0.0], [6.0, 0.5, 0.0], [4.0, 0.5, 2.0]])
    model = replace(
        painted.building, vertices_site_m=np.vstack([north_top, south_low]), triangles=np.arange(6).reshape(2, 3)
    )
    axes = Figure().add_subplot()
    low, high = draw_model(axes, model, np.array([1.0, 0.0, 0.0]), up)
    assert np.ptp([low, high], axis=0) == pytest.approx([6.0, 9.5 if up is NORTH else 9.0], rel=0, abs=1e-9)  # m
    (grey,) = [child for child in axes.get_children() if isinstance(child, PolyCollection)]
    assert grey.get_paths()[-1].vertices[0, 0] == nearest_x_m


def test_exaggeration_is_round(painted: PaintedWall) -> None:
    place = collect_geometry(make_inspection(painted, [], []))
    found = choose_scales(place, extent_m=14.0)
    assert found == DrawingScales(ellipses=5.0, residuals=20.0)
    metres = replace(place, covariance_m2=place.covariance_m2 * 1e6, points=())
    assert choose_scales(metres, extent_m=14.0) == DrawingScales(ellipses=0.005, residuals=1.0)
    exact = tuple((kind, given, residual * 0) for kind, given, residual in place.points)
    assert choose_scales(replace(place, points=exact), extent_m=14.0).residuals == 1.0


def test_the_report_shows_values_meanings_limits_and_points(painted: PaintedWall, tmp_path: Path) -> None:
    inspection = make_inspection(painted, [], [])
    text = "".join(piece.text for piece in render_passport(inspection, tmp_path))
    assert "Usable, check control points" in text
    for words in (
        "error at check points and held-out control points",
        "three standard deviations",
        'class="check">check',
        "<td>check</td>",
    ):
        assert words in text
    assert '<td class="n">-12</td><td class="n">+5</td><td class="n">-15</td>' in text
    assert NASTY_NAME not in text  # escaped
    empty = replace(inspection, georeference=get_stage_schema("georeference").empty_table())
    assert "no passport" in render_passport(empty, tmp_path)[0].text


def test_a_passport_without_points_or_cameras_is_drawn(painted: PaintedWall, tmp_path: Path) -> None:
    inspection = replace(
        make_inspection(painted, [], []),
        georeference_points=get_stage_schema("georeference_points").empty_table(),
        placement_checks=get_stage_schema("placement_checks").empty_table(),
        poses=get_stage_schema("poses").empty_table(),
    )
    picture = cv2.imread(str(draw_passport(inspection, tmp_path / "passport.png")))
    assert min(picture.shape[:2]) > 1000
    assert (picture < 128).any(axis=2).mean() > 0.005  # there is writing on it


def test_datums_are_facts_where_they_differ() -> None:
    poses = get_stage_schema("poses").empty_table()
    facts = {fact.name: fact.value for fact in list_passport_facts(CENTIMETRES, poses, placement_sigma_max_m=0.5)}
    assert facts["longitude and latitude"] == "ETRS89 to WGS 84 (1), accuracy 1 m"
    assert "datum of the control" not in facts
    shifted = CENTIMETRES | {
        "control_operation": "ED50 to ETRS89 (1)", "control_operation_accuracy_m": None,
        "control_operation_sigma_m": 25.0,
    }  # fmt: skip
    facts = {fact.name: fact.value for fact in list_passport_facts(shifted, poses, placement_sigma_max_m=0.5)}
    assert facts["datum of the control"] == (
        "ED50 to ETRS89 (1), accuracy unknown; in the standard deviations: 25.00 m"
    )
