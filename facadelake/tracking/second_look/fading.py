"""What of a defect's look has gone between two campaigns: the largest connected part that became lighter.

Defects are darker than the wall round them: cracks and spalls are in shadow, damp is dark. Where one is gone, the wall
is lighter there; where it has grown, darker. A difference is judged against what it is around the defect, where
nothing changed: a constant, and a share of the steepness of the picture, which is what misalignment leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import BoolArray

_CHANGED_SIGMAS = 4.0
_NOISE_FLOOR = 0.004  # of a difference, in log grey values
_STEEPNESS_BINS = 8
_GAIN_LIMITS = 0.5, 2.0
_FIT_ROUNDS = 6
_LIGHT_DEFECT_MIN = 0.1  # log grey values above the wall's, from which a defect is a light one: fresh concrete, salts
Detail = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Fading:
    """Change towards the wall's grey value, and away from it, within a defect's extents.

    ``extent``, ``opposite_extent``: diagonal of the largest connected change, over the defect's; ``sigmas``,
    ``opposite_sigmas``: mean of the largest fiftieth of the changes, in proportion to their noise. ``share``: of the
    defect's extents that the largest connected change towards the wall covers.
    """

    extent: float
    sigmas: float
    share: float
    opposite_extent: float
    opposite_sigmas: float


def measure_fading(seen: Detail, other: Detail, defect: BoolArray, around: BoolArray) -> Fading:
    """Measure what has gone of a defect.

    Args:
        seen: logarithms (h, w) of the grey values where it was detected, their median around the defect taken off.
        other: those of the other campaign, aligned.
        defect: cells (h, w) within the defect's extents.
        around: cells beyond them.
    """
    gain = np.float32(fit_gain(seen[around] - seen[around].mean(), other[around] - other[around].mean()))
    difference = _remove_shading(other - gain * seen, around)
    relative = difference / _estimate_noise(difference, gain * seen, other, around)
    level = _remove_shading(seen, around)[defect].mean()
    if level > _LIGHT_DEFECT_MIN:
        relative = -relative
    extent, share = _measure_largest(relative > _CHANGED_SIGMAS, defect)
    opposite_extent, _ = _measure_largest(relative < -_CHANGED_SIGMAS, defect)
    return Fading(
        extent=extent,
        sigmas=_average_top(relative[defect]),
        share=share,
        opposite_extent=opposite_extent,
        opposite_sigmas=_average_top(-relative[defect]),
    )


def fit_gain(first: Detail, second: Detail) -> float:
    """Factor of contrast between two campaigns, from the surroundings."""
    energy = float(first @ first)
    gain = float(first @ second) / energy if energy > 1e-9 else 1.0
    return float(np.clip(gain, *_GAIN_LIMITS))


def _remove_shading(values: Detail, around: BoolArray) -> Detail:
    """The values without a quadratic surface, fitted robustly around the defect: sun and shadow of the day."""
    rows, columns = (np.linspace(-0.5, 0.5, count) for count in values.shape)
    y, x = (axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij"))
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    inside, observed = around.ravel(), values.ravel().astype(np.float64)
    weight = inside.astype(np.float64)
    residual = observed
    for _ in range(_FIT_ROUNDS):
        fitted = np.linalg.lstsq(design[inside] * weight[inside, None], observed[inside] * weight[inside], rcond=None)
        residual = observed - design @ fitted[0]
        spread = 1.4826 * float(np.median(np.abs(residual[inside]))) + 1e-6
        weight = 1 / np.maximum(1.0, np.abs(residual) / (2 * spread))
    flat = residual.reshape(values.shape).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(flat, (0, 0), 0.8), dtype=np.float32)


def _measure_largest(changed: BoolArray, defect: BoolArray) -> tuple[float, float]:
    """The largest connected change at the defect: its diagonal over the defect's, and its share of the cells."""
    joined = cv2.morphologyEx((changed & defect).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, _, stats, _ = cv2.connectedComponentsWithStats(joined, connectivity=8)
    if count < 2:
        return 0.0, 0.0
    size = np.hypot(stats[1:, cv2.CC_STAT_WIDTH], stats[1:, cv2.CC_STAT_HEIGHT])
    largest = int(size.argmax())
    diagonal = np.hypot(np.count_nonzero(defect.any(axis=1)), np.count_nonzero(defect.any(axis=0)))
    cells = float(stats[1 + largest, cv2.CC_STAT_AREA])
    return float(size[largest] / diagonal), cells / float(np.count_nonzero(defect))


def _estimate_noise(difference: Detail, seen: Detail, other: Detail, around: BoolArray) -> Detail:
    """One sigma (h, w) of a difference where nothing changed: a constant, and a share of the pictures' steepness.

    Of the two pictures the less steep one counts: an edge that only one of them has is no misalignment.
    """
    steepness = np.minimum(_measure_steepness(seen), _measure_steepness(other))
    size, steep = np.abs(difference[around]), steepness[around]
    if len(size) < 50 * _STEEPNESS_BINS:
        constant = max(_NOISE_FLOOR, 1.4826 * float(np.median(size)) if len(size) else 0.05)
        return np.full(difference.shape, constant, dtype=np.float32)
    order = np.array_split(np.argsort(steep), _STEEPNESS_BINS)
    sigma = np.array([1.4826 * np.median(size[rows]) for rows in order])
    centre = np.array([steep[rows].mean() for rows in order])
    share = max(0.05, float(np.polyfit(centre, sigma, 1)[0]))
    constant = max(_NOISE_FLOOR, float(np.median(sigma - share * centre)))
    noise: Detail = np.hypot(constant, share * steepness).astype(np.float32)
    return noise


def _measure_steepness(picture: Detail) -> Detail:
    gradient = np.hypot(cv2.Sobel(picture, -1, 1, 0, ksize=3), cv2.Sobel(picture, -1, 0, 1, ksize=3)) / 8
    return np.asarray(cv2.dilate(gradient.astype(np.float32), np.ones((3, 3), np.uint8)), dtype=np.float32)


def _average_top(values: Detail) -> float:
    """Mean of the largest fiftieth of the values."""
    count = max(8, len(values) // 50)
    return float(np.sort(values)[-count:].mean())
