"""From a review task to a promoted model on a small campaign: task, reviews, training set, comparison, promotion."""

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from cli.main import app
from cli.options import console
from facadelake.core.errors import InputDataError, ModelError
from facadelake.core.hashing import hash_file
from facadelake.detection.model_registry import find_default_model, read_promotions
from facadelake.evaluation.model_comparison.compare import compare_models
from facadelake.evaluation.model_comparison.promote import promote_model
from facadelake.registry import Portfolio, read_portfolio
from facadelake.reviews.campaign import export_task, import_reviews, read_reviewed_campaign
from facadelake.reviews.training.collect import make_training_set
from facadelake.reviews.training.options import PictureMode, Split, TrainingLabelFormat
from tests.unit.detection.onnx_models import make_card, save_model
from tests.unit.lake.small_campaign import BUILDING, CAMPAIGN, commit

HERE = f"{BUILDING}/{CAMPAIGN}"
# Every detection of the small campaign is this box: centre and size at half the photograph's 1600 x 1200 px.
AT_THE_BOX = (80.0, 47.5, 150.0, 75.0)


@pytest.fixture(scope="module")
def committed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small campaign in a lake, to copy."""
    folder = tmp_path_factory.mktemp("committed")
    commit(folder)
    return folder


@pytest.fixture
def tower(tmp_path: Path, committed: Path) -> tuple[Portfolio, Path]:
    """A registry of the small campaign's building, whose model file is lost, and its lake."""
    root = tmp_path / "photos"
    for i in range(2):
        path = root / "closerange" / f"p{i}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), np.full((1200, 1600, 3), 120 + 20 * i, dtype=np.uint8))
    registry = tmp_path / "portfolio.yaml"
    building = {
        "id": BUILDING, "name": "Tower", "model": "lost.ifc", "photographs": "photos", "campaigns": [CAMPAIGN],
        "detector": {"kind": "coco", "file": "boxes.json"},
    }  # fmt: skip
    registry.write_text(yaml.safe_dump({"buildings": [building]}))
    shutil.copytree(committed, tmp_path / "lake")
    return read_portfolio(registry), tmp_path / "lake"


def model(folder: Path, name: str, centre_and_size: tuple[float, float, float, float]) -> Path:
    """A model that finds one crack wherever it looks, in photographs shrunk to 800 x 600 px."""
    answer = np.zeros((1, 6, 2))
    answer[0, :4, 0], answer[0, 4, 0] = centre_and_size, 0.9
    answer[0, :4, 1] = (700.0, 500.0, 90.0, 90.0)  # of no score: a model that fills its input
    path = save_model(folder / f"{name}.onnx", answer, shape=(1, 3, 600, 800))
    content = make_card("yolov8")
    content |= {"name": name, "input": {**content["input"], "width_px": 800, "height_px": 600}}
    content["metrics"] = {"evaluations": [{"model_sha256": hash_file(path), "data": "held-out walls", "ap50": 0.5}]}
    path.with_suffix(".card.yaml").write_text(yaml.safe_dump(content))
    return path


def filled(task: Path, file: Path) -> Path:
    """The table with the crack confirmed and the spalling rejected, the moisture not reviewed."""
    lines = list(csv.DictReader((task / "defects.csv").open(encoding="utf-8-sig")))
    for line in lines:
        line["verdict"] = {"crack": "confirmed", "spalling": "rejected"}.get(line["defect_class"], "")
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, lines[0].keys())
        writer.writeheader()
        writer.writerows(lines)
    return file


