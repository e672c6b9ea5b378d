"""The command, and the comparison of a lake with truth that is not of it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pyarrow as pa
import pytest
from typer.testing import CliRunner

from benchmarks.synthetic_history import HistoryRecipe, SyntheticHistory, draw_history
from benchmarks.synthetic_tracking import build_tables, draw_looks
from cli.main import app
from facadelake.core.errors import InputDataError, StoreError
from facadelake.core.tables import table_from_rows
from facadelake.evaluation.history import compare_history, compute_history_figures, evaluate
from facadelake.evaluation.history.truth import HistoryTruth
from facadelake.registry import Building
from facadelake.tracking import link_history, list_look_requests
from schemas.vocabulary import SurfaceKind

TOWER = cast(Building, SimpleNamespace(id="tower", surface_kind=SurfaceKind.IFC))
ALL = "--history evaluates all campaigns of the lake as it is, with their committed detections: leave out "
ELSEWHERE = "; other detections are inspected into a lake of their own"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["evaluate", "tower", "2026-04", "--history"], f"{ALL}CAMPAIGN{ELSEWHERE}"),
        (["evaluate", "tower", "--history", "--detections", "noisy"], f"{ALL}--detections{ELSEWHERE}"),
        (["evaluate", "tower", "2026-04", "--history", "--as-of", "3"], f"{ALL}CAMPAIGN and --as-of{ELSEWHERE}"),
        (["evaluate", "tower"], "name a campaign of tower, or evaluate all of them with --history"),
    ],
)
def test_what_the_command_is_asked_must_be_clear(tmp_path: Path, words: list[str], message: str) -> None:
    portfolio = tmp_path / "portfolio.yaml"
    portfolio.write_text(
        "buildings:\n- {id: tower, name: Tower, model: tower.ifc, photographs: '{campaign}',\n"
        "   detector: {kind: coco, file: boxes.json}}\n"
    )
    options = ["--truth", str(tmp_path), "--portfolio", str(portfolio), "--lake", str(tmp_path)]
    with pytest.raises(InputDataError) as raised:
        CliRunner().invoke(app, [*words, *options], catch_exceptions=False)
    assert str(raised.value) == message


def make_lake(monkeypatch: pytest.MonkeyPatch, history: SyntheticHistory, *, detector: str, file: str) -> HistoryTruth:
    """A lake with a drawn history: every defect has one detection, whose annotation is the defect's number."""
    linked = link_history(history.records, history.recipe.area_m2)
    tracked = build_tables(linked, draw_looks(history, list_look_requests(linked), 0)).tables["track_states"]
    detections, observations, annotations = [], [], {}
    for (campaign, defect_id), true_id in history.true_ids.items():
        detections.append(
            {
                "campaign_id": campaign, "detection_id": defect_id, "detector": detector,
                "source_annotation": defect_id.split("-")[-1],
            }
        )  # fmt: skip
        observations.append(
            {
                "campaign_id": campaign, "detection_id": defect_id, "defect_id": defect_id,
                "observation_outcome": "registered",
            }
        )  # fmt: skip
        annotations.setdefault(campaign, {})[file, defect_id.split("-")[-1]] = true_id
    tables = {
        "detections": pa.Table.from_pylist(detections), "observations": pa.Table.from_pylist(observations),
        "track_states": tracked,
    }  # fmt: skip
    monkeypatch.setattr(evaluate, "_read_tables", lambda lake, building: tables)
    monkeypatch.setattr(evaluate, "read_registered_model", lambda building: None)
    monkeypatch.setattr(
        evaluate, "read_history", lambda lake, building, model, current: SimpleNamespace(records=history.records)
    )
    content = HistoryTruth(
        defects={
            campaign: [of_days[number] for of_days in history.truth.values()]
            for number, campaign in enumerate(history.campaigns)
        },
        true_id_of_annotation=annotations,
        path=dict.fromkeys(history.campaigns, Path("detections.csv")),
    )
    monkeypatch.setattr(evaluate, "read_history_truth", lambda folder: content)
    return content


HISTORY = draw_history(HistoryRecipe(defects=12, campaigns=3, recall=0.9), 0)


def test_a_lake_is_compared_by_annotations(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    make_lake(monkeypatch, HISTORY, detector="coco:boxes.json", file="boxes.json")
    found = compare_history(TOWER, lake=tmp_path, truth=tmp_path)
    assert found.compared.campaigns == HISTORY.campaigns
    assert {key: one.true_id for key, one in found.compared.defects.items()} == dict(HISTORY.true_ids)
    assert compute_history_figures(found.compared).identity.idf1 == 1.0


def test_detections_that_truth_cannot_identify(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    make_lake(monkeypatch, HISTORY, detector="model.onnx", file="boxes.json")
    with pytest.raises(InputDataError) as raised:
        compare_history(TOWER, lake=tmp_path, truth=tmp_path)
    assert str(raised.value) == (
        f"the detections of {HISTORY.campaigns[0]} are those of a model: truth identifies the boxes of a file; inspect "
        "the campaign with 'facadelake inspect ... --detections'"
    )
    make_lake(monkeypatch, HISTORY, detector="coco:other.json", file="boxes.json")
    with pytest.raises(InputDataError, match=r"no line for 'other.json'"):
        compare_history(TOWER, lake=tmp_path, truth=tmp_path)


def test_truth_of_other_campaigns(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content = make_lake(monkeypatch, HISTORY, detector="coco:boxes.json", file="boxes.json")
    first, *others = HISTORY.campaigns
    less = HistoryTruth(
        defects={first: content.defects[first]}, true_id_of_annotation=content.true_id_of_annotation, path=content.path
    )
    monkeypatch.setattr(evaluate, "read_history_truth", lambda folder: less)
    with pytest.raises(InputDataError) as raised:
        compare_history(TOWER, lake=tmp_path, truth=tmp_path)
    assert str(raised.value) == (
        f"{tmp_path} has no truth of {', '.join(others)}, which the lake holds of tower (truth has {first}); give the "
        "truth of this building's campaigns"
    )
    more = HistoryTruth(
        defects={**content.defects, "2099-01": content.defects[first]},
        true_id_of_annotation=content.true_id_of_annotation,
        path=content.path,
    )
    monkeypatch.setattr(evaluate, "read_history_truth", lambda folder: more)
    compare_history(TOWER, lake=tmp_path, truth=tmp_path)
    assert "the lake does not hold 2099-01, of which there is truth: left out" in caplog.text


def test_a_lake_without_tracks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="there is no lake"):
        evaluate._read_tables(tmp_path, TOWER)
    empty = {name: table_from_rows(name, []) for name in ("detections", "observations", "track_states")}
    monkeypatch.setattr(evaluate, "has_lake", lambda lake: True)
    monkeypatch.setattr(evaluate, "read_tables", lambda lake, names, building_id: cast(Any, empty))
    with pytest.raises(StoreError) as raised:
        evaluate._read_tables(tmp_path, TOWER)
    assert str(raised.value) == (
        f"the lake {tmp_path} has no tracks of tower; inspect a campaign of it with this version, or see "
        "'facadelake campaigns'"
    )
