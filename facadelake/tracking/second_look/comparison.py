"""A second look at one place of the surface in the photographs of two campaigns: same, gone, or not to be told.

Each place is rectified from both campaigns onto one grid with one scale. Light is removed (band-pass of the logarithm
of the grey values), every view is aligned with the best one within the accuracy of the poses, and each campaign's
views are averaged: what differs between views of one campaign (reflections, parallax) is not part of the wall. The
difference of the two averages is judged against what it is around the defect, where nothing changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.core.arrays import BoolArray, Float64x3, UInt8Image
from facadelake.core.camera import PosedCamera
from facadelake.registration import compute_tangents
from facadelake.tracking.second_look.alignment import Detail, align_patch, move_patch, shift_patch
from facadelake.tracking.second_look.fading import Fading, fit_gain, measure_fading

_FINE_CELLS, _COARSE_CELLS = 1.0, 8.0
_SIDE_MAX = 481  # cells of a patch's side
_MARGIN = 1.6  # surroundings, as a factor on the extents
SURROUND_MIN_M = 0.35
_BORDER = 5  # cells at the border, where the band-pass sees no surroundings
_REFINED_WITHIN, _REFINED_MIN = 5, 0.8  # cells; correlation at the defect from which the move by it counts
ALIKE_MIN = 0.85  # correlation at the defect from which it looks the same
_PARTS, _PART_SHARE_MIN = 4, 0.5  # of the surroundings, along each side
_DARKEST = 8.0  # added to grey values before the logarithm: noise of the dark is not contrast
_INSIDE_MIN = 0.9  # share of a patch that a photograph must show


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """A place on the surface: centre ``xyz_site_m`` (3,), ``normal_site`` (3,), extents in m."""

    xyz_site_m: Float64x3
    normal_site: Float64x3
    width_m: float
    height_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PatchGrid:
    """Cells of a place's patch: ``cell_m``, ``half`` counts of cells (columns, rows) from its centre; ``defect`` and
    ``around`` (h, w): cells within the extents, and beyond them."""

    cell_m: float
    half: tuple[int, int]
    defect: BoolArray
    around: BoolArray

    @staticmethod
    def build(place: Place, gsd_m: float) -> PatchGrid:
        """The grid of a place with cells of ``gsd_m``, or larger ones where the place is large."""
        half_m = [max(_MARGIN * e / 2, e / 2 + SURROUND_MIN_M) for e in (place.width_m, place.height_m)]
        cell = max(gsd_m, 2 * max(half_m) / (_SIDE_MAX - 1))
        half = (int(np.ceil(half_m[0] / cell)) + _BORDER, int(np.ceil(half_m[1] / cell)) + _BORDER)
        columns, rows = (np.abs(np.arange(-n, n + 1)) * cell for n in half)
        defect = (rows[:, None] <= place.height_m / 2 + cell) & (columns[None, :] <= place.width_m / 2 + cell)
        around = ~defect
        around[:_BORDER], around[-_BORDER:], around[:, :_BORDER], around[:, -_BORDER:] = False, False, False, False
        return PatchGrid(cell_m=cell, half=half, defect=defect, around=around)

    def compute_points(self, place: Place) -> NDArray[np.float64]:
        """Points (h, w, 3) of the cells in site, rows from the top down."""
        across, upward = (axis[0] for axis in compute_tangents(place.normal_site[None]))
        columns, rows = (np.arange(-n, n + 1) * self.cell_m for n in self.half)
        points: NDArray[np.float64] = place.xyz_site_m + columns[None, :, None] * across - rows[:, None, None] * upward
        return points


def rectify_patch(image: UInt8Image, posed: PosedCamera, place: Place, grid: PatchGrid) -> Detail | None:
    """Grey values (h, w) of a patch, rows from the top down; None where the photograph shows too little of it."""
    points = grid.compute_points(place)
    xy = posed.project_site(points.reshape(-1, 3)) - 0.5  # in OpenCV the first pixel's centre is (0, 0)
    height, width = image.shape
    inside = np.isfinite(xy).all(axis=1) & (xy >= 0).all(axis=1) & (xy[:, 0] <= width - 1) & (xy[:, 1] <= height - 1)
    if inside.mean() < _INSIDE_MIN or inside.reshape(grid.defect.shape)[grid.defect].mean() < 1:
        return None
    xy = np.clip(np.nan_to_num(xy), 0, (width - 1, height - 1))
    low, high = np.floor(xy.min(axis=0)).astype(int), np.ceil(xy.max(axis=0)).astype(int) + 2
    crop: Detail = image[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    sample = (xy - low).astype(np.float32).reshape(points.shape[0], points.shape[1], 2)
    # Cells larger than a pixel are means of pixels: without that, fine texture aliases.
    spread = float(np.linalg.norm(np.diff(sample, axis=1), axis=2).mean())
    if spread > 1.5:
        crop = _blur(crop, 0.4 * spread)
    columns, rows = sample[..., 0], sample[..., 1]
    return np.asarray(cv2.remap(crop, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _blur(values: Detail, sigma: float) -> Detail:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma), dtype=np.float32)


def extract_detail(patch: Detail) -> Detail:
    """Band-pass of the logarithm of the grey values: free of noise, shading and exposure."""
    logs: Detail = np.log(patch + np.float32(_DARKEST))
    detail: Detail = _blur(logs, _FINE_CELLS) - _blur(logs, _COARSE_CELLS)
    return detail


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What two campaigns show of a place.

    ``at_defect``, ``around``: correlations. ``fading``: what of the defect's look has gone. ``difference``: mean of the
    largest differences at the defect, over the contrast that it has where it was detected; ``left``: contrast in the
    other campaign, over that. ``cell_m``: cell of the patches; ``cells``: of them along the defect's longer side.
    """

    at_defect: float
    around: float
    fading: Fading
    difference: float
    left: float
    cell_m: float
    cells: int


