"""The whole command on a model that answers with fixed boxes: figures, card, page, pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from cli.main import app
from facadelake.core.errors import InputDataError, ModelError
from facadelake.detection.card import read_card
from tests.unit.detection.onnx_models import HEIGHT, WIDTH, make_card, make_output, save_model

# The model answers with these in every photograph of its input's size: a hit on 'a' and nowhere else, and a faint one.
SEEN = (20.0, 10.0, 30.0, 20.0)
FAINT = (60.0, 40.0, 20.0, 10.0)


def run(*words: str | Path) -> str:
    result = CliRunner().invoke(app, ["evaluate-detector", *map(str, words)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def model(tmp_path: Path) -> Path:
    rows = [(0, x + w / 2, y + h / 2, w, h, s, 0) for (x, y, w, h), s in ((SEEN, 0.8), (FAINT, 0.1))]
    path = save_model(tmp_path / "fixed.onnx", make_output("nms6", rows))
    text = "# kept\n" + yaml.safe_dump(make_card("nms6", metrics={"own": [1, 2]})) + "source: somewhere  # kept, too\n"
    path.with_suffix(".card.yaml").write_text(text)
    return path


def photograph(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((HEIGHT, WIDTH, 3), 90, dtype=np.uint8))


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = tmp_path / "walls"
    truths: list[dict[str, Any]] = []
    for i, (name, corner) in enumerate([("a", SEEN), ("b", (5, 5, 9, 9)), ("c", None), ("d", SEEN)]):
        photograph(folder / f"{name}.png")
        if corner:
            truths.append({"id": i, "image_id": i, "category_id": 0, "bbox": list(corner)})
    images = [{"id": i, "file_name": f"{name}.png"} for i, name in enumerate("abcd")]
    file = folder / "coco.json"
    file.write_text(json.dumps({"images": images, "annotations": truths, "categories": [{"id": 0, "name": "crack"}]}))
    (tmp_path / "sites.csv").write_text("image,site,split\na.png,north,test\nb.png,north,test\nc.png,south,test\n")
    return file


@pytest.fixture
def sound(tmp_path: Path) -> Path:
    for name in ("e", "f"):
        photograph(tmp_path / "sound" / f"{name}.png")
    (tmp_path / "scale.csv").write_text("image,area_m2\n*,20\n")
    (tmp_path / "both.csv").write_text("image,site,split\n*,somewhere,test\n")
    return tmp_path / "sound"


def test_figures_by_hand(model: Path, data: Path, tmp_path: Path) -> None:
    printed = json.loads(
        run("--model", model, "--data", data, "--sites", tmp_path / "sites.csv", "--split", "test", "--json")
    )
    (crack,) = printed["classes"]
    # Shown in a, b and c; right in a. Faint ones (0.1) in all three are wrong and count for precision's tail alone.
    assert {key: crack["operating"][key] for key in ("hits", "false_alarms", "misses")} == {
        "hits": 1,
        "false_alarms": 2,
        "misses": 1,
    }
    # Equal scores stand in the photographs' order: precision 1 up to a recall of 0.5, then none.
    assert crack["ap50"] == pytest.approx(51 / 101) == crack["ap50_95"]
    assert crack["calibration"]["count"] == 6 and crack["calibration"]["count_shown"] == 3
    assert crack["calibration"]["expected_precision"] == pytest.approx(0.8, abs=1e-6)
    assert crack["calibration"]["precision_shown"] == pytest.approx(1 / 3)
    assert printed["data"]["left_out"] == {"photographs that are not in the file of sites": 1}
    assert [(one["site"], one["truths"], one["ap50"]) for one in printed["sites"]] == [
        ("north", 2, pytest.approx(51 / 101)),
        ("south", 0, None),
    ]
    assert {(one["truth"], one["shown"]): one["count"] for one in printed["confusions"]} == {
        ("crack", "crack"): 1,
        ("crack", "nothing"): 1,
        ("nothing", "crack"): 2,
    }
    assert printed["judged"]["name"] == "fixed" and printed["judged"]["threshold"] == 0.25
    assert any("2 sites" in one for one in printed["remarks"])


def test_false_alarms_and_image_labels(model: Path, data: Path, sound: Path, tmp_path: Path) -> None:
    for name in ("crack/g", "intact/h", "rust/i"):
        photograph(tmp_path / "bricks" / f"{name}.png")
    scale = ("--scale", tmp_path / "scale.csv")
    printed = json.loads(
        run("--model", model, "--negatives", sound, *scale, "--image-labels", tmp_path / "bricks", "--json")
    )
    every = printed["negatives"]["rates"][0]
    assert (every["count"], every["area_m2"], every["per_10_m2"]) == (2, 40.0, 0.5)
    assert not printed["classes"]
    (bricks,) = printed["image_labels"]
    assert bricks["classes"][0]["auroc"] == 0.5 and bricks["classes"][0]["false_alarm_share"] == 1.0
    assert list(bricks["left_out"].values()) == [1] and bricks["sound_folders"] == ["intact"]


def test_card_page_and_pictures(model: Path, data: Path, sound: Path, tmp_path: Path) -> None:
    words = ("--model", model, "--data", data, "--negatives", sound, "--scale", tmp_path / "scale.csv", "--write-card")
    table = run(*words, "--plots", tmp_path / "plots")
    assert "crack" in table and "By site" in table and "0.500" in table
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == [
        "false_alarms.png",
        "precision_recall.png",
        "reliability.png",
        "worst.png",
        "worst_without_defects.png",
    ]
    sheet = cv2.imread(str(tmp_path / "plots" / "worst.png"))
    assert sheet is not None and (sheet == (0, 0, 220)).all(axis=2).sum() > 200  # red frames
    path = model.with_suffix(".card.yaml")
    text = path.read_text()
    assert text.startswith("# kept\n") and "source: somewhere  # kept, too\n" in text
    metrics = read_card(path).metrics
    assert metrics["own"] == [1, 2] and [one["kind"] for one in metrics["evaluations"]] == ["boxes", "without defects"]
    first = metrics["evaluations"][0]
    assert first["classes"][0]["hits"] == 2 and len(first["data_sha256"]) == 64
    run(*words)  # again: replaced, not doubled
    assert len(read_card(path).metrics["evaluations"]) == 2
    page = CliRunner().invoke(app, ["describe-detector", "--model", str(model), "--output", str(tmp_path / "page.md")])
    assert page.exit_code == 0
    printed = (tmp_path / "page.md").read_text()
    assert (
        f"| crack | 4 | 3 | {first['classes'][0]['ap50']:.3f} |" in printed
        and "| sound | all | 2 | 40 | 57.1 | 2 | 2 | 0.50 |" in printed
    )
    # Figures of another model are not this one's.
    save_model(model, make_output("nms6", [(0, 30, 30, 10, 10, 0.9, 0)]))
    result = CliRunner().invoke(app, ["describe-detector", "--model", str(model)])
    assert "None yet" in result.stdout


def test_a_file_of_detections_is_judged_like_a_model(data: Path, tmp_path: Path) -> None:
    content = json.loads(data.read_text())
    file = tmp_path / "found.json"
    file.write_text(json.dumps(content))
    (crack,) = json.loads(run("--model", file, "--data", data, "--json"))["classes"]
    assert crack["ap50_by_sites"] is None and crack["ap50_by_photographs"]["groups"] == 4  # nobody named sites
    assert crack["ap50"] == pytest.approx(1.0, abs=1e-12) and crack["operating"]["f1"] == 1
    content["images"] = [{"id": i, "file_name": f"other {i}.png"} for i in range(4)]
    file.write_text(json.dumps(content))
    with pytest.raises(InputDataError, match="has none of the 4 labelled photographs"):
        run("--model", file, "--data", data)


def test_what_is_refused(model: Path, data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="no data to evaluate on"):
        run("--model", model)
    with pytest.raises(InputDataError, match="is not a file that can be evaluated"):
        run("--model", tmp_path / "none.onnx", "--data", data)
    with pytest.raises(InputDataError, match="omit --threshold"):
        run("--model", model, "--data", data, "--write-card", "--threshold", "0.1")
    model.with_suffix(".card.yaml").unlink()
    with pytest.raises(ModelError, match="does not exist"):
        run("--model", model, "--data", data)
