"""A photograph straightened along a line, and what is dark across it: each place's light against the wall beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates, median_filter

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from facadelake.measurement.trace import resample_evenly

STEP_PX = 0.25
_SMOOTH_PX = 2.0  # along the line
_MAX_LATERAL_STEPS = 2  # steps across that the middle may move from one place along the line to the next


@dataclass(frozen=True, kw_only=True, eq=False)
class StraightenedStrip:
    """Light (k, m) at places (k,) along a line ``xy`` (k, 2) and at ``offset_px`` (m,) from it."""

    xy: Float64Array
    offset_px: Float64Array
    light: Float64Array


def straighten(light: Float32Array, xy: Float64Array, half_width_px: float) -> StraightenedStrip:
    """The picture (h, w) along a line (k, 2: column, row), sampled by cubic splines; beyond its rim the rim goes on."""
    normal = _compute_normals(xy)
    count = int(np.ceil(half_width_px / STEP_PX))
    across = np.asarray(np.arange(-count, count + 1) * STEP_PX, dtype=np.float64)
    x, y = (xy[:, axis, None] + normal[:, axis, None] * across for axis in (0, 1))
    sampled = map_coordinates(light, [y, x], order=3, mode="nearest", output=np.float64)
    return StraightenedStrip(xy=xy, offset_px=across, light=sampled)


def snap_to_darkest_path(light: Float32Array, xy: Float64Array, width_px: float, reach_px: float) -> Float64Array:
    """The line (k, 2) moved across itself, by ``reach_px`` at most, onto the darkest smooth way beside it.

    Found by dynamic programming over the straightened picture, smoothed to the line's own ``width_px``.
    """
    strip = straighten(light, xy, reach_px)
    dark = -gaussian_filter(strip.light, (1.0, max(width_px / 2.5, 0.8) / STEP_PX), mode="nearest")
    shift = strip.offset_px[_find_best_path(dark)]
    return resample_evenly(shift_across(xy, gaussian_filter1d(shift, _SMOOTH_PX, mode="nearest")))


def shift_across(xy: Float64Array, by_px: Float64Array) -> Float64Array:
    """The line (k, 2) with each point moved across it by ``by_px`` (k,), and smoothed over a pixel."""
    return np.asarray(gaussian_filter1d(xy + by_px[:, None] * _compute_normals(xy), 1.0, axis=0, mode="nearest"))


def _compute_normals(xy: Float64Array) -> Float64Array:
    """Unit vectors (k, 2) across a line (k, 2), on the side that is right of it where rows go down."""
    along = gaussian_filter1d(np.gradient(xy, axis=0), _SMOOTH_PX, axis=0, mode="nearest")
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return np.column_stack([-along[:, 1], along[:, 0]])


def _find_best_path(gain: Float64Array) -> Int64Array:
    """Columns (k,) of the way through ``gain`` (k, m) that gathers most, moving a few columns a row at most."""
    rows, columns = gain.shape
    total, came = gain[0].copy(), np.zeros((rows, columns), dtype=np.int64)
    for row in range(1, rows):
        options = np.full((2 * _MAX_LATERAL_STEPS + 1, columns), -np.inf)
        for number, turn in enumerate(range(-_MAX_LATERAL_STEPS, _MAX_LATERAL_STEPS + 1)):
            source = slice(max(0, turn), columns + min(0, turn))
            target = slice(max(0, -turn), columns + min(0, -turn))
            options[number, target] = total[source]
        best = options.argmax(axis=0)
        came[row] = np.arange(columns) + best - _MAX_LATERAL_STEPS
        total = options[best, np.arange(columns)] + gain[row]
    way = np.empty(rows, dtype=np.int64)
    way[-1] = int(total.argmax())
    for row in range(rows - 1, 0, -1):
        way[row - 1] = came[row, way[row]]
    return way


_MIN_FLANK_PX = 3.0  # of wall beside the crack, at least
_FLANK_SHARE = 0.5  # of the crack's width
_CENTRE_HALF_WIDTH_PX = 0.6
_SMOOTH_PX = 1.5  # of the middle, along the line
_ROUGHNESS_QUANTILE, _MAX_ROUGHNESS_RATIO = (
    0.25,
    1.5,
)  # places are even that are at most 1.5 times rougher than the 25th in a hundred


@dataclass(frozen=True, kw_only=True, eq=False)
class Profiles:
    """Darkness (k, m) at places along a line and ``offset_px`` (m,) from its middle: 1 - light over the wall's light.

    ``equivalent_width_px`` (k,): the darkness integrated across, which blur does not change: width times contrast.
    ``background_width_px`` (k,): the same over a piece of wall as wide, which shows what the wall's texture adds.
    ``centre_px`` (k,): how far each was moved. ``is_trough`` (k,): places whose middle is darker than either flank, as a
    line's is and an edge's is not. ``is_homogeneous`` (k,): places where the wall beside is as even as it is anywhere, so not
    where a joint crosses.
    ``centre_sigma_px``: one sigma of the middles, which blurs a mean of profiles.
    """

    offset_px: Float64Array
    darkness: Float64Array
    equivalent_width_px: Float64Array
    background_width_px: Float64Array
    centre_px: Float64Array
    is_trough: BoolArray
    is_homogeneous: BoolArray
    centre_sigma_px: float


def compute_half_width(core_px: float) -> float:
    """How far across a strip must reach for profiles of a core (half a width, with its blur) of ``core_px``."""
    return 3 * core_px + 2 * _compute_flank_width(core_px) + 1.0


def extract_profiles(strip: StraightenedStrip, core_px: float, blur_px: float) -> Profiles:
    """Profiles of a straightened strip, each moved so that its darkness, ``core_px`` to either side, is about 0."""
    across = strip.offset_px
    dark = _compute_darkness(strip.light, across, core_px)
    middle, jitter = _locate_centres(dark, across, core_px, blur_px)
    moved = np.array([np.interp(across + by, across, row) for by, row in zip(middle, strip.light, strict=True)])
    dark = _compute_darkness(moved, across, core_px)
    core = np.abs(across) <= core_px
    aside = []
    for sign in (-1, 1):
        centre = sign * (2 * core_px + _compute_flank_width(core_px))
        local = _compute_darkness(moved, across - centre, core_px)
        aside.append(local[:, np.abs(across - centre) <= core_px].sum(axis=1) * STEP_PX)
    return Profiles(
        offset_px=across,
        darkness=dark,
        equivalent_width_px=dark[:, core].sum(axis=1) * STEP_PX,
        background_width_px=np.mean(aside, axis=0),
        centre_px=middle,
        is_trough=moved[:, np.abs(across) < _CENTRE_HALF_WIDTH_PX].mean(axis=1)
        < np.minimum(*_estimate_baseline(moved, across, core_px)),
        is_homogeneous=_find_homogeneous(dark, across, core_px),
        centre_sigma_px=jitter,
    )


def _compute_flank_width(core_px: float) -> float:
    return max(_MIN_FLANK_PX, _FLANK_SHARE * core_px)


def _compute_darkness(light: Float64Array, across_px: Float64Array, core_px: float) -> Float64Array:
    """1 - light over the wall's, whose light is that of both flanks, straight across between them."""
    levels = _estimate_baseline(light, across_px, core_px)
    place = core_px + _compute_flank_width(core_px) / 2
    share = np.clip((across_px + place) / (2 * place), 0.0, 1.0)
    wall = levels[0][:, None] * (1 - share) + levels[1][:, None] * share
    return np.asarray(1 - light / np.maximum(wall, 1e-4))


