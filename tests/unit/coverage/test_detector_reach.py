"""The smallest size that a detector finds with a probability of 90 %, from its recall by size."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import yaml
from pydantic import ValidationError

from facadelake.core.tables import table_from_rows
from facadelake.coverage import resolve_campaign_reach
from facadelake.coverage.detector_reach import find_size_px, resolve_reach
from facadelake.registry import Building, CocoDetectorSetting, RecallBySize

MODEL = Path(__file__).parents[3] / "data" / "detector" / "facadelake-nano.onnx"


@pytest.mark.parametrize(
    ("recall", "size_px"),
    [
        ([(3.0, 0.9)], 3.0),
        ([(1.0, 0.2), (3.0, 0.8), (5.0, 1.0)], 4.0),
        ([(1.0, 0.95), (2.0, 0.5), (3.0, 1.0)], 2.8),  # found by chance at 1 px: what is larger was not
        ([(2.0, 0.92), (4.0, 0.99)], 2.0),  # nothing is extrapolated
        ([(2.0, 0.3), (40.0, 0.85)], None),
        ([], None),
    ],
)
def test_size_found_with_90_percent(recall: list[tuple[float, float]], size_px: float | None) -> None:
    assert find_size_px(recall) == (None if size_px is None else pytest.approx(size_px, abs=1e-9))  # px


def test_an_undeclared_recall_is_unknown() -> None:
    reach = resolve_reach(None, frozenset({"a"}))
    assert (reach.crack_width_px, reach.patch_px) == (None, None)


def test_the_portfolio_declares_the_recall_of_imported_boxes() -> None:
    setting = CocoDetectorSetting.model_validate(
        {"kind": "coco", "file": "boxes.json", "recall_by_size": {"crack_width_px": [[2, 0.5], [4, 0.95]]}}
    )
    assert setting.recall_by_size == RecallBySize(crack_width_px=((2, 0.5), (4, 0.95)))
    assert setting.recall_by_size.patch_px == ()


@pytest.mark.parametrize("pairs", [[[4, 0.9], [2, 0.5]], [[2, 0.9], [2, 0.9]]])
def test_sizes_ascend(pairs: list[list[float]]) -> None:
    with pytest.raises(ValidationError, match=r"the sizes of patch_px are .*; list them in ascending order, each once"):
        RecallBySize.model_validate({"patch_px": pairs})


@pytest.mark.parametrize("pair", [[0, 0.9], [3, 1.2], [3, -0.1]])
def test_sizes_and_recalls_have_limits(pair: list[float]) -> None:
    with pytest.raises(ValidationError):
        RecallBySize.model_validate({"crack_width_px": [pair]})


def photographs() -> pa.Table:
    row = {"sha256": "0", "bytes": 1, "prior_source": "none", "prior_height_datum": "unknown"}
    return table_from_rows(
        "photos",
        [
            {"photo_id": "a.jpg", "photo_outcome": "accepted", **row},
            {"photo_id": "b.jpg", "photo_outcome": "unreadable", **row},
        ],
    )


def make_building(root: Path, detector: dict[str, Any]) -> Building:
    return Building.model_validate(
        {"id": "hall", "name": "Hall", "model": "hall.ifc", "photographs": f"{root}/{{campaign}}", "detector": detector}
    )


def test_a_model_searches_the_accepted_photographs(tmp_path: Path) -> None:
    building = make_building(tmp_path, {"kind": "onnx"})
    assert resolve_campaign_reach(building, "2026-04", None, photographs()).searched == {"a.jpg"}


def test_a_stricter_threshold_than_the_cards_makes_the_recall_unknown(tmp_path: Path) -> None:
    card = yaml.safe_load((MODEL.with_suffix(".card.yaml")).read_text())
    card["recall_by_size"] = {"crack_width_px": [[5, 0.95]]}
    (tmp_path / "own.card.yaml").write_text(yaml.safe_dump(card))
    setting = {"kind": "onnx", "model": str(MODEL), "card": str(tmp_path / "own.card.yaml")}
    reach = resolve_campaign_reach(make_building(tmp_path, setting), "2026-04", None, photographs())
    assert reach.crack_width_px == 5.0
    stricter = make_building(tmp_path, {**setting, "score_threshold": 0.9})
    assert resolve_campaign_reach(stricter, "2026-04", None, photographs()).crack_width_px is None


def write_boxes(path: Path, names: list[str]) -> Path:
    """A COCO file that lists photographs, of which the first one has a box."""
    images = [{"id": i, "file_name": name, "width": 100, "height": 80} for i, name in enumerate(names)]
    box = {"id": 1, "image_id": 0, "category_id": 1, "bbox": [10, 10, 20, 20]}
    content = {"images": images, "categories": [{"id": 1, "name": "crack"}], "annotations": [box]}
    path.write_text(json.dumps(content))
    return path


def test_a_listed_photograph_without_boxes_was_searched_and_another_was_not(tmp_path: Path) -> None:
    sized = {"image_width_px": 100, "image_height_px": 80}
    photos = table_from_rows(
        "photos", [{**row, **sized} for row in photographs().to_pylist()] + [
            {**photographs().to_pylist()[0], **sized, "photo_id": name} for name in ("c.jpg", "d.jpg")
        ],
    )  # fmt: skip
    file = write_boxes(tmp_path / "boxes.json", ["a.jpg", "b.jpg", "c.jpg", "strange.jpg"])
    building = make_building(tmp_path, {"kind": "coco", "file": str(file)})
    assert resolve_campaign_reach(building, "2026-04", None, photos).searched == {"a.jpg", "c.jpg"}


def test_the_declared_recall_is_of_the_portfolios_own_file(tmp_path: Path) -> None:
    own, other = (write_boxes(tmp_path / name, ["a.jpg"]) for name in ("own.json", "other.json"))
    detector = {
        "kind": "coco", "file": str(own), "alternatives": {"exact": str(own), "noisy": str(other)},
        "recall_by_size": {"crack_width_px": [[3, 0.9]]},
    }  # fmt: skip
    building = make_building(tmp_path, detector)
    sizes = {
        choice: resolve_campaign_reach(building, "2026-04", choice, photographs()).crack_width_px
        for choice in (None, "exact", "noisy", str(other))
    }
    assert sizes == {None: 3.0, "exact": 3.0, "noisy": None, str(other): None}
