"""Rectified photographs: every cell of an elevation takes its colour from the photographs that show it best.

Which photograph is best is decided on a coarse grid (a ray to the camera, then the smaller pixel on the surface);
the colours are sampled cell by cell. Each photograph is read once, whatever the number of facades.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.camera import PosedCamera
from facadelake.errors import InputDataError
from facadelake.geobim.surface import MISS, Surface
from facadelake.pictures.inspection import PictureSettings
from facadelake.pictures.photofile import read_photograph, reduction_for
from facadelake.pictures.relief import Picture, Relief
from facadelake.pictures.sight import pixels_of, sees
from facadelake.progress import track

log = logging.getLogger(__name__)

_BAND_ROWS = 512  # rows of cells sampled at a time, to bound memory
_ENOUGH_WEIGHT = 0.005
_BORDER_PENALTY = 0.5
_FADE = 0.15  # share of the half photograph over which it fades out at its border
_LEAST_FADE = 0.02
_LEAST_WEIGHT = 0.002


@dataclass(frozen=True, kw_only=True, eq=False)
class _Share:
    """A photograph's part in an elevation: weight 0 to 1 on the coarse grid, and its smallest pixel there (m)."""

    weight: NDArray[np.float32]
    pixel_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class RectifiedElevation:
    """``picture`` (rows, columns, RGB) where ``covered`` (rows, columns) a photograph shows the surface."""

    relief: Relief
    picture: Picture
    covered: NDArray[np.bool_]


