"""What is dark across a line: each place's light against the wall beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter

from facadelake.core.frames import Array
from facadelake.detect.measure.strip import STEP_PX, Strip

_FLANK_PX = 3.0  # of wall beside the crack, at least
_FLANK_SHARE = 0.5  # of the crack's width
_MIDDLE_PX = 0.6
_SMOOTH_PX = 1.5  # of the middle, along the line
_EVEN_SHARE, _ROUGHER = 0.25, 1.5  # places are even that are at most 1.5 times rougher than the 25th in a hundred


@dataclass(frozen=True, kw_only=True, eq=False)
class Profiles:
    """Darkness (k, m) at places along a line and ``across_px`` (m,) from its middle: 1 - light over the wall's light.

    ``area_px`` (k,): the darkness integrated across, which blur does not change: width times contrast.
    ``beside_px`` (k,): the same over a piece of wall as wide, which shows what the wall's texture adds.
    ``middle_px`` (k,): how far each was moved. ``darker`` (k,): places whose middle is darker than either flank, as a
    line's is and an edge's is not. ``even`` (k,): places where the wall beside is as even as it is anywhere, so not
    where a joint crosses.
    ``jitter_px``: one sigma of the middles, which blurs a mean of profiles.
    """

    across_px: Array
    darkness: Array
    area_px: Array
    beside_px: Array
    middle_px: Array
    darker: NDArray[np.bool_]
    even: NDArray[np.bool_]
    jitter_px: float


def half_width_wanted(core_px: float) -> float:
    """How far across a strip must reach for profiles of a core (half a width, with its blur) of ``core_px``."""
    return 3 * core_px + 2 * _flank(core_px) + 1.0


def profiles_of(strip: Strip, core_px: float, blur_px: float) -> Profiles:
    """Profiles of a straightened strip, each moved so that its darkness, ``core_px`` to either side, is about 0."""
    across = strip.across_px
    dark = _darkness(strip.light, across, core_px)
    middle, jitter = _middles(dark, across, core_px, blur_px)
    moved = np.array([np.interp(across + by, across, row) for by, row in zip(middle, strip.light, strict=True)])
    dark = _darkness(moved, across, core_px)
    core = np.abs(across) <= core_px
    aside = []
    for sign in (-1, 1):
        centre = sign * (2 * core_px + _flank(core_px))
        local = _darkness(moved, across - centre, core_px)
        aside.append(local[:, np.abs(across - centre) <= core_px].sum(axis=1) * STEP_PX)
    return Profiles(
        across_px=across,
        darkness=dark,
        area_px=dark[:, core].sum(axis=1) * STEP_PX,
        beside_px=np.mean(aside, axis=0),
        middle_px=middle,
        darker=moved[:, np.abs(across) < _MIDDLE_PX].mean(axis=1) < np.minimum(*_flanks(moved, across, core_px)),
        even=_even(dark, across, core_px),
        jitter_px=jitter,
    )


def _flank(core_px: float) -> float:
    return max(_FLANK_PX, _FLANK_SHARE * core_px)


def _darkness(light: Array, across_px: Array, core_px: float) -> Array:
    """1 - light over the wall's, whose light is that of both flanks, straight across between them."""
    levels = _flanks(light, across_px, core_px)
    place = core_px + _flank(core_px) / 2
    share = np.clip((across_px + place) / (2 * place), 0.0, 1.0)
    wall = levels[0][:, None] * (1 - share) + levels[1][:, None] * share
    return np.asarray(1 - light / np.maximum(wall, 1e-4))


def _flanks(light: Array, across_px: Array, core_px: float) -> tuple[Array, Array]:
    """Light (k,) of the wall on either side; where a strip ends before it, the other side's."""
    outer = core_px + _flank(core_px)
    levels = []
    for sign in (-1, 1):
        flank = (sign * across_px > core_px) & (sign * across_px <= outer)
        level = np.median(light[:, flank], axis=1) if flank.any() else np.full(len(light), np.nan)
        levels.append(median_filter(level, size=5, mode="nearest"))
    left, right = levels
    return np.where(np.isnan(left), right, left), np.where(np.isnan(right), left, right)


def _middles(dark: Array, across_px: Array, core_px: float, blur_px: float) -> tuple[Array, float]:
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

    def found(rows: Array) -> Array:
        smooth = gaussian_filter1d(rows, _SMOOTH_PX, axis=0, mode="nearest")
        smooth[:, np.abs(across_px) > max(core_px / 2, 1.0)] = -np.inf
        return _peaks(smooth, across_px)

    odd = np.arange(len(dark)) % 2 == 1
    if odd.sum() < 4:
        return found(fit), 0.3
    halves = [np.interp(np.arange(len(dark)), np.flatnonzero(half), found(fit[half])) for half in (odd, ~odd)]
    apart = 1.4826 * float(np.median(np.abs(halves[0] - halves[1])))
    return found(fit), apart / 2


def _peaks(rows: Array, across_px: Array) -> Array:
    """Place (k,) of the largest value of each row (k, m), to a fraction of a step by a parabola."""
    best = np.clip(rows.argmax(axis=1), 1, rows.shape[1] - 2)
    number = np.arange(len(rows))
    before, here, after = (rows[number, best + by] for by in (-1, 0, 1))
    bend = before - 2 * here + after
    with np.errstate(invalid="ignore", divide="ignore"):
        part = np.where(np.isfinite(bend) & (bend < 0), (before - after) / (2 * bend), 0.0)
    return np.asarray(across_px[best] + np.clip(part, -0.5, 0.5) * STEP_PX)


def _even(dark: Array, across_px: Array, core_px: float) -> NDArray[np.bool_]:
    """Places (k,) whose flanks are not much less even than those of most."""
    outer = core_px + _flank(core_px)
    flank = (np.abs(across_px) > core_px) & (np.abs(across_px) <= outer)
    rough = gaussian_filter1d(np.abs(dark[:, flank]).mean(axis=1), 1.0, mode="nearest")
    usual = np.sort(rough)[int(_EVEN_SHARE * (len(rough) - 1))]
    return np.asarray(rough <= _ROUGHER * usual)
