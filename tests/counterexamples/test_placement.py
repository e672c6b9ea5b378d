"""Campaigns that fit their control to a centimetre and lie elsewhere: refused, with what contradicts them and why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
import trimesh

from facadelake.building.surface import Surface
from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.gcp.control_points import SurveyedPoints
from facadelake.georeferencing.model.control import ModelControl
from schemas.vocabulary import ControlKind, PlacementCheckOutcome, PlacementStatement, PointKind
from tests.synthetic.test_georeference import Scene, build_model, build_ring

SCENE = Scene(build_ring())
REPEATED = "check points left out, which are control points (less than 1 cm apart), so that they tell nothing new: "
NOT_IN_VIEW = "0 of 24 photographs have the building model in view (limit 25%)"


def move(points: SurveyedPoints, east_m: float = 0.0, north_m: float = 0.0, up_m: float = 0.0) -> SurveyedPoints:
    return replace(
        points,
        points=tuple(replace(p, x=p.x + east_m, y=p.y + north_m, z=p.z + up_m) for p in points.points),
    )


def scale_heights(points: SurveyedPoints, factor: float) -> SurveyedPoints:
    return replace(points, points=tuple(replace(p, z=p.z * factor) for p in points.points))


def test_control_points_right_by_themselves_agree() -> None:
    found = SCENE.georeference(ControlKind.GCP, control_points=SCENE.build_control(), model=build_model())
    outcomes = {check.statement: check.outcome for check in found.placement_checks}
    without = {PlacementStatement.SURVEYED_POINTS}  # no check points are given
    assert {name for name, outcome in outcomes.items() if outcome is not PlacementCheckOutcome.AGREES} == without
    assert len(outcomes) == 7
    assert "disagreement" not in found.row["remarks"]


def test_control_points_48_m_low() -> None:
    """They fit one another to a centimetre; the campaign was once committed with every check passed."""
    with pytest.raises(GeoreferenceError) as raised:
        SCENE.georeference(ControlKind.GCP, control_points=move(SCENE.build_control(), up_m=-48.0), model=build_model())
    message = str(raised.value)
    assert message.startswith("the placement by control points is contradicted: the cameras lie -4")
    assert NOT_IN_VIEW in message
    assert "would, if the campaign were shifted by east " in message
    assert "m, height +4" in message
    assert "Probable causes: heights above the geoid taken as ellipsoidal, or the reverse (a shift of +4" in message
    assert "Correct the statement that is wrong, or choose another control with --georeference; where the " in message
    assert message.endswith("(accept_placement in the portfolio: camera_height, model_in_view, tie_points)")


def test_control_points_in_another_datum() -> None:
    with pytest.raises(GeoreferenceError) as raised:
        SCENE.georeference(
            ControlKind.GCP, control_points=move(SCENE.build_control(), 120.0, 90.0), model=build_model()
        )
    message = str(raised.value)
    assert "GPS of 24 photographs (flight 1) deviates from the placed cameras by east -11" in message
    assert "another datum or CRS (a horizontal shift of 1" in message
    assert "m has the size of a datum shift)" in message


def test_control_points_one_metre_off_are_contradicted_by_the_tie_points_alone() -> None:
    with pytest.raises(GeoreferenceError) as raised:
        SCENE.georeference(ControlKind.GCP, control_points=move(SCENE.build_control(), 1.0, 0.8), model=build_model())
    message = str(raised.value)
    assert "tie points lie within 0.5 m of the faces of the model that are seen behind them, " in message
    assert "It agrees with: GPS of 24 photographs" in message


def test_rtk_positions_that_contradict_control_points_without_a_model() -> None:
    photos = SCENE.build_photos()
    exact = [0.02] * 24 + [None]
    for name, column in (
        ("prior_sigma_horizontal_m", exact),
        ("prior_sigma_vertical_m", exact),
        ("prior_height_datum", ["ellipsoidal"] * 24 + ["unknown"]),
    ):
        field = photos.schema.get_field_index(name)
        photos = photos.set_column(field, photos.schema.field(name), [column])
    with pytest.raises(GeoreferenceError) as raised:
        SCENE.georeference(ControlKind.GCP, control_points=SCENE.build_control(), photos=photos)
    assert "m in height (median, sigma 0.0" in str(raised.value)
    found = SCENE.georeference(
        ControlKind.GCP, control_points=SCENE.build_control(), photos=photos, model=build_model()
    )
    assert found.row["remarks"].startswith("disagreement: GPS of 24 photographs (flight 1) deviates")
    assert np.linalg.norm(SCENE.compute_error_m(found), axis=1).mean() < 0.04  # m


def test_poses_of_a_scene_in_feet() -> None:
    with pytest.raises(GeoreferenceError, match=r"heights in feet read as metres \(the cameras lie"):
        SCENE.georeference(
            ControlKind.GCP, control_points=move(SCENE.build_control(), up_m=187 / 0.3048 - 187), model=build_model()
        )


def test_check_points_that_contradict_control_points_without_a_model() -> None:
    """Four control points 48 m low, two check points that are right: once committed, the check points outnumbered."""
    control = SCENE.build_control()
    low = move(replace(control, points=control.points[:4]), up_m=-48.0)
    with pytest.raises(GeoreferenceError) as raised:
        SCENE.georeference(
            ControlKind.GCP, control_points=low, check_points=replace(control, points=control.points[4:])
        )
    assert "2 check points deviate by 4" in str(raised.value)


@pytest.mark.parametrize("is_same_file", [True, False])
def test_check_points_of_the_same_wrong_survey_do_not_outvote_gps(is_same_file: bool) -> None:
    """All surveyed points are 48 m low: once committed, since the check points agreed with the control points."""
    low = move(SCENE.build_control(), up_m=-48.0)
    control = low if is_same_file else replace(low, points=low.points[:4])
    check = low if is_same_file else replace(low, points=low.points[4:])
    with pytest.raises(GeoreferenceError) as raised:
        SCENE.georeference(
            ControlKind.GCP,
            control_points=control,
            check_points=check,
            photos=state_height_datum(SCENE.build_photos()),
        )
    assert "GPS of 24 photographs (flight 1) deviates from the placed cameras by" in str(raised.value)
    assert "accept_placement in the portfolio: gps_height" in str(raised.value)


def test_control_points_given_as_check_points_too_check_nothing() -> None:
    control = SCENE.build_control()
    found = SCENE.georeference(ControlKind.GCP, control_points=control, check_points=control)
    assert REPEATED in found.row["remarks"]
    assert PointKind.CHECK not in {point.kind for point in found.points}
    statements = {check.statement: check.outcome for check in found.placement_checks}
    assert statements[PlacementStatement.SURVEYED_POINTS] is PlacementCheckOutcome.NOT_COMPARABLE


def test_control_points_in_feet_without_a_model() -> None:
    """Heights of 187 m in feet place the block 427 m too high: more than any geoid height."""
    with pytest.raises(GeoreferenceError) as raised:
        SCENE.georeference(ControlKind.GCP, control_points=move(SCENE.build_control(), up_m=187 / 0.3048 - 187))
    message = str(raised.value)
    assert "and a geoid height of up to 106 m, as the height datum is unknown)" in message
    assert "heights in feet read as metres (the cameras lie" in message


def raise_model(up_m: float) -> ModelControl:
    """The scene's building as a mesh whose height in the portfolio is wrong, within what buildings have."""
    box = trimesh.creation.box(bounds=[[-10, -6, up_m], [10, 6, 14 + up_m]])
    surface = Surface.from_mesh(np.asarray(box.vertices, dtype=float), np.asarray(box.faces, dtype=np.int64))
    return ModelControl(surface=surface, sigma_m=0.03, ground_site_m=up_m, highest_site_m=14 + up_m)


def state_height_datum(photos: pa.Table) -> pa.Table:
    """The same photographs, their heights ellipsoidal."""
    field = photos.schema.get_field_index("prior_height_datum")
    return photos.set_column(field, photos.schema.field(field), [["ellipsoidal"] * 24 + ["unknown"]])


@pytest.mark.parametrize("up_m", [3.0, -48.0])
def test_a_model_at_a_wrong_height_is_contradicted_by_control_points(up_m: float) -> None:
    with pytest.raises(GeoreferenceError, match=r"tie points lie within 0\.5 m of the faces of the model|in view"):
        SCENE.georeference(ControlKind.GCP, control_points=SCENE.build_control(), model=raise_model(up_m))


@pytest.mark.parametrize("kind", [ControlKind.GPS, ControlKind.MODEL, None])
def test_a_model_at_a_wrong_height_is_contradicted_by_gps_with_a_datum(kind: ControlKind | None) -> None:
    with pytest.raises(GeoreferenceError):
        SCENE.georeference(kind, photos=state_height_datum(SCENE.build_photos()), model=raise_model(48.0))