def compare_views(seen: Sequence[Detail], other: Sequence[Detail], grid: PatchGrid, tolerance_m: float) -> Comparison:
    """Compare the views of a campaign in which a defect was detected with those of another.

    Args:
        seen: grey values (h, w) of the patch in the campaign that detected it.
        other: those of the other campaign.
        grid: their grid.
        tolerance_m: accuracy of the poses, within which views are aligned.
    """
    reach = tolerance_m / grid.cell_m
    details = [extract_detail(view) for view in seen], [extract_detail(view) for view in other]
    # The reference is the view that agrees best with the other campaign: another may show something before the wall.
    reference = max(details[0], key=lambda view: max(shift_patch(view, one, reach).correlation for one in details[1]))
    warps = [[align_patch(reference, view, reach).warp for view in one] for one in details]
    whole = _compare(reference, (seen, other), details, warps, grid)
    if whole.at_defect >= ALIKE_MIN:
        return whole
    # A sill or a shadow beside the defect can lead the move of the patch by its parallax: moved by the defect itself,
    # it may look the same. What is not there cannot be made to.
    refined = [
        [_refine_at_defect(reference, view, warp, grid) for view, warp in zip(*one, strict=True)]
        for one in zip(details, warps, strict=True)
    ]
    by_defect = _compare(reference, (seen, other), details, refined, grid)
    return by_defect if by_defect.at_defect >= _REFINED_MIN else whole


