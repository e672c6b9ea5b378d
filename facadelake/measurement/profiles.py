"""Profiles across a crack: the image straightened along the centreline, and its darkness relative to the wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates, median_filter

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, Float64N, Float64Nx2, Int64Array
from facadelake.measurement.trace import resample_evenly

STEP_PX = 0.25
_LINE_SMOOTHING_PX = 2.0  # sigma along the line, of its direction and of lateral shifts
_CENTRE_SMOOTHING_PX = 1.5  # sigma along the line, of the centres of profiles
_MAX_LATERAL_STEPS = 2  # steps across the line from one position along it to the next
_MIN_FLANK_PX = 3.0  # width of the wall beside the crack that gives the baseline
_FLANK_SHARE = 0.5  # of the core
_CENTRE_HALF_WIDTH_PX = 0.6
# A position is homogeneous where the roughness of its flanks is at most 1.5 times the 25th percentile of all.
_ROUGHNESS_QUANTILE, _MAX_ROUGHNESS_RATIO = 0.25, 1.5


@dataclass(frozen=True, kw_only=True, eq=False)
class StraightenedStrip:
    """Light (k, m) at positions (k,) along a line ``xy`` (k, 2) and at ``offset_px`` (m,) across it."""

    xy: Float64Nx2
    offset_px: Float64N
    light: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Profiles:
    """Profiles of a crack: darkness (k, m) at positions along the line and at ``offset_px`` (m,) from its centre.

    ``darkness``: 1 - light / light of the wall.
    ``equivalent_width_px`` (k,): integral of the darkness over the core; it equals width times contrast under any blur.
    ``background_width_px`` (k,): the same integral over the wall beside the crack, which is the noise of the texture.
    ``centre_px`` (k,): sub-pixel offset of the centre of each profile from the line.
    ``is_trough`` (k,): the centre is darker than both flanks, as that of a line is and that of an edge is not.
    ``is_homogeneous`` (k,): the wall beside has little texture; not where a joint crosses the crack.
    ``centre_sigma_px``: standard deviation of the centres, which blurs a mean of profiles.
    """

    offset_px: Float64N
    darkness: Float64Array
    equivalent_width_px: Float64N
    background_width_px: Float64N
    centre_px: Float64N
    is_trough: BoolArray
    is_homogeneous: BoolArray
    centre_sigma_px: float


def straighten(light: Float32Array, xy: Float64Nx2, half_width_px: float) -> StraightenedStrip:
    """Resample the image (h, w) along a line (k, 2: column, row) by cubic splines; its border is extended."""
    normal = _compute_normals(xy)
    count = int(np.ceil(half_width_px / STEP_PX))
    offset = np.asarray(np.arange(-count, count + 1) * STEP_PX, dtype=np.float64)
    x, y = (xy[:, axis, None] + normal[:, axis, None] * offset for axis in (0, 1))
    sampled = map_coordinates(light, [y, x], order=3, mode="nearest", output=np.float64)
    return StraightenedStrip(xy=xy, offset_px=offset, light=sampled)


def snap_to_darkest_path(light: Float32Array, xy: Float64Nx2, width_px: float, reach_px: float) -> Float64Nx2:
    """Shift a line laterally onto the darkest smooth path beside it, by dynamic programming.

    Args:
        light: linear light (h, w) of the image.
        xy: points (k, 2: column, row) of the line, about 1 px apart.
        width_px: width of the line; the straightened image is smoothed accordingly.
        reach_px: largest lateral shift.

    Returns:
        Points (n, 2: column, row) of the shifted line, about 1 px apart.
    """
    strip = straighten(light, xy, reach_px)
    darkness = -gaussian_filter(strip.light, (1.0, max(width_px / 2.5, 0.8) / STEP_PX), mode="nearest")
    shift_px = strip.offset_px[_find_best_path(darkness)]
    return resample_evenly(shift_across(xy, gaussian_filter1d(shift_px, _LINE_SMOOTHING_PX, mode="nearest")))


def shift_across(xy: Float64Nx2, shift_px: Float64N) -> Float64Nx2:
    """The line (k, 2) with each point shifted across it by ``shift_px`` (k,), smoothed with a sigma of 1 px."""
    return np.asarray(gaussian_filter1d(xy + shift_px[:, None] * _compute_normals(xy), 1.0, axis=0, mode="nearest"))


def _compute_normals(xy: Float64Nx2) -> Float64Nx2:
    """Unit normals (k, 2) of a line (k, 2), to its right in image coordinates (rows downwards)."""
    tangent = gaussian_filter1d(np.gradient(xy, axis=0), _LINE_SMOOTHING_PX, axis=0, mode="nearest")
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    return np.column_stack([-tangent[:, 1], tangent[:, 0]])


def _find_best_path(gain: Float64Array) -> Int64Array:
    """Columns (k,) of the path through ``gain`` (k, m) with the largest sum, at limited lateral steps per row."""
    rows, columns = gain.shape
    total, previous = gain[0].copy(), np.zeros((rows, columns), dtype=np.int64)
    for row in range(1, rows):
        options = np.full((2 * _MAX_LATERAL_STEPS + 1, columns), -np.inf)
        for number, step in enumerate(range(-_MAX_LATERAL_STEPS, _MAX_LATERAL_STEPS + 1)):
            source = slice(max(0, step), columns + min(0, step))
            target = slice(max(0, -step), columns + min(0, -step))
            options[number, target] = total[source]
        best = options.argmax(axis=0)
        previous[row] = np.arange(columns) + best - _MAX_LATERAL_STEPS
        total = options[best, np.arange(columns)] + gain[row]
    path = np.empty(rows, dtype=np.int64)
    path[-1] = int(total.argmax())
    for row in range(rows - 1, 0, -1):
        path[row - 1] = previous[row, path[row]]
    return path


def compute_half_width(core_px: float) -> float:
    """Half width in px that a strip needs for profiles with a core of ``core_px`` (half the width, with its blur)."""
    return 3 * core_px + 2 * _compute_flank_width(core_px) + 1.0


def extract_profiles(strip: StraightenedStrip, core_px: float, blur_px: float) -> Profiles:
    """Profiles of a straightened strip, each centred on its darkness within ``core_px`` to either side.

    ``blur_px`` is the standard deviation of the point spread of the photograph.
    """
    offset = strip.offset_px
    darkness = _compute_darkness(strip.light, offset, core_px)
    centre, centre_sigma = _locate_centres(darkness, offset, core_px, blur_px)
    light = np.array([np.interp(offset + shift, offset, row) for shift, row in zip(centre, strip.light, strict=True)])
    darkness = _compute_darkness(light, offset, core_px)
    core = np.abs(offset) <= core_px
    background = []
    for sign in (-1, 1):
        aside = sign * (2 * core_px + _compute_flank_width(core_px))
        local = _compute_darkness(light, offset - aside, core_px)
        background.append(local[:, np.abs(offset - aside) <= core_px].sum(axis=1) * STEP_PX)
    at_centre = light[:, np.abs(offset) < _CENTRE_HALF_WIDTH_PX].mean(axis=1)
    return Profiles(
        offset_px=offset,
        darkness=darkness,
        equivalent_width_px=darkness[:, core].sum(axis=1) * STEP_PX,
        background_width_px=np.mean(background, axis=0),
        centre_px=centre,
        is_trough=at_centre < np.minimum(*_estimate_baseline(light, offset, core_px)),
        is_homogeneous=_find_homogeneous(darkness, offset, core_px),
        centre_sigma_px=centre_sigma,
    )


def _compute_flank_width(core_px: float) -> float:
    return max(_MIN_FLANK_PX, _FLANK_SHARE * core_px)


def _compute_darkness(light: Float64Array, offset_px: Float64N, core_px: float) -> Float64Array:
    """1 - light / baseline, where the baseline is interpolated linearly between the flanks."""
    left, right = _estimate_baseline(light, offset_px, core_px)
    flank_px = core_px + _compute_flank_width(core_px) / 2
    share = np.clip((offset_px + flank_px) / (2 * flank_px), 0.0, 1.0)
    baseline = left[:, None] * (1 - share) + right[:, None] * share
    return np.asarray(1 - light / np.maximum(baseline, 1e-4))


def _estimate_baseline(light: Float64Array, offset_px: Float64N, core_px: float) -> tuple[Float64N, Float64N]:
    """Light (k,) of the wall on the left and the right flank; where a strip ends before one, that of the other."""
    outer_px = core_px + _compute_flank_width(core_px)
    levels = []
    for sign in (-1, 1):
        flank = (sign * offset_px > core_px) & (sign * offset_px <= outer_px)
        level = np.median(light[:, flank], axis=1) if flank.any() else np.full(len(light), np.nan)
        levels.append(median_filter(level, size=5, mode="nearest"))
    left, right = levels
    return np.where(np.isnan(left), right, left), np.where(np.isnan(right), left, right)


def _locate_centres(
    darkness: Float64Array, offset_px: Float64N, core_px: float, blur_px: float
) -> tuple[Float64N, float]:
    """Sub-pixel centres (k,) of the profiles by matched filtering with a blurred slit, and their standard deviation.

    The filter response is smoothed along the line. The standard deviation follows from the difference between the
    centres of even and odd positions.
    """
    width = max(core_px - 2.5 * blur_px, 0.5)
    reach_px = core_px + 1.0
    inside = np.abs(offset_px) <= reach_px
    template = np.exp(-0.5 * (np.maximum(np.abs(offset_px[inside]) - width / 2, 0) / (blur_px + width / 3)) ** 2)
    inner = np.where(inside, darkness, 0.0)
    response = np.array([np.convolve(row, template - template.mean(), mode="same") for row in inner])

    def locate(rows: Float64Array) -> Float64N:
        smooth = gaussian_filter1d(rows, _CENTRE_SMOOTHING_PX, axis=0, mode="nearest")
        smooth[:, np.abs(offset_px) > max(core_px / 2, 1.0)] = -np.inf
        return _locate_peaks(smooth, offset_px)

    positions = np.arange(len(darkness))
    odd = positions % 2 == 1
    if odd.sum() < 4:
        return locate(response), 0.3
    halves = [np.interp(positions, np.flatnonzero(half), locate(response[half])) for half in (odd, ~odd)]
    difference = 1.4826 * float(np.median(np.abs(halves[0] - halves[1])))
    return locate(response), difference / 2


def _locate_peaks(rows: Float64Array, offset_px: Float64N) -> Float64N:
    """Offset (k,) of the largest value of each row (k, m), sub-pixel by a parabola through three samples."""
    best = np.clip(rows.argmax(axis=1), 1, rows.shape[1] - 2)
    number = np.arange(len(rows))
    before, at, after = (rows[number, best + step] for step in (-1, 0, 1))
    curvature = before - 2 * at + after
    with np.errstate(invalid="ignore", divide="ignore"):
        vertex = np.where(np.isfinite(curvature) & (curvature < 0), (before - after) / (2 * curvature), 0.0)
    return np.asarray(offset_px[best] + np.clip(vertex, -0.5, 0.5) * STEP_PX)


def _find_homogeneous(darkness: Float64Array, offset_px: Float64N, core_px: float) -> BoolArray:
    """Positions (k,) whose flanks have a roughness close to that of the smoothest quarter."""
    outer_px = core_px + _compute_flank_width(core_px)
    flank = (np.abs(offset_px) > core_px) & (np.abs(offset_px) <= outer_px)
    roughness = gaussian_filter1d(np.abs(darkness[:, flank]).mean(axis=1), 1.0, mode="nearest")
    reference = np.sort(roughness)[int(_ROUGHNESS_QUANTILE * (len(roughness) - 1))]
    return np.asarray(roughness <= _MAX_ROUGHNESS_RATIO * reference)
