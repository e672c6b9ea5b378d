"""Selection and blending of photographs for an elevation, on a coarse grid of its cells.

The candidates of a cell are the photographs in which it is visible, those with the smallest pixel on the surface
first. A candidate whose colour differs from the median of the candidates is down-weighted: an object in front of the
wall that the model lacks, such as a vehicle or a tree, appears at another part of the wall in each photograph. Where
the as-built surface shows the object, the photographs in which it hides the cell are no candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface import MISS, Obstructions, Surface, check_visibility, project_points
from facadelake.core.arrays import BoolArray, Float32Array, Float64Nx2, Float64Nx3, RowIndices, UInt8Array
from facadelake.core.camera import PosedCamera
from facadelake.reporting.elevations.relief import FacadeRelief
from facadelake.reporting.inspection import PictureSettings

_MAX_CANDIDATES = 8  # photographs per cell
_BORDER_PENALTY = 0.5
_FADE_SHARE = 0.15  # share of half the photograph over which its weight falls off towards the border
_MIN_FADE = 0.02
_MAX_GAIN = 1.35
_TOLERATED_LEVELS = 10.0  # grey levels: usual difference between photographs of a wall
_OUTLIER_LEVELS = 14.0  # grey levels beyond the tolerance that double a candidate's score
_CONTRADICTION_LEVELS = 40.0  # grey levels beyond which two photographs show different things
_LINE_CELLS = 4  # narrower parts, in coarse cells, are lines
_OUTLIER_WINDOW_CELLS = 7  # coarse cells over which the difference is averaged

Sampler = Callable[[str, Float64Nx2], Float32Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class BlendWeight:
    """The weight of one photograph in an elevation.

    ``weight``: 0 to 255 on the window of the coarse grid that begins at (``top``, ``left``); the weights of all
    photographs add up to 255. ``gain``: factor that equalises the exposure. ``pixel_m``: small pixel on the surface
    (5th percentile), metres.
    """

    weight: UInt8Array
    top: int
    left: int
    gain: float
    pixel_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ColourCandidates:
    """The n coarse cells with a surface, and up to k photographs for each, the best first.

    ``names``: photo_ids. ``shape``: rows and columns of the coarse grid; ``cell`` (n,): flat indices in it.
    ``xyz_site_m``: surface points. ``photo`` (k, n): indices in ``names``, -1: none. ``score`` (k, n): size of a pixel
    on the surface in metres with penalties, inf: none. ``fade`` (k, n): falls to 0 towards the photograph's border.
    ``shown`` (n,): number of photographs that show the cell; ``obstructed`` (n,): number of those in which an object in
    front of the model hides it, which are no candidates. ``pixel_m``: small pixel on the surface (5th percentile) by
    photo_id, metres.
    """

    names: tuple[str, ...]
    shape: tuple[int, int]
    cell: RowIndices
    xyz_site_m: Float64Nx3
    photo: NDArray[np.int32]
    score: Float32Array
    fade: Float32Array
    shown: NDArray[np.int32]
    obstructed: NDArray[np.int32]
    pixel_m: Mapping[str, float]

    def select_photo(self, index: int) -> tuple[RowIndices, RowIndices]:
        """Ranks and cells (indices in the two axes of ``photo``) where a photograph is a candidate."""
        ranks, cells = np.nonzero(self.photo == index)
        return ranks, cells


def find_candidates(
    relief: FacadeRelief,
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    settings: PictureSettings,
    obstructions: Obstructions | None = None,
) -> ColourCandidates:
    """The best photographs of each coarse cell.

    Args:
        relief: surface of the elevation.
        surface: surface of the model, which may hide a cell.
        posed: cameras with poses, by photo_id.
        settings: step of the coarse grid, tolerance of visibility, largest incidence.
        obstructions: what hides the model; None: unknown.
    """
    step = settings.visibility_step
    centres = [np.minimum(np.arange(0, size, step) + step // 2, size - 1) for size in relief.shape]
    rows, columns = np.meshgrid(*centres, indexing="ij")
    met = np.flatnonzero(relief.element[rows, columns].ravel() != MISS)
    met_rows, met_columns = rows.ravel()[met], columns.ravel()[met]
    xyz = relief.site_from_cells(met_rows, met_columns)
    normal = relief.normal[met_rows, met_columns].astype(np.float64)
    photo = np.full((_MAX_CANDIDATES, len(met)), -1, dtype=np.int32)
    score, fade = np.full(photo.shape, np.inf, dtype=np.float32), np.zeros(photo.shape, dtype=np.float32)
    pixel_m: dict[str, float] = {}
    shown, obstructed = np.zeros(len(met), dtype=np.int32), np.zeros(len(met), dtype=np.int32)
    for index, (name, camera) in enumerate(posed.items()):
        visibility = check_visibility(
            camera, surface, xyz, normal,
            tolerance_m=settings.visibility_tolerance_m, max_incidence_deg=settings.max_incidence_deg,
        )  # fmt: skip
        # The cells around a coarse one must be within the photograph too.
        size_px = min(camera.camera.width_px, camera.camera.height_px)
        reach = 4.0 * step * relief.cell_m / visibility.pixel_m / size_px
        cells = np.flatnonzero(visibility.visible & (visibility.inset > reach))
        if obstructions is not None and len(cells):
            hidden = obstructions.find_hidden_points(camera.centre_site_m, xyz[cells])
            obstructed[cells[hidden]] += 1
            cells = cells[~hidden]
        shown[cells] += 1
        if len(cells) == 0:
            continue
        pixel_m[name] = float(np.quantile(visibility.pixel_m[cells], 0.05))
        # Pixels below half a cell add no detail; image quality falls off towards the border.
        border = 1.0 + _BORDER_PENALTY * (1.0 - visibility.inset[cells]) ** 2
        new_score = np.maximum(visibility.pixel_m[cells], 0.5 * relief.cell_m) * border
        is_better = new_score < score[-1, cells]
        cells, new_score = cells[is_better], new_score[is_better]
        # The photograph replaces the worst candidate; then the candidates are sorted again.
        score[-1, cells], photo[-1, cells] = new_score, index
        fade[-1, cells] = np.clip(visibility.inset[cells] / _FADE_SHARE, _MIN_FADE, 1.0)
        order = np.argsort(score[:, cells], axis=0, kind="stable")
        for values in (score, photo, fade):
            values[:, cells] = np.take_along_axis(values[:, cells], order, axis=0)
    return ColourCandidates(
        names=tuple(posed), shape=rows.shape, cell=met, xyz_site_m=xyz, photo=photo, score=score, fade=fade,
        shown=shown, obstructed=obstructed, pixel_m=pixel_m,
    )  # fmt: skip


def assign_blend_weights(
    candidates: ColourCandidates, posed: Mapping[str, PosedCamera], sample: Sampler, feather_cells: float
) -> tuple[dict[str, BlendWeight], BoolArray]:
    """Blend weights of the photographs, and the coarse cells whose photographs contradict one another.

    Args:
        candidates: photographs of each coarse cell.
        posed: cameras with poses, by photo_id.
        sample: returns colours (m, 3) of a photograph, given its photo_id, at pixels (m, 2); NaN where unreadable.
        feather_cells: width of the transition between two photographs, in coarse cells.

    Returns:
        Blend weights by photo_id; photographs without weight are absent. Mask (rows, columns) of the cells where not
        more than half of the candidates have the colour that is drawn.
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
    weights: dict[str, BlendWeight] = {}
    for index in winners:  # computed twice, because the weights of all photographs do not fit in memory
        plane = _compute_feathered_weight(candidates, index, chosen, feather_cells)
        weight = np.round(255 * plane / total).astype(np.uint8)
        rows, columns = np.flatnonzero(weight.any(axis=1)), np.flatnonzero(weight.any(axis=0))
        if len(rows):
            weights[candidates.names[index]] = BlendWeight(
                weight=weight[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy(),
                top=int(rows[0]),
                left=int(columns[0]),
                gain=gain[index],
                pixel_m=candidates.pixel_m[candidates.names[index]],
            )
    return weights, _find_contradictions(candidates, colour, best)


def _find_contradictions(candidates: ColourCandidates, colour: Float32Array, best: RowIndices) -> BoolArray:
    """Mask of the coarse cells where at most half of the candidates have the colour of the best one.

    Lines are left out: at edges, photographs differ by the errors of their poses.
    """
    drawn = np.take_along_axis(colour, best[None, :, None], axis=0)[0]
    with np.errstate(invalid="ignore"):
        agreeing = (np.abs(colour - drawn).max(axis=-1) < _CONTRADICTION_LEVELS).sum(axis=0)
    count = np.isfinite(colour[..., 0]).sum(axis=0)
    mask = np.zeros(candidates.shape, dtype=np.uint8)
    mask.ravel()[candidates.cell] = (count >= 2) & (2 * agreeing <= count)
    window = np.ones((_LINE_CELLS, _LINE_CELLS), dtype=np.uint8)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, window), dtype=bool)


