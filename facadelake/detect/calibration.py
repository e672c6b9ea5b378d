"""Scores that mean probabilities: a line on the logit (Platt 1999), as a model card declares it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facadelake.detect.card import ScoreCalibration

_NEAREST = 1e-7  # to 0 and 1; float32 scores cannot tell more


def calibrated(scores: NDArray[np.float32], by: ScoreCalibration) -> NDArray[np.float64]:
    """Probabilities of a model's scores: ``logit(p) = slope * logit(score) + intercept``."""
    exact = np.clip(scores.astype(np.float64), 0.0, 1.0)
    if by == ScoreCalibration():
        return exact
    return 1 / (1 + np.exp(-(by.slope * _logit(exact) + by.intercept)))


def score_for(probability: float, by: ScoreCalibration) -> float:
    """The model's score that means ``probability``; 0 and 1 stay what they are."""
    if by == ScoreCalibration() or probability <= 0 or probability >= 1:
        return probability
    logit = float(_logit(np.array([probability]))[0])
    return float(1 / (1 + np.exp(-(logit - by.intercept) / by.slope)))


def _logit(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    inside = np.clip(probability, _NEAREST, 1 - _NEAREST)
    logit: NDArray[np.float64] = np.log(inside) - np.log1p(-inside)
    return logit
