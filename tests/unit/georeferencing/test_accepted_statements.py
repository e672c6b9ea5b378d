"""Disagreements that the portfolio accepts: by statement and up to a limit, told with their reason; nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from facadelake.core.errors import GeoreferenceError
from facadelake.georeferencing.accepted_statements import accept_statements
from facadelake.georeferencing.placement_checks import PlacementCheck, build_checks_table, require_agreement
from facadelake.registry import AcceptedStatement
from schemas.vocabulary import ControlKind, PlacementCheckOutcome, PlacementStatement
from tests.counterexamples.test_placement import move
from tests.synthetic.test_georeference import Scene, build_model, build_ring

REASON = "insulated by 16 cm since the model was made"
AGREES, DISAGREES, ACCEPTED = (
    PlacementCheckOutcome.AGREES,
    PlacementCheckOutcome.DISAGREES,
    PlacementCheckOutcome.ACCEPTED,
)


def accept(statement: str, **limit: float) -> AcceptedStatement:
    return AcceptedStatement(statement=statement, reason=REASON, **limit)  # type: ignore[arg-type]


def state(statement: PlacementStatement, deviation: float, *, unit: str = "m") -> PlacementCheck:
    return PlacementCheck(statement=statement, outcome=DISAGREES, detail="it deviates", deviation=deviation, unit=unit)


def require(*checks: PlacementCheck) -> tuple[str, ...]:
    return require_agreement(
        checks, control=ControlKind.GCP, method="control points", placement_sigma_max_m=0.5, height_ellipsoidal_m=470.0
    )


def test_an_accepted_disagreement_is_told_with_its_reason() -> None:
    walls = state(PlacementStatement.TIE_POINTS, 0.8)
    with pytest.raises(GeoreferenceError, match=r"\(accept_placement in the portfolio: tie_points\)$"):
        require(walls)
    (checked,) = accept_statements([walls], [accept("tie_points", deviation_max_m=1.0)])
    assert checked.outcome is ACCEPTED
    assert require(checked) == (
        f"accepted disagreement: it deviates; accepted by accept_placement (up to 1 m): {REASON}",
    )
    assert build_checks_table([checked]).column("placement_check_outcome").to_pylist() == ["accepted"]


def test_beyond_its_limit_and_of_another_statement_nothing_is_accepted() -> None:
    far = state(PlacementStatement.TIE_POINTS, 48.0)
    (checked,) = accept_statements([far], [accept("tie_points", deviation_max_m=1.0)])
    with pytest.raises(GeoreferenceError, match="accept_placement accepts up to 1 m only"):
        require(checked)
    for other in (accept("gps_height", deviation_max_m=100.0), accept("tie_points", share_min=0.0)):
        with pytest.raises(GeoreferenceError):
            require(*accept_statements([far], [other]))
    fitting = PlacementCheck(statement=PlacementStatement.TIE_POINTS, outcome=AGREES, detail="", deviation=0.0)
    assert accept_statements([fitting], [accept("tie_points", deviation_max_m=1.0)]) == (fitting,)


def test_shares_are_accepted_down_to_a_limit() -> None:
    few = state(PlacementStatement.MODEL_IN_VIEW, 0.2, unit="share")
    assert accept_statements([few], [accept("model_in_view", share_min=0.1)])[0].outcome is ACCEPTED
    assert accept_statements([few], [accept("model_in_view", share_min=0.22)])[0].outcome is DISAGREES
    unlike = replace(few, statement=PlacementStatement.TIE_POINTS)
    assert accept_statements([unlike], [accept("tie_points", deviation_max_m=9.0)])[0].outcome is DISAGREES


@pytest.mark.parametrize(
    "given",
    [
        {"statement": "tie_points", "reason": REASON},
        {"statement": "tie_points", "reason": REASON, "deviation_max_m": 1.0, "share_min": 0.1},
        {"statement": "tie_points", "reason": "ok", "deviation_max_m": 1.0},
        {"statement": "held_out_points", "reason": REASON, "deviation_max_m": 1.0},
        {"statement": "mesh_reading", "reason": REASON, "share_min": 0.1},
    ],
    ids=["no limit", "two limits", "no reason", "refuses nothing", "has keys of its own"],
)
def test_a_setting_without_limit_or_reason_is_refused(given: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        AcceptedStatement.model_validate(given)


def test_a_campaign_is_committed_with_what_was_accepted() -> None:
    scene = Scene(build_ring())
    given = {"control_points": move(scene.build_control(), 1.0, 0.8), "model": build_model()}
    with pytest.raises(GeoreferenceError, match="tie points lie within"):
        scene.georeference(ControlKind.GCP, **given)
    found = scene.georeference(ControlKind.GCP, **given, accepted=[accept("tie_points", deviation_max_m=1.5)])
    assert f"(up to 1.5 m): {REASON}" in found.row["remarks"]
    outcomes = {check.statement: check.outcome for check in found.placement_checks}
    assert outcomes[PlacementStatement.TIE_POINTS] is ACCEPTED
    assert np.linalg.norm(scene.compute_error_m(found), axis=1).mean() > 1.0  # m: accepted, not mended