def _compute_feathered_weight(
    candidates: ColourCandidates, index: int, chosen: NDArray[np.int32], feather_cells: float
) -> Float32Array:
    """Weight of a photograph on the coarse grid: 1 where chosen, falling off outside, 0 where it is no candidate."""
    ranks, cells = candidates.select_photo(index)
    plane, fade = np.zeros(candidates.shape, dtype=np.float32), np.zeros(candidates.shape, dtype=np.float32)
    plane.ravel()[candidates.cell] = chosen == index
    fade.ravel()[candidates.cell[cells]] = candidates.fade[ranks, cells]
    # The cube narrows the transition: where two photographs are averaged, the picture is less sharp.
    feathered = cv2.GaussianBlur(plane, (0, 0), max(feather_cells / 2, 0.3)) ** 3
    return np.asarray(feathered * fade, dtype=np.float32)


def _compute_median_colour(colour: Float32Array) -> Float32Array:
    """Median (n, channels) over the candidates of each cell; NaN where fewer than three have a colour."""
    enough = np.isfinite(colour[..., 0]).sum(axis=0) >= 3
    median = np.full(colour.shape[1:], np.nan, dtype=np.float32)
    if enough.any():
        median[enough] = np.nanmedian(colour[:, enough], axis=0)
    return median


