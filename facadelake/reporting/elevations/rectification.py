"""Rectified photographs: every cell of an elevation takes its colour from the photographs that show it best.

Each photograph is read twice, whatever the number of facades: once tiny, to choose among them, once for the colours.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from facadelake.building.surface import MISS, Surface
from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, UInt8Image
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.reporting.drawing.photograph import choose_reduction, read_photograph
from facadelake.reporting.elevations.blending import BlendWeight, assign_blend_weights, find_candidates
from facadelake.reporting.elevations.relief import FacadeRelief
from facadelake.reporting.elevations.visibility import project_points
from facadelake.reporting.inspection import PictureSettings

log = logging.getLogger(__name__)

_BAND_ROWS = 512  # rows of cells sampled at a time, to bound memory
_MIN_WEIGHT = 0.01
_COVERED_WEIGHT = 0.25  # weights add up to 1 inside what photographs show and run out across its border
_THUMBNAIL_PX = 640  # width at which photographs are compared with one another; all of them are held at once
_REMAP_WIDTH = 4096  # OpenCV remaps pictures whose sides are below 32768


@dataclass(frozen=True, kw_only=True, eq=False)
class RectifiedElevation:
    """``picture`` (rows, columns, RGB) where ``covered`` (rows, columns) a photograph shows the surface."""

    relief: FacadeRelief
    picture: UInt8Image
    covered: BoolArray


class _ElevationMosaic:
    """The weighted sum of photographs on one elevation."""

    def __init__(self, relief: FacadeRelief, shares: Mapping[str, BlendWeight], step: int) -> None:
        self.relief, self.weights, self._step = relief, shares, step
        self._sum = np.zeros((*relief.shape, 3), dtype=np.float32)
        self._weight = np.zeros(relief.shape, dtype=np.float32)

    def add(self, posed: PosedCamera, pixels: UInt8Image, reduction: int, share: BlendWeight) -> None:
        """Sample one photograph where it has a share."""
        rows, columns = self.relief.shape
        for top in range(0, rows, _BAND_ROWS):
            bottom = min(rows, top + _BAND_ROWS)
            # Coarse weights at the cells' centres, by the same pixel convention as everywhere.
            map_y = ((np.arange(top, bottom) + 0.5) / self._step - 0.5 - share.top).astype(np.float32)
            map_x = ((np.arange(columns) + 0.5) / self._step - 0.5 - share.left).astype(np.float32)
            if map_y[0] > share.weight.shape[0] or map_y[-1] < -1:
                continue
            grid_x, grid_y = np.meshgrid(map_x, map_y)
            weight = cv2.remap(share.weight.astype(np.float32), grid_x, grid_y, cv2.INTER_LINEAR) / 255
            weight[self.relief.element[top:bottom] == MISS] = 0.0
            use_rows, use_columns = np.nonzero(weight > _MIN_WEIGHT)
            if len(use_rows) == 0:
                continue
            xy, inside = project_points(posed, self.relief.site_from_cells(use_rows + top, use_columns))
            use_rows, use_columns, xy = use_rows[inside], use_columns[inside], xy[inside]
            part = weight[use_rows, use_columns]
            self._sum[use_rows + top, use_columns] += (
                sample_bilinear(pixels, xy / reduction) * (part * share.gain)[:, None]
            )
            self._weight[use_rows + top, use_columns] += part

    def compute_mean(self) -> RectifiedElevation:
        """The weighted mean."""
        covered = self._weight > _COVERED_WEIGHT
        self._sum /= np.maximum(self._weight, _COVERED_WEIGHT)[..., None]
        picture = np.clip(self._sum + 0.5, 0, 255).astype(np.uint8)
        return RectifiedElevation(relief=self.relief, picture=picture, covered=covered)


def sample_bilinear(pixels: UInt8Image, xy: Float64Array) -> Float32Array:
    """Colours (n, 3) at positions (n, 2) of a picture, (0.5, 0.5) the centre of its first pixel; bilinear."""
    count = len(xy)
    maps = np.zeros((2, -(-max(count, 1) // _REMAP_WIDTH) * _REMAP_WIDTH), dtype=np.float32)
    maps[:, :count] = xy.T - 0.5  # OpenCV counts from the centre of the first pixel
    at_x, at_y = maps.reshape(2, -1, _REMAP_WIDTH)
    sampled = cv2.remap(pixels, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours: Float32Array = sampled.reshape(-1, 3)[:count].astype(np.float32)
    return colours


def _read_thumbnail(path: Path, camera: Camera) -> UInt8Image:
    """The photograph, at most ``_THUMBNAIL_PX`` wide."""
    pixels = read_photograph(path, camera, 8 if camera.width_px >= 1024 else 1)
    scale = min(1.0, _THUMBNAIL_PX / pixels.shape[1])
    return np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def rectify_elevations(
    reliefs: Sequence[FacadeRelief],
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    photographs: Mapping[str, Path],
    settings: PictureSettings,
) -> list[RectifiedElevation]:
    """Colour each relief from the photographs; one that cannot be read is left out with a warning."""
    tiny = {}
    for name in track(list(posed), label="Evening out exposures"):
        try:
            tiny[name] = _read_thumbnail(photographs[name], posed[name].camera)
        except InputDataError as error:
            log.warning("left out of the elevations: %s", error)
    readable = {name: camera for name, camera in posed.items() if name in tiny}

    def colours(name: str, xy: Float64Array) -> Float32Array:
        return sample_bilinear(tiny[name], xy * (tiny[name].shape[1] / readable[name].camera.width_px))

    canvases = []
    for relief in track(reliefs, label="Choosing photographs"):
        candidates = find_candidates(relief, surface, readable, settings)
        feather = settings.feather_m / relief.cell_m / settings.visibility_step
        canvases.append(
            _ElevationMosaic(
                relief, assign_blend_weights(candidates, readable, colours, feather), settings.visibility_step
            )
        )
    used = [name for name in readable if any(name in canvas.weights for canvas in canvases)]
    for name in track(used, label="Rectifying photographs"):
        mine = [(canvas, canvas.weights[name]) for canvas in canvases if name in canvas.weights]
        reduction = min(choose_reduction(share.pixel_m, canvas.relief.cell_m) for canvas, share in mine)
        try:
            pixels = read_photograph(photographs[name], readable[name].camera, reduction)
        except InputDataError as error:
            log.warning("left out of the elevations: %s", error)
            continue
        for canvas, share in mine:
            canvas.add(readable[name], pixels, reduction, share)
    return [canvas.compute_mean() for canvas in canvases]