def test_from_task_to_promotion(tower: tuple[Portfolio, Path], tmp_path: Path) -> None:
    portfolio, lake = tower
    building = portfolio.get_building(BUILDING)
    task, _ = export_task(
        building, CAMPAIGN, tmp_path / "task", lake=lake, photographs=(), only_unreviewed=True, score_min=0.0
    )
    assert (len(task.items), len(task.photographs)) == (6, 2)
    file = filled(tmp_path / "task", tmp_path / "filled.csv")
    done = import_reviews(building, CAMPAIGN, file, lake=lake, reviewer="A. Mason", task=None)
    assert (done.added.added, done.unmatched, done.parsed.remarks) == (4, (), ())
    campaign = read_reviewed_campaign(building, CAMPAIGN, lake=lake)
    assert {one.defect_class for one in campaign.status.unreviewed} == {"moisture"}

    made, placed = make_training_set(
        [building], tmp_path / "set", lake=lake, label_format=TrainingLabelFormat.YOLO,
        pictures=PictureMode.TILES, side_px=640, splits=(f"{BUILDING}=test",), terms=None,
    )  # fmt: skip
    assert placed == {BUILDING: Split.TEST}
    assert made.count_by_class(Split.TEST) == {"pictures": 2, "negatives": 0, "crack": 2, "spalling": 0, "moisture": 0}

    finds, blind = model(tmp_path, "finds", AT_THE_BOX), model(tmp_path, "blind", (600.0, 400.0, 40.0, 40.0))
    worse = compare_models(portfolio, finds, blind, [HERE], lake=lake, sample=None, folder=None)
    (report,) = worse.comparison.campaigns
    assert report.boxes == {"crack": {"stays": 0, "renamed": 0, "appears": 2, "vanishes": 2}}
    assert (report.wall, report.photographs_total) == (None, 2)
    assert "lost.ifc" in report.wall_remark
    assert (report.reviews["confirmed"], report.reviews["confirmed_lost"]) == (1, 1)
    assert [one.defect for one in report.lost] == ["defect-0000"]
    assert [path.name for path in worse.sheets] == ["vanishes.png", "appears.png", "lost.png"]
    better = compare_models(portfolio, blind, finds, [HERE], lake=lake, sample=1, folder=None)
    assert better.comparison.review_counts["confirmed_gained"] == 1
    assert better.comparison.lost == ()

    models_folder = tmp_path / "models"
    models_folder.mkdir()
    for suffix in (".onnx", ".card.yaml"):
        shutil.copy(finds.with_suffix(suffix), models_folder / f"facadelake-nano{suffix}")
    settings = {"lake": lake, "report": None, "by": "A. Mason", "why": "a trial", "models": models_folder}
    with pytest.raises(ModelError, match=r"(?s)was not promoted.*loses 1 of the 1 confirmed defects.*defect-0000"):
        promote_model(blind, **settings, lost_max=0, confirmed_min=1)
    assert read_promotions(models_folder) == ()
    entry, evidence = promote_model(blind, **settings, lost_max=1, confirmed_min=1)
    assert (entry.by, entry.replaces) == ("A. Mason", hash_file(finds))
    assert "1 of 1 confirmed defects lost (allowed 1)" in evidence
    assert hash_file(find_default_model(models_folder)) == hash_file(blind)
    assert promote_model(blind, **settings, lost_max=0, confirmed_min=1)[0] == entry
    back, _ = promote_model(finds, **settings, lost_max=0, confirmed_min=1)
    assert (back.replaces, len(read_promotions(models_folder))) == (hash_file(blind), 2)


def test_command_line_exports_imports_and_lists(tower: tuple[Portfolio, Path], tmp_path: Path) -> None:
    where = ["--portfolio", str(tmp_path / "portfolio.yaml"), "--lake", str(tower[1])]

    def run(*words: str) -> str:
        done = CliRunner().invoke(app, [*words, *where], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return " ".join(done.output.split())

    task = tmp_path / "task"
    with console.capture() as printed:
        run("review", "export-task", BUILDING, CAMPAIGN, str(task), "--photo", "closerange/p1.jpg")
    assert "3 boxes on 1 photographs of tower 2026-04" in printed.get()
    corrected = json.loads((task / "detections.coco.json").read_text())
    kept = [one for one in corrected["annotations"] if one["category_id"] == 1]
    (tmp_path / "back.json").write_text(json.dumps({**corrected, "annotations": kept}))
    with console.capture() as printed:
        run(
            "review", "import", BUILDING, CAMPAIGN, str(tmp_path / "back.json"), "--reviewer", "A. Mason",
            "--task", str(task / "detections.coco.json"),
        )  # fmt: skip
        run("review", "list", BUILDING, "--lines")
    assert "1 confirmed, 2 rejected" in printed.get()
    assert (
        "confirmed crack closerange/p1.jpg@10.0,20.0,300.0,150.0 crack = closerange/p1.jpg#0, A. Mason" in printed.get()
    )


def test_refusals_say_what_to_do(tower: tuple[Portfolio, Path], tmp_path: Path) -> None:
    portfolio, lake = tower
    one = model(tmp_path, "one", AT_THE_BOX)
    with pytest.raises(InputDataError, match=r"are the same file; give two models \(compare cards"):
        compare_models(portfolio, one, one, [HERE], lake=lake, sample=None, folder=None)
    with pytest.raises(InputDataError, match=r"--campaign 'tower' is not BUILDING/CAMPAIGN, such as demo/2026-04"):
        compare_models(portfolio, one, one, ["tower"], lake=lake, sample=None, folder=None)
    with pytest.raises(InputDataError, match=r"there is no default detector to compare with; .*--report"):
        promote_model(one, lake=lake, report=None, by="A", why="b", lost_max=0, confirmed_min=0, models=tmp_path / "no")
    with pytest.raises(InputDataError, match=r"--why is empty"):
        promote_model(one, lake=lake, report=None, by="A", why=" ", lost_max=0, confirmed_min=0)
    with pytest.raises(
        InputDataError, match=r"tower: no reviews; export a review task with 'facadelake review export-task'"
    ):
        make_training_set(
            [portfolio.get_building(BUILDING)], tmp_path / "set", lake=lake, label_format=TrainingLabelFormat.COCO,
            pictures=PictureMode.TILES, side_px=640, splits=(), terms=None,
        )  # fmt: skip
