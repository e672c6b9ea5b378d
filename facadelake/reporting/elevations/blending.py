"""Which photograph colours which part of an elevation.

On a coarse grid each cell gets the photographs that show it best (a ray to the camera, then the smaller pixel on the
surface). Among them the odd one out is passed over: what stands before the wall and is not in the model, a tractor or
a tree, lies elsewhere on the wall in each photograph, so it differs from what most of them show there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface import MISS, Surface
from facadelake.core.arrays import Float32Array, Float64Array, Int64Array, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.reporting.elevations.relief import FacadeRelief
from facadelake.reporting.elevations.visibility import check_visibility, project_points
from facadelake.reporting.inspection import PictureSettings

_MAX_CANDIDATES = 8  # photographs a cell chooses among
_BORDER_PENALTY = 0.5
_FADE_SHARE = 0.15  # share of the half photograph over which it fades out at its border
_MIN_FADE = 0.02
_MAX_GAIN = 1.35
_TOLERATED_LEVELS = 10.0  # grey levels by which photographs of one wall differ: relief, reflections, vignetting
_OUTLIER_LEVELS = 14.0  # so many beyond that double a photograph's score
_OUTLIER_WINDOW_CELLS = 7  # coarse cells over which the difference is averaged

Sampler = Callable[[str, Float64Array], Float32Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class BlendWeight:
    """A photograph's part in an elevation.

    ``weight`` 0 to 255 on the part of the coarse grid from (``top``, ``left``) on; those of all photographs add up to
    255. ``gain`` evens out its exposure, ``pixel_m`` is a small pixel on the surface.
    """

    weight: UInt8Array
    top: int
    left: int
    gain: float
    pixel_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ColourCandidates:
    """Per coarse cell that shows the model (n,): its point, and up to ``_MAX_CANDIDATES`` photographs, best first (k, n).

    ``photo`` counts in ``names`` (-1: none), ``score`` is a pixel's size in m with its penalties (inf: none), ``fade``
    falls to 0 towards the photograph's border. ``cell`` (n,) is the place in the grid of ``shape``.
    """

    names: tuple[str, ...]
    shape: tuple[int, int]
    cell: Int64Array
    xyz_site_m: Float64Array
    photo: NDArray[np.int32]
    score: Float32Array
    fade: Float32Array
    pixel_m: Mapping[str, float]

    def select_photo(self, index: int) -> tuple[Int64Array, Int64Array]:
        """Ranks and cells (indices into the two axes of ``photo``) that a photograph is a candidate of."""
        ranks, cells = np.nonzero(self.photo == index)
        return ranks, cells


def find_candidates(
    relief: FacadeRelief, surface: Surface, posed: Mapping[str, PosedCamera], settings: PictureSettings
) -> ColourCandidates:
    """The best photographs of each coarse cell."""
    step = settings.visibility_step
    middles = [np.minimum(np.arange(0, size, step) + step // 2, size - 1) for size in relief.shape]
    rows, columns = np.meshgrid(*middles, indexing="ij")
    met = np.flatnonzero(relief.element[rows, columns].ravel() != MISS)
    at_rows, at_columns = rows.ravel()[met], columns.ravel()[met]
    xyz = relief.site_from_cells(at_rows, at_columns)
    normal = relief.normal[at_rows, at_columns].astype(np.float64)
    photo = np.full((_MAX_CANDIDATES, len(met)), -1, dtype=np.int32)
    score, fade = np.full(photo.shape, np.inf, dtype=np.float32), np.zeros(photo.shape, dtype=np.float32)
    pixel_m: dict[str, float] = {}
    for index, (name, camera) in enumerate(posed.items()):
        sight = check_visibility(
            camera, surface, xyz, normal,
            tolerance_m=settings.visibility_tolerance_m, max_incidence_deg=settings.max_incidence_deg,
        )  # fmt: skip
        # The cells round a coarse one must lie in the photograph too.
        reach = 4.0 * step * relief.cell_m / sight.pixel_m / min(camera.camera.width_px, camera.camera.height_px)
        cells = np.flatnonzero(sight.visible & (sight.inset > reach))
        if len(cells) == 0:
            continue
        pixel_m[name] = float(np.quantile(sight.pixel_m[cells], 0.05))
        # Below half a cell more resolution shows nothing; the border of a photograph is its worst part.
        border = 1.0 + _BORDER_PENALTY * (1.0 - sight.inset[cells]) ** 2
        new = np.maximum(sight.pixel_m[cells], 0.5 * relief.cell_m) * border
        worst = new < score[-1, cells]
        cells, new = cells[worst], new[worst]
        # The newcomer takes the place of the worst; then the few are sorted again.
        score[-1, cells], photo[-1, cells] = new, index
        fade[-1, cells] = np.clip(sight.inset[cells] / _FADE_SHARE, _MIN_FADE, 1.0)
        order = np.argsort(score[:, cells], axis=0, kind="stable")
        for values in (score, photo, fade):
            values[:, cells] = np.take_along_axis(values[:, cells], order, axis=0)
    return ColourCandidates(
        names=tuple(posed), shape=rows.shape, cell=met, xyz_site_m=xyz, photo=photo, score=score, fade=fade,
        pixel_m=pixel_m,
    )  # fmt: skip


def assign_blend_weights(
    candidates: ColourCandidates, posed: Mapping[str, PosedCamera], sample: Sampler, feather_cells: float
) -> dict[str, BlendWeight]:
    """The part of each photograph, with soft borders ``feather_cells`` wide; photographs without a part are absent.

    ``sample(name, pixels)`` gives colours (m, 3) of a photograph at pixels (m, 2), NaN where it cannot be read.
    """
    colour = np.full((*candidates.photo.shape, 3), np.nan, dtype=np.float32)
    indices = [int(i) for i in np.unique(candidates.photo) if i >= 0]
    for index in indices:
        ranks, cells = candidates.select_photo(index)
        name = candidates.names[index]
        xy, _ = project_points(posed[name], candidates.xyz_site_m[cells])
        colour[ranks, cells] = sample(name, xy)
    gain = _estimate_gains(candidates, colour, indices)
    for index in indices:
        colour[candidates.photo == index] *= gain[index]
    score = candidates.score * (1.0 + _measure_outlier_levels(candidates, colour, indices) ** 2)
    score[np.isnan(colour[..., 0])] = np.inf
    best = np.argmin(score, axis=0)
    chosen = np.where(
        np.isfinite(score.min(axis=0, initial=np.inf)), np.take_along_axis(candidates.photo, best[None], axis=0)[0], -1
    )
    winners = [index for index in indices if (chosen == index).any()]
    total = np.full(candidates.shape, 1e-9, dtype=np.float32)
    for index in winners:
        total += _compute_feathered_weight(candidates, index, chosen, feather_cells)
    shares: dict[str, BlendWeight] = {}
    for index in winners:  # made again rather than kept: of a thousand photographs they would fill the memory
        plane = _compute_feathered_weight(candidates, index, chosen, feather_cells)
        weight = np.round(255 * plane / total).astype(np.uint8)
        rows, columns = np.flatnonzero(weight.any(axis=1)), np.flatnonzero(weight.any(axis=0))
        if len(rows):
            shares[candidates.names[index]] = BlendWeight(
                weight=weight[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy(),
                top=int(rows[0]),
                left=int(columns[0]),
                gain=gain[index],
                pixel_m=candidates.pixel_m[candidates.names[index]],
            )
    return shares


def _compute_feathered_weight(
    candidates: ColourCandidates, index: int, chosen: NDArray[np.int32], feather_cells: float
) -> Float32Array:
    """Weight of a photograph on the coarse grid: 1 where it is chosen, falling off around, 0 where it shows nothing."""
    ranks, cells = candidates.select_photo(index)
    plane, seen = np.zeros(candidates.shape, dtype=np.float32), np.zeros(candidates.shape, dtype=np.float32)
    plane.ravel()[candidates.cell] = chosen == index
    seen.ravel()[candidates.cell[cells]] = candidates.fade[ranks, cells]
    # Cubed, one photograph rules up to near the seam: a mean of two is a little blurred.
    soft = cv2.GaussianBlur(plane, (0, 0), max(feather_cells / 2, 0.3)) ** 3
    return np.asarray(soft * seen, dtype=np.float32)


def _compute_median_colour(colour: Float32Array) -> Float32Array:
    """Median (n, 3) over the candidates of each cell; NaN where fewer than three have a colour."""
    enough = np.isfinite(colour[..., 0]).sum(axis=0) >= 3
    middle = np.full(colour.shape[1:], np.nan, dtype=np.float32)
    if enough.any():
        middle[enough] = np.nanmedian(colour[:, enough], axis=0)
    return middle


def _estimate_gains(candidates: ColourCandidates, colour: Float32Array, indices: list[int]) -> dict[int, float]:
    """Factor for each photograph that brings it to the brightness of the others where they show the same wall."""
    light = np.maximum(colour.mean(axis=-1), 1.0)
    gain = dict.fromkeys(indices, 1.0)
    for _ in range(3):
        factor = np.array([gain.get(i, np.nan) for i in range(len(candidates.names))] + [np.nan], dtype=np.float32)
        middle = _compute_median_colour((light * factor[candidates.photo])[..., None])[:, 0]
        for index in indices:
            ranks, cells = candidates.select_photo(index)
            ratio = middle[cells] / light[ranks, cells]
            ratio = ratio[np.isfinite(ratio)]
            if len(ratio):
                gain[index] = float(np.clip(np.median(ratio), 1 / _MAX_GAIN, _MAX_GAIN))
    return gain


def _measure_outlier_levels(candidates: ColourCandidates, colour: Float32Array, indices: list[int]) -> Float32Array:
    """How far (k, n) each candidate's colour is from what most show there, in ``_OUTLIER_LEVELS``; 0 where tolerable."""
    off = np.nan_to_num(np.abs(colour - _compute_median_colour(colour)).max(axis=-1))
    odd = np.zeros_like(off)
    window = (_OUTLIER_WINDOW_CELLS, _OUTLIER_WINDOW_CELLS)
    for index in indices:
        ranks, cells = candidates.select_photo(index)
        plane, there = np.zeros(candidates.shape, dtype=np.float32), np.zeros(candidates.shape, dtype=np.float32)
        plane.ravel()[candidates.cell[cells]] = off[ranks, cells]
        there.ravel()[candidates.cell[cells]] = 1.0
        mean = cv2.blur(plane, window) / np.maximum(cv2.blur(there, window), 1e-3)
        odd[ranks, cells] = mean.ravel()[candidates.cell[cells]]
    return np.asarray(np.maximum(odd - _TOLERATED_LEVELS, 0.0) / _OUTLIER_LEVELS, dtype=np.float32)
