"""The default detector on real photographs of sites that it never learned from, at a size that a test can afford."""

from __future__ import annotations

from pathlib import Path

import pytest

from facadelake.detection.crosswalk import build_crosswalk
from facadelake.detection.model_registry import MODELS_FOLDER, SHIPPED_MODEL
from facadelake.evaluation.detectors.figures import evaluate_boxes
from facadelake.evaluation.detectors.labels.labels import LabelledSet, open_sound_photographs
from facadelake.evaluation.detectors.labels.open import open_labels
from facadelake.evaluation.detectors.labels.sites import assign_sites
from facadelake.evaluation.detectors.predictions import collect_predictions
from facadelake.evaluation.detectors.sources import OnnxPredictionSource

pytestmark = pytest.mark.realdata

SITES = Path(__file__).resolve().parents[2] / "training" / "data" / "sites.yaml"
CROSSWALK = build_crosswalk({})


@pytest.fixture(scope="module")
def source() -> OnnxPredictionSource:
    return OnnxPredictionSource(MODELS_FOLDER / SHIPPED_MODEL)


def folder_of(shared_data: Path, name: str) -> Path:
    folder = shared_data / "defects" / name
    if not folder.is_dir():
        pytest.skip(f"no set {folder}")
    return folder


def test_cracks_on_walls_of_validation_sites(shared_data: Path, source: OnnxPredictionSource) -> None:
    labelled = assign_sites(open_labels(folder_of(shared_data, "crack_boxes_640"), CROSSWALK), SITES, "val")
    figures = evaluate_boxes(
        source, labelled, collect_predictions(source, labelled.images, CROSSWALK), split="val"
    ).figures
    (crack,) = figures.classes
    assert crack.truths == 67 and figures.data.sites == 14
    assert crack.ap50 is not None and crack.ap50 > 0.8  # the goal
    assert crack.operating.precision is not None and crack.operating.precision > 0.7


def test_facades_without_defects_stay_quiet(shared_data: Path, source: OnnxPredictionSource) -> None:
    sound = assign_sites(open_sound_photographs(folder_of(shared_data, "facade_negatives")), SITES, "val")
    found = collect_predictions(source, sound.images, CROSSWALK)
    nothing = LabelledSet(name="", label_format="", images=())
    figures = evaluate_boxes(
        source,
        nothing,
        collect_predictions(source, (), CROSSWALK),
        split="val",
        negatives=sound,
        collected_negatives=found,
    ).figures
    assert figures.negatives is not None
    every = figures.negatives.rates[0]
    # Held-out facades of that set show 48 to 502 m2 each: one a photograph is far below the goal of 1 per 10 m2.
    assert every.photographs == 6 and every.count <= 6