def _shares(
    relief: Relief, surface: Surface, posed: Mapping[str, PosedCamera], settings: PictureSettings
) -> dict[str, _Share]:
    """Which photograph colours which part of the elevation, with soft borders; those without a part are absent."""
    step = settings.visibility_step
    middles = [np.minimum(np.arange(0, size, step) + step // 2, size - 1) for size in relief.shape]
    rows, columns = np.meshgrid(*middles, indexing="ij")
    shape = rows.shape
    met = np.flatnonzero(relief.element[rows, columns].ravel() != MISS)
    if len(met) == 0:
        return {}
    at_rows, at_columns = rows.ravel()[met], columns.ravel()[met]
    xyz = relief.xyz_site_m(at_rows, at_columns)
    normal = relief.normal[at_rows, at_columns].astype(np.float64)
    best, winner = np.full(len(met), np.inf), np.full(len(met), -1)
    seen_share: dict[int, NDArray[np.uint8]] = {}
    pixel_m: dict[int, float] = {}
    for index, camera in enumerate(posed.values()):
        sight = sees(
            camera, surface, xyz, normal,
            tolerance_m=settings.visibility_tolerance_m, max_incidence_deg=settings.max_incidence_deg,
        )  # fmt: skip
        if not sight.visible.any():
            continue
        # Below half a cell more resolution shows nothing; the border of a photograph is its worst part.
        score = np.maximum(sight.pixel_m, 0.5 * relief.cell_m) * (1.0 + _BORDER_PENALTY * (1.0 - sight.inset) ** 2)
        score[~sight.visible] = np.inf
        better = score < best
        best[better], winner[better] = score[better], index
        # A photograph fades out towards its border, so that no border shows where another one goes on.
        fade = np.clip(sight.inset / _FADE, _LEAST_FADE, 1.0)
        seen_share[index] = np.where(sight.visible, np.round(255 * fade), 0).astype(np.uint8)
        pixel_m[index] = float(np.quantile(sight.pixel_m[sight.visible], 0.05))
    sigma = settings.feather_m / relief.cell_m / step / 2
    shares: dict[str, _Share] = {}
    for index, photo_id in enumerate(posed):
        if index not in seen_share or not (winner == index).any():
            continue
        plane = np.zeros(shape, dtype=np.float32)
        plane.ravel()[met] = winner == index
        soft = cv2.GaussianBlur(plane, (0, 0), max(sigma, 0.3))
        seen = np.zeros(shape, dtype=np.float32)
        seen.ravel()[met] = seen_share[index] / 255.0
        shares[photo_id] = _Share(weight=soft * seen, pixel_m=pixel_m[index])
    return shares


class _Canvas:
    """The weighted sum of photographs on one elevation."""

    def __init__(self, relief: Relief, shares: Mapping[str, _Share], step: int) -> None:
        self.relief, self.shares, self._step = relief, shares, step
        self._sum = np.zeros((*relief.shape, 3), dtype=np.float32)
        self._weight = np.zeros(relief.shape, dtype=np.float32)

    def add(self, posed: PosedCamera, pixels: Picture, reduction: int, share: _Share) -> None:
        """Sample one photograph where it has a share."""
        rows, columns = self.relief.shape
        for top in range(0, rows, _BAND_ROWS):
            bottom = min(rows, top + _BAND_ROWS)
            # Coarse weights at the cells' centres, by the same pixel convention as everywhere.
            map_y = ((np.arange(top, bottom) + 0.5) / self._step - 0.5).astype(np.float32)
            map_x = ((np.arange(columns) + 0.5) / self._step - 0.5).astype(np.float32)
            grid_x, grid_y = np.meshgrid(map_x, map_y)
            weight = cv2.remap(share.weight, grid_x, grid_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            weight[self.relief.element[top:bottom] == MISS] = 0.0
            use_rows, use_columns = np.nonzero(weight > _LEAST_WEIGHT)
            if len(use_rows) == 0:
                continue
            xy, inside = pixels_of(posed, self.relief.xyz_site_m(use_rows + top, use_columns))
            left, right = use_columns.min(), use_columns.max() + 1
            at_x = np.full((bottom - top, right - left), -10.0, dtype=np.float32)
            at_y = at_x.copy()
            # remap counts from the centre of the top left pixel; ours is (0.5, 0.5) there.
            xy = np.where(inside[:, None], xy / reduction - 0.5, -10.0)
            at_x[use_rows, use_columns - left], at_y[use_rows, use_columns - left] = xy.T
            colour = cv2.remap(pixels, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            part = weight[:, left:right] * (at_x > -5.0)
            self._sum[top:bottom, left:right] += colour * part[..., None]
            self._weight[top:bottom, left:right] += part

    def finished(self) -> RectifiedElevation:
        """The weighted mean."""
        covered = self._weight > _ENOUGH_WEIGHT
        self._sum /= np.maximum(self._weight, _ENOUGH_WEIGHT)[..., None]
        picture = np.clip(self._sum + 0.5, 0, 255).astype(np.uint8)
        return RectifiedElevation(relief=self.relief, picture=picture, covered=covered)


def rectify(
    reliefs: Sequence[Relief],
    surface: Surface,
    posed: Mapping[str, PosedCamera],
    photographs: Mapping[str, Path],
    settings: PictureSettings,
) -> list[RectifiedElevation]:
    """Colour each relief from the photographs; one that cannot be read is left out with a warning."""
    canvases = [
        _Canvas(relief, _shares(relief, surface, posed, settings), settings.visibility_step)
        for relief in track(reliefs, label="choosing photographs")
    ]
    used = [photo_id for photo_id in posed if any(photo_id in canvas.shares for canvas in canvases)]
    for photo_id in track(used, label="rectifying photographs"):
        mine = [(canvas, canvas.shares[photo_id]) for canvas in canvases if photo_id in canvas.shares]
        reduction = min(reduction_for(share.pixel_m, canvas.relief.cell_m) for canvas, share in mine)
        try:
            pixels = read_photograph(photographs[photo_id], posed[photo_id].camera, reduction)
        except InputDataError as error:
            log.warning("left out of the elevations: %s", error)
            continue
        for canvas, share in mine:
            canvas.add(posed[photo_id], pixels, reduction, share)
    return [canvas.finished() for canvas in canvases]
