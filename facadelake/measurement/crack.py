"""Measure one crack in one photograph: its centreline, length and width in pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Float64Nx2, UInt8Image
from facadelake.measurement.blur import Blur, estimate_blur, grey_from_bgr, linearise_srgb
from facadelake.measurement.profiles import (
    Profiles,
    compute_half_width,
    extract_profiles,
    shift_across,
    snap_to_darkest_path,
    straighten,
)
from facadelake.measurement.trace import Centreline, detect_dark_ridges, trace_along_mask, trace_through_box
from facadelake.measurement.width import CrackWidth, fit_width
from schemas.vocabulary import CrackWidthOutcome

_CORE_MARGIN_SIGMAS = 2.5  # standard deviations of the blur beyond the edge of a crack, where its darkness ends
_MIN_GAP_PX = 0.6  # a bright gap of a profile that is wider separates another line
_MIN_CORE_PX = 2.5
_MAX_CORE_PX = 60.0
_MIN_SIGNAL_TO_NOISE = 5.0  # mean equivalent width over the standard error of that of the wall beside the line
_MIN_VISIBLE_SHARE = 0.65  # share of the line that must be darker than the texture of the wall
_MIN_DARKNESS = 0.02  # relative to the light of the wall: fainter lines occur in every wall
_MIN_SPAN_SHARE = 0.3  # of the longer side of the box


@dataclass(frozen=True, kw_only=True, eq=False)
class CrackMeasurement:
    """Centreline, length and width of a crack in pixels; (0.5, 0.5) is the centre of the top left pixel.

    Where no line is found ``line_px`` (k, 2) and ``width`` are None, and ``length_px`` is NaN.
    """

    outcome: CrackWidthOutcome
    line_px: Float64Nx2 | None = None
    length_px: float = float("nan")
    width: CrackWidth | None = None

    def shift(self, x_px: float, y_px: float) -> CrackMeasurement:
        """The measurement in pixels of the photograph, where the crop begins at (``x_px``, ``y_px``)."""
        return self if self.line_px is None else replace(self, line_px=self.line_px + np.array([x_px, y_px]))


NO_LINE = CrackMeasurement(outcome=CrackWidthOutcome.NO_LINE)


def measure_crack(
    crop_bgr: UInt8Image, inside: BoolArray, *, is_mask: bool, blur: Blur | None = None
) -> CrackMeasurement:
    """Measure the crack in a crop of a photograph.

    Args:
        crop_bgr: the crop (h, w, 3).
        inside: pixels (h, w) of the box or mask of the detection.
        is_mask: ``inside`` is a mask that follows the crack, not a box.
        blur: blur of the photograph; None: it is estimated from the crop.

    Returns:
        The measurement in pixels of the crop; its outcome is ``no_line`` where there is no crack-like line.
    """
    grey = grey_from_bgr(crop_bgr)
    rows, columns = np.nonzero(inside)
    if len(rows) == 0:
        return NO_LINE
    ridges = detect_dark_ridges(grey, float(max(np.ptp(rows), np.ptp(columns)) + 1))
    line = trace_along_mask(ridges, inside) if is_mask else trace_through_box(ridges, inside)
    if line is None:
        return NO_LINE
    light = linearise_srgb(grey)
    blur = blur or estimate_blur(light)
    xy, profiles = _sample_profiles(light, line, blur)
    if not _is_crack_like(profiles, line, inside, is_mask):
        return NO_LINE
    width = fit_width(profiles, blur)
    outcome = CrackWidthOutcome.MEASURED if width.is_resolved else CrackWidthOutcome.BELOW_LIMIT
    length = float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())
    return CrackMeasurement(outcome=outcome, line_px=xy + 0.5, length_px=length, width=width)


def _sample_profiles(light: Float32Array, line: Centreline, blur: Blur) -> tuple[Float64Nx2, Profiles]:
    """The line (k, 2) shifted onto its darkest path, and its profiles.

    The width of the core comes from the ridge first, then from the full width at half maximum of the profiles.
    """
    width = ridge_width = float(np.median(line.width_px))
    xy = line.xy
    for _ in range(2):
        xy = snap_to_darkest_path(light, xy, width, max(2.0, width / 2 + 1))
        core = float(np.clip(width / 2 + _CORE_MARGIN_SIGMAS * blur.sigma_px, _MIN_CORE_PX, _MAX_CORE_PX))
        profiles = extract_profiles(straighten(light, xy, compute_half_width(core)), core, blur.sigma_px)
        width = float(np.clip(_measure_apparent_fwhm(profiles), ridge_width / 2, 2 * ridge_width + 1))
    core = float(np.clip(width / 2 + _CORE_MARGIN_SIGMAS * blur.sigma_px, _MIN_CORE_PX, _MAX_CORE_PX))
    profiles = extract_profiles(straighten(light, xy, compute_half_width(core)), core, blur.sigma_px)
    return shift_across(xy, profiles.centre_px), profiles


def _measure_apparent_fwhm(profiles: Profiles) -> float:
    """Full width at half maximum in px of the median profile of the widest 30 % of the positions."""
    equivalent_width = profiles.equivalent_width_px[profiles.is_homogeneous]
    widest = equivalent_width >= np.quantile(equivalent_width, 0.7)
    profile = np.median(profiles.darkness[profiles.is_homogeneous][widest], axis=0)
    maximum = profile[np.abs(profiles.offset_px) < 1.0].max()
    above_half = np.sort(np.abs(profiles.offset_px[profile > maximum / 2]))
    if maximum <= 0 or len(above_half) == 0:
        return 1.0
    gaps = np.flatnonzero(np.diff(above_half) > _MIN_GAP_PX)
    return float(2 * (above_half[gaps[0]] if len(gaps) else above_half[-1]))


def _is_crack_like(profiles: Profiles, line: Centreline, inside: BoolArray, is_mask: bool) -> bool:
    """Whether the line is significantly darker than the wall along most of its length, and spans its box."""
    rows, columns = np.nonzero(inside)
    side = max(np.ptp(rows), np.ptp(columns)) + 1
    core = np.abs(profiles.offset_px) < 0.6
    darkness = profiles.darkness[:, core].mean(axis=1)
    homogeneous = profiles.is_homogeneous
    texture = float(np.std(profiles.background_width_px[homogeneous]))
    limit = _MIN_SIGNAL_TO_NOISE * texture / np.sqrt(max(len(darkness) / 10, 1.0))
    is_significant = float(profiles.equivalent_width_px[homogeneous].mean()) > limit
    is_dark = (profiles.equivalent_width_px > texture) & profiles.is_trough
    is_visible = float(np.mean(is_dark)) >= _MIN_VISIBLE_SHARE
    spans = is_mask or line.length_px >= _MIN_SPAN_SHARE * side
    return bool(is_significant and is_visible and spans and darkness.mean() >= _MIN_DARKNESS)