def _estimate_gains(candidates: ColourCandidates, colour: Float32Array, indices: list[int]) -> dict[int, float]:
    """Gain of each photograph that equalises its brightness with the others where they show the same cells."""
    brightness = np.maximum(colour.mean(axis=-1), 1.0)
    gain = dict.fromkeys(indices, 1.0)
    for _ in range(3):
        factor = np.array([gain.get(i, np.nan) for i in range(len(candidates.names))] + [np.nan], dtype=np.float32)
        median = _compute_median_colour((brightness * factor[candidates.photo])[..., None])[:, 0]
        for index in indices:
            ranks, cells = candidates.select_photo(index)
            ratio = median[cells] / brightness[ranks, cells]
            ratio = ratio[np.isfinite(ratio)]
            if len(ratio):
                gain[index] = float(np.clip(np.median(ratio), 1 / _MAX_GAIN, _MAX_GAIN))
    return gain


def _measure_outlier_levels(candidates: ColourCandidates, colour: Float32Array, indices: list[int]) -> Float32Array:
    """Deviation (k, n) of each candidate from the median colour beyond the tolerance, in ``_OUTLIER_LEVELS``."""
    deviation = np.nan_to_num(np.abs(colour - _compute_median_colour(colour)).max(axis=-1))
    smoothed = np.zeros_like(deviation)
    window = (_OUTLIER_WINDOW_CELLS, _OUTLIER_WINDOW_CELLS)
    for index in indices:
        ranks, cells = candidates.select_photo(index)
        plane, mask = np.zeros(candidates.shape, dtype=np.float32), np.zeros(candidates.shape, dtype=np.float32)
        plane.ravel()[candidates.cell[cells]] = deviation[ranks, cells]
        mask.ravel()[candidates.cell[cells]] = 1.0
        mean = cv2.blur(plane, window) / np.maximum(cv2.blur(mask, window), 1e-3)
        smoothed[ranks, cells] = mean.ravel()[candidates.cell[cells]]
    return np.asarray(np.maximum(smoothed - _TOLERATED_LEVELS, 0.0) / _OUTLIER_LEVELS, dtype=np.float32)