def _estimate_baseline(
    light: Float64Array, across_px: Float64Array, core_px: float
) -> tuple[Float64Array, Float64Array]:
    """Light (k,) of the wall on either side; where a strip ends before it, the other side's."""
    outer = core_px + _compute_flank_width(core_px)
    levels = []
    for sign in (-1, 1):
        flank = (sign * across_px > core_px) & (sign * across_px <= outer)
        level = np.median(light[:, flank], axis=1) if flank.any() else np.full(len(light), np.nan)
        levels.append(median_filter(level, size=5, mode="nearest"))
    left, right = levels
    return np.where(np.isnan(left), right, left), np.where(np.isnan(right), left, right)


def _locate_centres(
    dark: Float64Array, across_px: Float64Array, core_px: float, blur_px: float
) -> tuple[Float64Array, float]:
    """Middle (k,) of each profile, where a bar as wide as the crack fits best, and one sigma of them.

    They are smoothed along the line; how far the middles of even and odd places are apart tells their sigma.
    """
    wide = max(core_px - 2.5 * blur_px, 0.5)  # half the crack
    reach = core_px + 1.0
    shape = np.exp(
        -0.5 * (np.maximum(np.abs(across_px[np.abs(across_px) <= reach]) - wide / 2, 0) / (blur_px + wide / 3)) ** 2
    )
    inner = np.where(np.abs(across_px) <= reach, dark, 0.0)
    fit = np.array([np.convolve(row, shape - shape.mean(), mode="same") for row in inner])

    def found(rows: Float64Array) -> Float64Array:
        smooth = gaussian_filter1d(rows, _SMOOTH_PX, axis=0, mode="nearest")
        smooth[:, np.abs(across_px) > max(core_px / 2, 1.0)] = -np.inf
        return _locate_peaks(smooth, across_px)

    odd = np.arange(len(dark)) % 2 == 1
    if odd.sum() < 4:
        return found(fit), 0.3
    halves = [np.interp(np.arange(len(dark)), np.flatnonzero(half), found(fit[half])) for half in (odd, ~odd)]
    apart = 1.4826 * float(np.median(np.abs(halves[0] - halves[1])))
    return found(fit), apart / 2


def _locate_peaks(rows: Float64Array, across_px: Float64Array) -> Float64Array:
    """Place (k,) of the largest value of each row (k, m), to a fraction of a step by a parabola."""
    best = np.clip(rows.argmax(axis=1), 1, rows.shape[1] - 2)
    number = np.arange(len(rows))
    before, here, after = (rows[number, best + by] for by in (-1, 0, 1))
    bend = before - 2 * here + after
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(np.isfinite(bend) & (bend < 0), (before - after) / (2 * bend), 0.0)
    return np.asarray(across_px[best] + np.clip(part, -0.5, 0.5) * STEP_PX)


def _find_homogeneous(dark: Float64Array, across_px: Float64Array, core_px: float) -> BoolArray:
    """Places (k,) whose flanks are not much less even than those of most."""
    outer = core_px + _compute_flank_width(core_px)
    flank = (np.abs(across_px) > core_px) & (np.abs(across_px) <= outer)
    rough = gaussian_filter1d(np.abs(dark[:, flank]).mean(axis=1), 1.0, mode="nearest")
    usual = np.sort(rough)[int(_ROUGHNESS_QUANTILE * (len(rough) - 1))]
    return np.asarray(rough <= _MAX_ROUGHNESS_RATIO * usual)