def _compare(
    reference: Detail,
    patches: tuple[Sequence[Detail], Sequence[Detail]],
    details: tuple[Sequence[Detail], Sequence[Detail]],
    warps: Sequence[Sequence[Detail]],
    grid: PatchGrid,
) -> Comparison:
    """Compare two campaigns whose views are moved onto the reference."""
    first, second = (_average_views(reference, *one, grid) for one in zip(patches, details, warps, strict=True))
    gain = np.float32(fit_gain(first.detail[grid.around], second.detail[grid.around]))
    difference = _blur(second.detail - gain * first.detail, 1.0)
    contrast = max(_average_largest(first.detail[grid.defect]), 1e-6)
    rows, columns = grid.defect.any(axis=1), grid.defect.any(axis=0)
    return Comparison(
        at_defect=_correlate(first.detail[grid.defect], second.detail[grid.defect]),
        around=_correlate_around(first.detail, second.detail, grid),
        fading=measure_fading(first.logs, second.logs, grid.defect, grid.around),
        difference=_average_largest(difference[grid.defect]) / contrast,
        left=_average_largest(second.detail[grid.defect]) / contrast,
        cell_m=grid.cell_m,
        cells=int(max(np.count_nonzero(rows), np.count_nonzero(columns))),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Average:
    """Median of a campaign's views (h, w): their ``detail``, and the ``logs`` of their grey values."""

    detail: Detail
    logs: Detail


def _average_views(
    reference: Detail, patches: Sequence[Detail], details: Sequence[Detail], warps: Sequence[Detail], grid: PatchGrid
) -> _Average:
    """The median of the views moved onto the reference, without those that show something else than the best does."""
    cells = grid.defect | grid.around
    aligned = [move_patch(view, warp) for view, warp in zip(details, warps, strict=True)]
    likeness = [float(np.nan_to_num(_correlate(reference[cells], view[cells]), nan=-1.0)) for view in aligned]
    kept = [k for k, like in enumerate(likeness) if like >= 0.5 * max(likeness) or like == max(likeness)]
    logs = [move_patch(_blur(np.log(patches[k] + np.float32(_DARKEST)), 0.7), warps[k]) for k in kept]
    return _Average(
        detail=np.median(np.stack([aligned[k] for k in kept]), axis=0).astype(np.float32),
        logs=np.median(np.stack([one - np.median(one[grid.around]) for one in logs]), axis=0).astype(np.float32),
    )


def _refine_at_defect(reference: Detail, view: Detail, warp: Detail, grid: PatchGrid) -> Detail:
    """The move, shifted by a few cells to where the defect's own cells agree best."""
    rows, columns = np.flatnonzero(grid.defect.any(axis=1)), np.flatnonzero(grid.defect.any(axis=0))
    wide = _REFINED_WITHIN
    part = np.s_[rows[0] - wide : rows[-1] + wide + 1, columns[0] - wide : columns[-1] + wide + 1]
    inside = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    scores = cv2.matchTemplate(move_patch(view, warp)[part], reference[inside], cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    shift = np.array([int(column) - wide, int(row) - wide], dtype=np.float32)
    refined = warp.copy()
    refined[:, 2] += warp[:, :2] @ shift
    return refined


def _correlate_around(first: Detail, second: Detail, grid: PatchGrid) -> float:
    """Correlation of the surroundings, or the median of their parts: a repaired neighbour changes some of them."""
    parts = [
        (rows, columns)
        for rows in np.array_split(np.arange(first.shape[0]), _PARTS)
        for columns in np.array_split(np.arange(first.shape[1]), _PARTS)
    ]
    cells = [(np.ix_(*part), grid.around[np.ix_(*part)]) for part in parts]
    found = [
        _correlate(first[at][inside], second[at][inside])
        for at, inside in cells
        if np.count_nonzero(inside) >= _PART_SHARE_MIN * inside.size
    ]
    known = [one for one in found if not np.isnan(one)]
    whole = _correlate(first[grid.around], second[grid.around])
    return float(np.fmax(whole, np.median(known))) if known else whole


def _average_largest(values: Detail) -> float:
    """Mean of the largest fiftieth of the sizes: of a thin crack, the crack."""
    count = max(8, len(values) // 50)
    return float(np.sort(np.abs(values))[-count:].mean()) if len(values) else 0.0


def _correlate(first: Detail, second: Detail) -> float:
    """Correlation; NaN for fewer than 30 cells or no contrast."""
    if len(first) < 30:
        return np.nan
    a, b = first - first.mean(), second - second.mean()
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / scale if scale > 1e-9 else np.nan
