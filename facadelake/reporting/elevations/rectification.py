"""Rectification of photographs onto elevations: each cell is coloured from the photographs with the best view of it.

Each photograph is read twice, independent of the number of facades: reduced for the selection, then for the colours.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.building.surface import MISS, Obstructions, Surface, project_points
from facadelake.core.arrays import BoolArray, Float32Array, Float64Nx2, UInt8Image
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.reporting.drawing.photograph import choose_reduction, read_photograph
from facadelake.reporting.elevations.blending import (
    BlendWeight,
    ColourCandidates,
    assign_blend_weights,
    find_candidates,
)
from facadelake.reporting.elevations.relief import FacadeRelief
from facadelake.reporting.inspection import PictureSettings

log = logging.getLogger(__name__)

_BAND_ROWS = 512  # rows of cells sampled at a time, to limit memory
_MIN_WEIGHT = 0.01
_COVERED_WEIGHT = 0.25  # weights add up to 1 within the area that photographs cover and fall off at its border
_THUMBNAIL_PX = 640  # width at which the colours of photographs are compared; all thumbnails are in memory
_REMAP_WIDTH = 4096  # points are arranged in rows, because cv2.remap is limited to 32767 columns


@dataclass(frozen=True, kw_only=True, eq=False)
class RectifiedElevation:
    """An elevation's picture (rows, columns, RGB).

    ``covered`` (rows, columns): cells that have colours of photographs. ``hidden`` (rows, columns): cells that are in
    the view of photographs, but where an object in front of the wall hides them, or photographs contradict one another;
    their colours, where they have any, may be those of the object.
    """

    relief: FacadeRelief
    picture: UInt8Image
    covered: BoolArray
    hidden: BoolArray


class _ElevationMosaic:
    """Weighted mean of photographs on one elevation, accumulated photograph by photograph."""

    def __init__(self, relief: FacadeRelief, weights: Mapping[str, BlendWeight], hidden: BoolArray, step: int) -> None:
        self.relief, self.weights, self._hidden, self._step = relief, weights, hidden, step
        self._sum = np.zeros((*relief.shape, 3), dtype=np.float32)
        self._weight = np.zeros(relief.shape, dtype=np.float32)

    def add(self, posed: PosedCamera, pixels: UInt8Image, reduction: int, blend: BlendWeight) -> None:
        """Add one photograph.

        Args:
            posed: its camera and pose.
            pixels: the photograph (h, w, 3), RGB, reduced.
            reduction: factor by which it is reduced.
            blend: its weight on the coarse grid and its gain.
        """
        rows, columns = self.relief.shape
        for top in range(0, rows, _BAND_ROWS):
            bottom = min(rows, top + _BAND_ROWS)
            # Coarse weights interpolated at the cells' centres; (0.5, 0.5) is the centre of the first coarse cell.
            map_y = ((np.arange(top, bottom) + 0.5) / self._step - 0.5 - blend.top).astype(np.float32)
            map_x = ((np.arange(columns) + 0.5) / self._step - 0.5 - blend.left).astype(np.float32)
            if map_y[0] > blend.weight.shape[0] or map_y[-1] < -1:
                continue
            grid_x, grid_y = np.meshgrid(map_x, map_y)
            weight = cv2.remap(blend.weight.astype(np.float32), grid_x, grid_y, cv2.INTER_LINEAR) / 255
            weight[self.relief.element[top:bottom] == MISS] = 0.0
            rows_used, columns_used = np.nonzero(weight > _MIN_WEIGHT)
            if len(rows_used) == 0:
                continue
            xy, inside = project_points(posed, self.relief.site_from_cells(rows_used + top, columns_used))
            rows_used, columns_used, xy = rows_used[inside], columns_used[inside], xy[inside]
            used = weight[rows_used, columns_used]
            self._sum[rows_used + top, columns_used] += (
                sample_bilinear(pixels, xy / reduction) * (used * blend.gain)[:, None]
            )
            self._weight[rows_used + top, columns_used] += used

    def compute_mean(self) -> RectifiedElevation:
        """The weighted mean of the photographs added so far; call it once."""
        covered = self._weight > _COVERED_WEIGHT
        self._sum /= np.maximum(self._weight, _COVERED_WEIGHT)[..., None]
        picture = np.clip(self._sum + 0.5, 0, 255).astype(np.uint8)
        return RectifiedElevation(relief=self.relief, picture=picture, covered=covered, hidden=self._hidden)


def sample_bilinear(pixels: UInt8Image, xy: Float64Nx2) -> Float32Array:
    """Colours (n, 3) of a picture at pixel positions, bilinear; (0.5, 0.5) is the centre of the first pixel."""
    count = len(xy)
    maps = np.zeros((2, -(-max(count, 1) // _REMAP_WIDTH) * _REMAP_WIDTH), dtype=np.float32)
    maps[:, :count] = xy.T - 0.5  # in OpenCV the centre of the first pixel is (0, 0)
    map_x, map_y = maps.reshape(2, -1, _REMAP_WIDTH)
    sampled = cv2.remap(pixels, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours: Float32Array = sampled.reshape(-1, 3)[:count].astype(np.float32)
    return colours


def _read_thumbnail(path: Path, camera: Camera) -> UInt8Image:
    """The photograph, at most ``_THUMBNAIL_PX`` wide, RGB."""
    pixels = read_photograph(path, camera, 8 if camera.width_px >= 1024 else 1)
    scale = min(1.0, _THUMBNAIL_PX / pixels.shape[1])
    return np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def rectify_elevations(
    reliefs: Sequence[FacadeRelief],
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    photographs: Mapping[str, Path],
    settings: PictureSettings,
    obstructions: Obstructions | None = None,
) -> list[RectifiedElevation]:
    """Colour each relief from the photographs; unreadable photographs are not used, with a warning.

    Args:
        reliefs: surfaces of the elevations.
        surface: surface of the model, which may hide a cell.
        posed: cameras with poses, by photo_id.
        photographs: paths of the photographs by photo_id.
        settings: step of the coarse grid, tolerance of visibility, width of transitions.
        obstructions: what hides the model; None: unknown.

    Returns:
        One picture for each relief.
    """
    thumbnails = {}
    for name in track(list(posed), label="Reading thumbnails"):
        try:
            thumbnails[name] = _read_thumbnail(photographs[name], posed[name].camera)
        except InputDataError as error:
            log.warning("photograph not used for elevations: %s", error)
    readable = {name: camera for name, camera in posed.items() if name in thumbnails}

    def sample(name: str, xy: Float64Nx2) -> Float32Array:
        return sample_bilinear(thumbnails[name], xy * (thumbnails[name].shape[1] / readable[name].camera.width_px))

    mosaics = []
    for relief in track(reliefs, label="Selecting photographs"):
        candidates = find_candidates(relief, surface, readable, settings, obstructions)
        feather = settings.feather_m / relief.cell_m / settings.visibility_step
        weights, contradictory = assign_blend_weights(candidates, readable, sample, feather)
        hidden = _find_hidden_cells(relief, candidates, contradictory, settings.visibility_step)
        mosaics.append(_ElevationMosaic(relief, weights, hidden, settings.visibility_step))
    used = [name for name in readable if any(name in mosaic.weights for mosaic in mosaics)]
    for name in track(used, label="Rectifying photographs"):
        targets = [(mosaic, mosaic.weights[name]) for mosaic in mosaics if name in mosaic.weights]
        reduction = min(choose_reduction(blend.pixel_m, mosaic.relief.cell_m) for mosaic, blend in targets)
        try:
            pixels = read_photograph(photographs[name], readable[name].camera, reduction)
        except InputDataError as error:
            log.warning("photograph not used for elevations: %s", error)
            continue
        for mosaic, blend in targets:
            mosaic.add(readable[name], pixels, reduction, blend)
    return [mosaic.compute_mean() for mosaic in mosaics]


def _find_hidden_cells(
    relief: FacadeRelief, candidates: ColourCandidates, contradictory: BoolArray, step: int
) -> BoolArray:
    """Mask (rows, columns) of the cells that something hides from the photographs.

    An as-built surface ends short of the edges of an object. Therefore a cell counts as hidden where the photographs in
    which the object hides it are as many as the others, which then may show the object's edge.

    Args:
        relief: surface of the elevation.
        candidates: photographs of each coarse cell.
        contradictory: mask of the coarse cells whose photographs contradict one another.
        step: size of a coarse cell in cells.
    """
    coarse = contradictory.copy()
    coarse.ravel()[candidates.cell] |= (candidates.obstructed > 0) & (2 * candidates.obstructed >= candidates.shown)
    # Colours are interpolated between coarse cells, so that those of the object reach one cell farther.
    coarse = cv2.dilate(coarse.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)).astype(bool)
    rows, columns = relief.shape
    hidden: BoolArray = coarse.repeat(step, axis=0).repeat(step, axis=1)[:rows, :columns]
    hidden &= relief.element != MISS
    return hidden
