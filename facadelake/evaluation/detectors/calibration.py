"""Calibration of scores: whether a score is the probability of a hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facadelake.evaluation.detectors.average_precision import PredictionMatches

BINS = 10


@dataclass(frozen=True, kw_only=True)
class CalibrationBin:
    """Predictions with a score from ``low`` to ``high``: their number, mean score and precision."""

    low: float
    high: float
    count: int
    mean_score: float
    precision: float


@dataclass(frozen=True, kw_only=True)
class CalibrationFigures:
    """Calibration at an IoU of 0.5 on the evaluated photographs; where defects are rarer, precision is lower.

    ``ece``: expected calibration error (Guo et al., On Calibration of Modern Neural Networks, ICML 2017): mean absolute
    difference of score and precision over ``BINS`` equal bins, weighted by count, of all predictions. ``*_shown``: of
    the predictions from the threshold up, whose mean score is ``expected_precision``. None without predictions.
    """

    count: int
    ece: float | None
    count_shown: int
    ece_shown: float | None
    expected_precision: float | None
    precision_shown: float | None
    bins: tuple[CalibrationBin, ...]


def compute_calibration(matches: PredictionMatches, threshold: float) -> CalibrationFigures:
    """Calibration of the scores of one class; ``threshold``: the least score of the predictions that are shown."""
    counted = ~matches.ignored[0]
    score, hit = matches.score[counted], matches.hit[0][counted]
    shown = score >= threshold
    return CalibrationFigures(
        count=len(score),
        ece=_compute_calibration_error(_collect_bins(score, hit)),
        count_shown=int(shown.sum()),
        ece_shown=_compute_calibration_error(_collect_bins(score[shown], hit[shown])),
        expected_precision=float(score[shown].mean()) if shown.any() else None,
        precision_shown=float(hit[shown].mean()) if shown.any() else None,
        bins=_collect_bins(score, hit),
    )


def _collect_bins(score: np.ndarray, hit: np.ndarray) -> tuple[CalibrationBin, ...]:
    index = np.minimum((score * BINS).astype(np.int64), BINS - 1)
    return tuple(
        CalibrationBin(
            low=i / BINS,
            high=(i + 1) / BINS,
            count=int((index == i).sum()),
            mean_score=float(score[index == i].mean()),
            precision=float(hit[index == i].mean()),
        )
        for i in range(BINS)
        if (index == i).any()
    )


def _compute_calibration_error(bins: tuple[CalibrationBin, ...]) -> float | None:
    total = sum(one.count for one in bins)
    return sum(one.count * abs(one.mean_score - one.precision) for one in bins) / total if total else None
