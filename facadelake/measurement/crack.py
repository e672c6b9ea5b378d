"""One crack in one photograph: its line, length and width in pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, UInt8Image
from facadelake.measurement.blur import Blur, blur_of, coded_grey, linear
from facadelake.measurement.profiles import (
    Profiles,
    half_width_wanted,
    moved_across,
    onto_the_darkest,
    profiles_of,
    straightened,
)
from facadelake.measurement.trace import Line, dark_lines, line_along_mask, line_through_box
from facadelake.measurement.width import Width, width_of
from schemas.vocabulary import CrackWidthOutcome

_BLURS = 2.5  # of the blur beyond a crack's edge, where its darkness ends
_GAP_PX = 0.6  # of light within a profile: what lies beyond is another line
_CORE_LEAST_PX = 2.5
_CORE_MOST_PX = 60.0
_STANDS_OUT = 5.0  # a line's mean darkness over one sigma of the mean of the wall's beside it
_SHOWS_SHARE = 0.65  # of a line's places must be darker than the wall's own texture
_LEAST_DARKNESS = 0.02  # of the wall's light: fainter lines are in every wall
_SPANS_SHARE = 0.3  # of its box's longer side


@dataclass(frozen=True, kw_only=True, eq=False)
class CrackMeasure:
    """What a photograph shows of a crack, in its pixels ((0.5, 0.5) is the centre of the top left one).

    ``line_px`` (k, 2) is None, and every number NaN, where there is no line. ``width`` is None then, too.
    """

    outcome: CrackWidthOutcome
    line_px: Float64Array | None = None
    length_px: float = float("nan")
    width: Width | None = None

    def moved(self, x_px: float, y_px: float) -> CrackMeasure:
        """The same in pixels of a picture whose top left corner lies this much before the crop's."""
        return self if self.line_px is None else replace(self, line_px=self.line_px + np.array([x_px, y_px]))


NO_LINE = CrackMeasure(outcome=CrackWidthOutcome.NO_LINE)


def measure_crack(crop_bgr: UInt8Image, inside: BoolArray, *, is_mask: bool, blur: Blur | None = None) -> CrackMeasure:
    """Measure the crack in ``crop_bgr`` (h, w, 3) that runs through ``inside`` (h, w): a box, or a mask along it.

    ``blur`` is the photograph's; None: the crop's own edges tell. Coordinates are the crop's.
    """
    coded = coded_grey(crop_bgr)
    rows, columns = np.nonzero(inside)
    if len(rows) == 0:
        return NO_LINE
    ridges = dark_lines(coded, float(max(np.ptp(rows), np.ptp(columns)) + 1))
    line = line_along_mask(ridges, inside) if is_mask else line_through_box(ridges, inside)
    if line is None:
        return NO_LINE
    light = linear(coded)
    known = blur or blur_of(light)
    xy, profiles = _profiles(light, line, known)
    if not _is_a_line(profiles, line, inside, is_mask):
        return NO_LINE
    width = width_of(profiles, known)
    outcome = CrackWidthOutcome.MEASURED if width.told else CrackWidthOutcome.BELOW_LIMIT
    length = float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())
    return CrackMeasure(outcome=outcome, line_px=xy + 0.5, length_px=length, width=width)


def _profiles(light: Float32Array, line: Line, blur: Blur) -> tuple[Float64Array, Profiles]:
    """The line on its darkest way, and its profiles, in a core that first the ridge and then the profiles tell."""
    width = of_ridge = float(np.median(line.width_px))
    xy = line.xy
    for _ in range(2):
        xy = onto_the_darkest(light, xy, width, max(2.0, width / 2 + 1))
        core = float(np.clip(width / 2 + _BLURS * blur.sigma_px, _CORE_LEAST_PX, _CORE_MOST_PX))
        profiles = profiles_of(straightened(light, xy, half_width_wanted(core)), core, blur.sigma_px)
        width = float(np.clip(_apparent_width(profiles), of_ridge / 2, 2 * of_ridge + 1))
    core = float(np.clip(width / 2 + _BLURS * blur.sigma_px, _CORE_LEAST_PX, _CORE_MOST_PX))
    profiles = profiles_of(straightened(light, xy, half_width_wanted(core)), core, blur.sigma_px)
    return moved_across(xy, profiles.middle_px), profiles


def _apparent_width(profiles: Profiles) -> float:
    """Width of the wider places, px, by how far from the middle their darkness is at half its depth."""
    area = profiles.area_px[profiles.even]
    mean = np.median(profiles.darkness[profiles.even][area >= np.quantile(area, 0.7)], axis=0)
    depth = mean[np.abs(profiles.across_px) < 1.0].max()
    deep = np.sort(np.abs(profiles.across_px[mean > depth / 2]))
    if depth <= 0 or len(deep) == 0:
        return 1.0
    gaps = np.flatnonzero(np.diff(deep) > _GAP_PX)
    return float(2 * (deep[gaps[0]] if len(gaps) else deep[-1]))


def _is_a_line(profiles: Profiles, line: Line, inside: BoolArray, is_mask: bool) -> bool:
    """Whether the line is darker than the wall beside it, all along, and runs through its box."""
    rows, columns = np.nonzero(inside)
    side = max(np.ptp(rows), np.ptp(columns)) + 1
    core = np.abs(profiles.across_px) < 0.6
    dark = profiles.darkness[:, core].mean(axis=1)
    even = profiles.even
    texture = float(np.std(profiles.beside_px[even]))
    stands_out = float(profiles.area_px[even].mean()) > _STANDS_OUT * texture / np.sqrt(max(len(dark) / 10, 1.0))
    shows = float(np.mean((profiles.area_px > texture) & profiles.darker)) >= _SHOWS_SHARE
    spans = is_mask or line.length_px >= _SPANS_SHARE * side
    return bool(stands_out and shows and spans and dark.mean() >= _LEAST_DARKNESS)
