"""Drawn histories: perfect detections and looks give perfect figures, and looks that err give what they should."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.synthetic_history import HistoryRecipe, LookRates, draw_history
from benchmarks.synthetic_tracking import track_synthetic
from facadelake.evaluation.history import compute_history_figures

PERFECT = LookRates(there_same=1.0, there_gone=0.0, changed_same=1.0, changed_gone=0.0, gone_gone=1.0, gone_same=0.0)
RECIPE = HistoryRecipe(
    defects=25, campaigns=4, recall=1.0, false_share=0.0, box_sigma=0.005, other_class_share=0.0, growth=1.4,
    looks=PERFECT,
)  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_perfect_detections_and_looks(seed: int) -> None:
    found = compute_history_figures(track_synthetic(draw_history(RECIPE, seed), seed))
    assert found.identity.idf1 == found.identity_of_all.idf1 == 1.0
    assert found.states.right_share == 1.0
    assert found.states.false_repaired == 0 < found.states.repaired
    assert found.changes.found_share == 1.0


@pytest.mark.parametrize("seed", range(3))
def test_looks_recover_what_the_detector_missed(seed: int) -> None:
    found = compute_history_figures(track_synthetic(draw_history(replace(RECIPE, recall=0.7), seed), seed))
    assert found.identity.idf1 == 1.0
    assert found.states.recovered == found.states.missed > 0
    assert found.states.right_share == 1.0


def test_looks_that_err_make_false_repairs() -> None:
    blind = replace(
        RECIPE, recall=0.7, looks=replace(PERFECT, there_same=0.0, there_gone=1.0, changed_same=0.0, changed_gone=1.0)
    )
    found = compute_history_figures(track_synthetic(draw_history(blind, 0), 0))
    assert found.states.recovered == 0
    # Every miss between two detections is called repaired.
    assert found.states.false_repaired > 10
    share = found.states.false_repaired_share
    assert share is not None and share > 0.3


def test_a_history_is_the_same_for_one_seed() -> None:
    first, again, other = (draw_history(RECIPE, seed) for seed in (0, 0, 1))
    assert first.true_ids == again.true_ids != other.true_ids
    assert first.truth == again.truth
