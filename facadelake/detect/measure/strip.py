"""A photograph straightened along a line, and the line moved onto the darkest way through it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates

from facadelake.core.frames import Array
from facadelake.detect.measure.trace import evenly_spaced

STEP_PX = 0.25
_SMOOTH_PX = 2.0  # along the line
_MOST_TURN = 2  # steps across that the middle may move from one place along the line to the next


@dataclass(frozen=True, kw_only=True, eq=False)
class Strip:
    """Light (k, m) at places (k,) along a line ``xy`` (k, 2) and at ``across_px`` (m,) from it."""

    xy: Array
    across_px: Array
    light: Array


def straightened(light: NDArray[np.float32], xy: Array, half_width_px: float) -> Strip:
    """The picture (h, w) along a line (k, 2: column, row), sampled by cubic splines; beyond its rim the rim goes on."""
    normal = _normals(xy)
    count = int(np.ceil(half_width_px / STEP_PX))
    across = np.asarray(np.arange(-count, count + 1) * STEP_PX, dtype=np.float64)
    x, y = (xy[:, axis, None] + normal[:, axis, None] * across for axis in (0, 1))
    sampled = map_coordinates(light, [y, x], order=3, mode="nearest", output=np.float64)
    return Strip(xy=xy, across_px=across, light=sampled)


def onto_the_darkest(light: NDArray[np.float32], xy: Array, width_px: float, reach_px: float) -> Array:
    """The line (k, 2) moved across itself, by ``reach_px`` at most, onto the darkest smooth way beside it.

    Found by dynamic programming over the straightened picture, smoothed to the line's own ``width_px``.
    """
    strip = straightened(light, xy, reach_px)
    dark = -gaussian_filter(strip.light, (1.0, max(width_px / 2.5, 0.8) / STEP_PX), mode="nearest")
    shift = strip.across_px[_best_way(dark)]
    return evenly_spaced(moved_across(xy, gaussian_filter1d(shift, _SMOOTH_PX, mode="nearest")))


def moved_across(xy: Array, by_px: Array) -> Array:
    """The line (k, 2) with each point moved across it by ``by_px`` (k,), and smoothed over a pixel."""
    return np.asarray(gaussian_filter1d(xy + by_px[:, None] * _normals(xy), 1.0, axis=0, mode="nearest"))


def _normals(xy: Array) -> Array:
    """Unit vectors (k, 2) across a line (k, 2), on the side that is right of it where rows go down."""
    along = gaussian_filter1d(np.gradient(xy, axis=0), _SMOOTH_PX, axis=0, mode="nearest")
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return np.column_stack([-along[:, 1], along[:, 0]])


def _best_way(gain: Array) -> NDArray[np.int64]:
    """Columns (k,) of the way through ``gain`` (k, m) that gathers most, moving a few columns a row at most."""
    rows, columns = gain.shape
    total, came = gain[0].copy(), np.zeros((rows, columns), dtype=np.int64)
    for row in range(1, rows):
        options = np.full((2 * _MOST_TURN + 1, columns), -np.inf)
        for number, turn in enumerate(range(-_MOST_TURN, _MOST_TURN + 1)):
            source = slice(max(0, turn), columns + min(0, turn))
            target = slice(max(0, -turn), columns + min(0, -turn))
            options[number, target] = total[source]
        best = options.argmax(axis=0)
        came[row] = np.arange(columns) + best - _MOST_TURN
        total = options[best, np.arange(columns)] + gain[row]
    way = np.empty(rows, dtype=np.int64)
    way[-1] = int(total.argmax())
    for row in range(rows - 1, 0, -1):
        way[row - 1] = came[row, way[row]]
    return way
