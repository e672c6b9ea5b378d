"""One crack in one photograph: its line, length and width in pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, UInt8Image
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

_CORE_MARGIN_SIGMAS = 2.5  # of the blur beyond a crack's edge, where its darkness ends
_MIN_GAP_PX = 0.6  # of light within a profile: what lies beyond is another line
_MIN_CORE_PX = 2.5
_MAX_CORE_PX = 60.0
_MIN_SIGNAL_TO_NOISE = 5.0  # a line's mean darkness over one sigma of the mean of the wall's beside it
_MIN_VISIBLE_SHARE = 0.65  # of a line's places must be darker than the wall's own texture
_MIN_DARKNESS = 0.02  # of the wall's light: fainter lines are in every wall
_MIN_SPAN_SHARE = 0.3  # of its box's longer side


@dataclass(frozen=True, kw_only=True, eq=False)
class CrackMeasurement:
    """What a photograph shows of a crack, in its pixels ((0.5, 0.5) is the centre of the top left one).

    ``line_px`` (k, 2) is None, and every number NaN, where there is no line. ``width`` is None then, too.
    """

    outcome: CrackWidthOutcome
    line_px: Float64Array | None = None
    length_px: float = float("nan")
    width: CrackWidth | None = None

    def shift(self, x_px: float, y_px: float) -> CrackMeasurement:
        """The same in pixels of a picture whose top left corner lies this much before the crop's."""
        return self if self.line_px is None else replace(self, line_px=self.line_px + np.array([x_px, y_px]))


NO_LINE = CrackMeasurement(outcome=CrackWidthOutcome.NO_LINE)


def measure_crack(
    crop_bgr: UInt8Image, inside: BoolArray, *, is_mask: bool, blur: Blur | None = None
) -> CrackMeasurement:
    """Measure the crack in ``crop_bgr`` (h, w, 3) that runs through ``inside`` (h, w): a box, or a mask along it.

    ``blur`` is the photograph's; None: the crop's own edges tell. Coordinates are the crop's.
    """
    coded = grey_from_bgr(crop_bgr)
    rows, columns = np.nonzero(inside)
    if len(rows) == 0:
        return NO_LINE
    ridges = detect_dark_ridges(coded, float(max(np.ptp(rows), np.ptp(columns)) + 1))
    line = trace_along_mask(ridges, inside) if is_mask else trace_through_box(ridges, inside)
    if line is None:
        return NO_LINE
    light = linearise_srgb(coded)
    known = blur or estimate_blur(light)
    xy, profiles = _sample_profiles(light, line, known)
    if not _is_crack_like(profiles, line, inside, is_mask):
        return NO_LINE
    width = fit_width(profiles, known)
    outcome = CrackWidthOutcome.MEASURED if width.is_resolved else CrackWidthOutcome.BELOW_LIMIT
    length = float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())
    return CrackMeasurement(outcome=outcome, line_px=xy + 0.5, length_px=length, width=width)


def _sample_profiles(light: Float32Array, line: Centreline, blur: Blur) -> tuple[Float64Array, Profiles]:
    """The line on its darkest way, and its profiles, in a core that first the ridge and then the profiles tell."""
    width = of_ridge = float(np.median(line.width_px))
    xy = line.xy
    for _ in range(2):
        xy = snap_to_darkest_path(light, xy, width, max(2.0, width / 2 + 1))
        core = float(np.clip(width / 2 + _CORE_MARGIN_SIGMAS * blur.sigma_px, _MIN_CORE_PX, _MAX_CORE_PX))
        profiles = extract_profiles(straighten(light, xy, compute_half_width(core)), core, blur.sigma_px)
        width = float(np.clip(_measure_apparent_fwhm(profiles), of_ridge / 2, 2 * of_ridge + 1))
    core = float(np.clip(width / 2 + _CORE_MARGIN_SIGMAS * blur.sigma_px, _MIN_CORE_PX, _MAX_CORE_PX))
    profiles = extract_profiles(straighten(light, xy, compute_half_width(core)), core, blur.sigma_px)
    return shift_across(xy, profiles.centre_px), profiles


def _measure_apparent_fwhm(profiles: Profiles) -> float:
    """Width of the wider places, px, by how far from the middle their darkness is at half its depth."""
    area = profiles.equivalent_width_px[profiles.is_homogeneous]
    mean = np.median(profiles.darkness[profiles.is_homogeneous][area >= np.quantile(area, 0.7)], axis=0)
    depth = mean[np.abs(profiles.offset_px) < 1.0].max()
    deep = np.sort(np.abs(profiles.offset_px[mean > depth / 2]))
    if depth <= 0 or len(deep) == 0:
        return 1.0
    gaps = np.flatnonzero(np.diff(deep) > _MIN_GAP_PX)
    return float(2 * (deep[gaps[0]] if len(gaps) else deep[-1]))


def _is_crack_like(profiles: Profiles, line: Centreline, inside: BoolArray, is_mask: bool) -> bool:
    """Whether the line is darker than the wall beside it, all along, and runs through its box."""
    rows, columns = np.nonzero(inside)
    side = max(np.ptp(rows), np.ptp(columns)) + 1
    core = np.abs(profiles.offset_px) < 0.6
    dark = profiles.darkness[:, core].mean(axis=1)
    even = profiles.is_homogeneous
    texture = float(np.std(profiles.background_width_px[even]))
    stands_out = float(profiles.equivalent_width_px[even].mean()) > _MIN_SIGNAL_TO_NOISE * texture / np.sqrt(
        max(len(dark) / 10, 1.0)
    )
    shows = float(np.mean((profiles.equivalent_width_px > texture) & profiles.is_trough)) >= _MIN_VISIBLE_SHARE
    spans = is_mask or line.length_px >= _MIN_SPAN_SHARE * side
    return bool(stands_out and shows and spans and dark.mean() >= _MIN_DARKNESS)
