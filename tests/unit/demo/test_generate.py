"""The demo is complete or absent, is not made twice, and errors of a recipe are reported."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from facadelake.core.errors import InputDataError, ModelError
from facadelake.demo import generate
from facadelake.demo.generate import DemoFiles, generate_demo
from facadelake.demo.recipe import DemoRecipe, load_recipe


def _pretend(recipe: DemoRecipe, out: Path) -> None:
    (out / "campaigns").mkdir(parents=True)
    (out / "demo.ifc").write_text(recipe.place.crs)


def test_a_second_call_finds_the_demo(recipe: DemoRecipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generate, "_write_demo", _pretend)
    assert generate_demo(recipe, tmp_path / "out").made
    assert not generate_demo(recipe, tmp_path / "out").made
    (tmp_path / "out" / "demo.ifc").unlink()
    assert generate_demo(recipe, tmp_path / "out").made
    assert generate_demo(recipe.model_copy(update={"seed": 1}), tmp_path / "out").made


def test_a_failed_run_leaves_the_old_demo_and_no_rubbish(
    recipe: DemoRecipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(generate, "_write_demo", _pretend)
    generate_demo(recipe, tmp_path / "out")
    (tmp_path / ".out.12345678.part").mkdir()

    def fail(recipe: DemoRecipe, out: Path) -> None:
        _pretend(recipe, out)
        raise ModelError("stopped half-way")

    monkeypatch.setattr(generate, "_write_demo", fail)
    with pytest.raises(ModelError, match="half-way"):
        generate_demo(recipe.model_copy(update={"seed": 2}), tmp_path / "out")
    assert (tmp_path / "out" / "demo.ifc").is_file()
    assert not list(tmp_path.glob("*.part")) + list(tmp_path.glob(".*.part"))


def test_the_files_are_those_of_the_exchange_format(small_demo: DemoFiles) -> None:
    for campaign in small_demo.campaigns:
        for name in ("detections.coco.json", "detections_noisy.coco.json", "gcp_list.txt"):
            assert (campaign.folder / name).is_file()
        coco = json.loads((campaign.folder / "detections.coco.json").read_text())
        files = {str(p.relative_to(campaign.images)) for p in campaign.images.rglob("*.JPG")}
        assert {i["file_name"] for i in coco["images"]} == files
        for a in coco["annotations"]:
            x, y, w, h = a["bbox"]
            assert x >= 0
            assert y >= 0
            assert x + w <= coco["images"][0]["width"] + 0.02
            assert y + h <= coco["images"][0]["height"] + 0.02


def test_states_follow_the_recipe_and_the_photographs(small_demo: DemoFiles) -> None:
    before, after = (_rows(c.folder / "truth" / "defects.csv") for c in small_demo.campaigns)
    assert {r["true_state"] for r in before} == {"absent"}
    assert {r["true_state"] for r in after} == {"present"}
    for row in after:
        unseen = int(row["photographs_of_place"]) == 0
        assert row["state"] == ("not_photographed" if unseen else "present")
    shown = {
        r["id"]: int(r["photographs"]) for r in _rows(small_demo.campaigns[1].folder / "truth" / "checkpoints.csv")
    }
    assert shown == {r["id"]: int(r["photographs_of_place"]) for r in after if int(r["photographs_of_place"])}
    assert _rows(small_demo.campaigns[0].folder / "truth" / "checkpoints.csv") == []


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_noisy_boxes_err_as_stated(small_demo: DemoFiles) -> None:
    folder = small_demo.campaigns[1].folder
    exact, noisy = (json.loads((folder / f"detections{n}.coco.json").read_text()) for n in ("", "_noisy"))
    rows = [r for r in _rows(folder / "truth" / "detections.csv") if r["file"] == "detections_noisy.coco.json"]
    assert len(rows) == len(noisy["annotations"])
    on_target = sum(r["checkpoint_id"] != "off_target" for r in rows)
    all_on_target = sum(
        r["checkpoint_id"] != "off_target"
        for r in _rows(folder / "truth" / "detections.csv")
        if r["file"] == "detections.coco.json"
    )
    assert 0.80 < on_target / all_on_target < 0.99
    assert len(exact["annotations"]) >= all_on_target


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed: 20260414", "sed: 20260414", "sed"),
        ("kind: crack", "kind: crak", "crak"),
        ("states: [present, present, present, present]", "states: [present]", "has 1 states, there are 4 campaigns"),
        ("states: [absent, absent, absent, new]", "states: [absent, absent, absent, seen]", "seen"),
        (
            "states: [absent, absent, absent, new]",
            "states: [absent, absent, absent, present]",
            "'present' cannot",
        ),
        (
            "repaired, reopened, present]",
            "repaired, present, present]",
            "'present' cannot follow 'repaired', rep",
        ),
        ("sizes: [1, 1, 1, 1.35]", "sizes: [1, 1, 1, 1]", "size 1 after 1 is 'present', but the state is 'grown'"),
        ("sizes: [1, 1, 1, 1.35]", "sizes: [1, 1, 1.35]", "has 3 sizes and 4 states"),
        ("{id: D02,", "{id: D01,", "ids are not unique"),
    ],
)
def test_errors_of_a_recipe_are_reported(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = (Path(__file__).parents[3] / "data" / "demo" / "recipe.yaml").read_text()
    assert old in text
    (tmp_path / "recipe.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputDataError, match=message):
        load_recipe(tmp_path / "recipe.yaml")


def test_a_defect_off_the_walls_is_refused(small_recipe: DemoRecipe, tmp_path: Path) -> None:
    first = small_recipe.defects[0].model_copy(update={"u_m": 60.0})
    with pytest.raises(ModelError, match=f"defect {first.id} .* is not on a wall"):
        generate_demo(small_recipe.model_copy(update={"defects": [first]}), tmp_path / "out")
