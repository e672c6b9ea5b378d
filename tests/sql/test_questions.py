"""Each question of sql/questions has a right answer."""

from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError
from facadelake.lake.questions import answer_question
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, commit


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lake")
    commit(folder, defects=4, sightings=2)
    commit(folder, campaign_id="2026-10", defects=1, sightings=1)
    return folder


def test_answers_are_right(lake: Path) -> None:
    here = {"building_id": BUILDING, "campaign_id": CAMPAIGN}
    storeys = answer_question(lake, "defects_by_storey", here).to_pylist()
    assert {(r["storey"], r["defect_class"], r["defects"]) for r in storeys} == {
        ("Level 1", "crack", 2),
        ("Level 1", "spalling", 1),
        ("Level 1", "moisture", 1),
    }
    outcomes = answer_question(lake, "detections_by_outcome", here).to_pylist()
    assert {
        (r["stage"], r["outcome"]): r["detections"] for r in outcomes if r["class"] in ("moisture", "graffiti")
    } == {
        ("register", "registered"): 2,
        ("detect", "unknown_class"): 1,
    }
    assert answer_question(lake, "photographs_rejected", here)["reason"].to_pylist() == ["0 bytes"]
    warned = answer_question(lake, "photographs_with_warnings", here).to_pylist()
    assert [(r["photo_id"], r["warnings"]) for r in warned] == [("closerange/p0.jpg", "the XMP packet is damaged")]
    assert len(answer_question(lake, "worst_defects", {**here, "limit": 2})) == 2
    (pair,) = answer_question(lake, "merges_of_defect", {**here, "defect_id": "defect-0000"}).to_pylist()
    assert (pair["merge_decision"], pair["photo_id"], pair["other_photo_id"]) == (
        "joined", "closerange/p0.jpg", "closerange/p1.jpg",
    )  # fmt: skip
    assert len(answer_question(lake, "merges_of_defect", {**here, "defect_id": "defect-0001"})) == 0
    off = answer_question(lake, "deviations_from_model", here).to_pylist()
    assert [(r["defect_id"], r["deviation_from_model_m"], r["sigmas"]) for r in off] == [
        ("defect-0003", -0.13, 16.3), ("defect-0002", -0.08, 10.0), ("defect-0001", -0.03, 3.8),
        ("defect-0000", 0.02, 2.5),
    ]  # fmt: skip
    assert {
        (r["severity"], r["graded_by"], r["defect_class"], r["defects"])
        for r in answer_question(lake, "defects_by_severity", here).to_pylist()
    } == {("minor", "rules", "crack", 2), ("minor", "rules", "spalling", 1), ("minor", "rules", "moisture", 1)}
    (storey,) = answer_question(lake, "coverage_by_storey", here).to_pylist()
    assert (storey["facade"], storey["storey"], storey["surface_m2"]) == ("S", "Level 1", 5.0)
    assert (storey["imaged_share"], storey["searched_share"], storey["not_in_view_m2"]) == (0.8, 0.6, 1.0)
    assert storey["found_crack_width_mm"] is None  # unknown of one searched cell
    (wall,) = answer_question(lake, "not_covered_for_crack", {**here, "crack_width_mm": 1.0}).to_pylist()
    shares = ("never_imaged_m2", "not_searched_m2", "too_coarse_m2", "unknown_m2", "surface_m2")
    assert [wall[name] for name in shares] == [1.0, 1.0, 1.0, 1.0, 5.0]
    (wall,) = answer_question(lake, "not_covered_for_crack", {**here, "crack_width_mm": 3.0}).to_pylist()
    assert wall["too_coarse_m2"] == 0.0
    density = {r["divided_by"]: r for r in answer_question(lake, "defect_density", here).to_pylist()}
    assert {by: r["part"] for by, r in density.items()} == {
        "facade": "S", "storey": "Level 1", "material": "brick", "ifc_class": "IfcWall",
    }  # fmt: skip
    for row in density.values():
        assert (row["defects"], row["cracks"], row["searched_m2"]) == (4, 2, 3.0)
        assert (row["defects_per_m2"], row["defects_per_m2_sigma"]) == (1.3333, 0.6667)
    both = answer_question(lake, "campaigns").to_pylist()
    assert [(r["campaign_id"], r["defects_total"], r["run_id"]) for r in both] == [
        (CAMPAIGN, 4, "run-1"),
        ("2026-10", 1, "run-1"),
    ]
    (placed,) = answer_question(lake, "passport", here).to_pylist()
    assert (placed["control"], placed["check_points"], placed["sigma_up_m"]) == ("gps", 1, 0.4)
    assert (placed["check_residual_max_m"], placed["doming_m"], placed["remarks"]) == (0.05, None, "synthetic")
    assert len(answer_question(lake, "passport")) == 2
    assert both[0]["version"] < both[1]["version"]
    assert len(answer_question(lake, "campaigns", as_of=both[0]["version"])) == 1
    with pytest.raises(InputDataError, match="has no building 'nobody's'"):
        answer_question(lake, "worst_defects", {"building_id": "nobody's"})
