"""Whether two sightings show the same: their patches, rectified onto the surface at one scale, correlated.

Each patch is sampled about its own box's centre. The middle of the one is looked for in the other: found where the
centres meet, both boxes show the same; found aside, by as much as neighbours stand apart, the two are neighbours. This
measures how far two boxes are apart on the wall by the wall itself, whatever the poses and the relief are.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array, RowIndices, UInt8Image
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.progress import track
from facadelake.deduplication.observations import ObservationArrays
from facadelake.registration import compute_tangents

_log = logging.getLogger(__name__)
_HALF_CELLS = 60  # half a patch's side; a byte a cell, so 15 kB a sighting
_TEMPLATE_MIN, _TEMPLATE_MAX = 6, 22  # cells from the middle of what is looked for
_MARGIN = 1.3  # of the boxes: what surrounds a defect tells as much as the defect
_FINE_CELLS, _COARSE_CELLS = 1.0, 6.0  # band of detail that counts: shade and noise do not
_GREY_STEPS = 2.0  # of a grey value that detail is kept to
_CONTRAST_MIN = 1.0  # grey values: a patch with less detail shows nothing to compare
_CORRELATION_MIN = 0.5  # correlation from which two patches show the same
_OFFSET_MARGIN = 0.15  # by how much a better match aside has to be better
_READ_FLAGS = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}

Detail = NDArray[np.int8]


@dataclass(frozen=True, kw_only=True, eq=False)
class AppearanceScore:
    """Of k pairs: ``score`` (k,), the correlation where the centres meet, NaN where pictures tell nothing; ``same`` and
    ``differs`` (k,): they show one thing, or the one's middle lies clearly aside in the other."""

    score: Float64Array
    same: BoolArray
    differs: BoolArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotographSource:
    """The photographs below ``root`` and their cameras, by photo_id; read one at a time, each once."""

    root: Path
    posed: Mapping[str, PosedCamera]

    def prepare_comparison(
        self, photo_ids: Sequence[str]
    ) -> Callable[[ObservationArrays, RowIndices, RowIndices, Float64Array], AppearanceScore]:
        """``compare_pairs`` for sightings whose photographs' codes mean ``photo_ids``."""

        def compare(
            sightings: ObservationArrays, first: RowIndices, second: RowIndices, tolerance_m: Float64Array
        ) -> AppearanceScore:
            return self.compare_pairs(sightings, photo_ids, first, second, tolerance_m)

        return compare

    def compare_pairs(
        self,
        sightings: ObservationArrays,
        photo_ids: Sequence[str],
        first: RowIndices,
        second: RowIndices,
        tolerance_m: Float64Array,
    ) -> AppearanceScore:
        """Compare the pairs ``first``, ``second`` (k,); centres meet to ``tolerance_m`` (k,).

        ``photo_ids`` are the words of ``sightings.photo``. What cannot be read, or has no detail, is not compared.
        """
        rows, cell = _choose_cell_sizes(sightings, first, second)
        patches = self._read_patches(sightings, photo_ids, rows, cell)
        score, aside = np.full(len(first), np.nan), np.full(len(first), np.nan)
        for k, (i, j, tolerance) in enumerate(zip(first.tolist(), second.tolist(), tolerance_m.tolist(), strict=True)):
            if i in patches and j in patches:
                size = np.minimum(*(_compute_half_cells(sightings, row, cell[row]) for row in (i, j)))
                score[k], aside[k] = _match_patches(patches[i], patches[j], size, tolerance / cell[i])
        alike, elsewhere = np.nan_to_num(score, nan=-1.0), np.nan_to_num(aside, nan=-1.0)
        return AppearanceScore(
            score=score,
            same=(alike >= _CORRELATION_MIN) & (alike >= elsewhere),
            differs=np.isfinite(score) & (elsewhere >= _CORRELATION_MIN) & (elsewhere >= alike + _OFFSET_MARGIN),
        )

    def _read_patches(
        self, sightings: ObservationArrays, photo_ids: Sequence[str], rows: RowIndices, cell: Mapping[int, float]
    ) -> dict[int, Detail]:
        """The patches of ``rows``, less those of photographs that cannot be read and those that leave the picture."""
        found: dict[int, Detail] = {}
        photos = sightings.photo[rows]
        for number in track(np.unique(photos).tolist(), label="Comparing sightings"):
            own, posed = rows[photos == number].tolist(), self.posed[photo_ids[number]]
            pixel = float(sightings.gsd_m[own].min())
            reduction = max(n for n in _READ_FLAGS if n == 1 or n * pixel <= min(cell[row] for row in own))
            picture = _read_grey_image(self.root / photo_ids[number], posed.camera, reduction)
            if picture is None:
                _log.warning("%s cannot be read: its sightings are merged by their places alone", photo_ids[number])
                continue
            for row in own:
                patch = _rectify_patch(picture, posed, reduction, sightings, row, cell[row])
                if patch is not None:
                    found[row] = patch
        return found


def _choose_cell_sizes(
    sightings: ObservationArrays, first: RowIndices, second: RowIndices
) -> tuple[RowIndices, dict[int, float]]:
    """Rows to be sampled, and the cell of each in metres: one for all that are compared with one another."""
    count = len(sightings)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    rows = np.unique(np.r_[first, second])
    # The coarsest photograph's pixel, and no finer than lets the box into the patch.
    least = np.maximum(sightings.gsd_m, _MARGIN * sightings.half_diagonal_m / _TEMPLATE_MAX)
    coarsest = np.zeros(count)
    np.maximum.at(coarsest, part[rows], least[rows])
    return rows, dict(zip(rows.tolist(), coarsest[part[rows]].tolist(), strict=True))


def _compute_half_cells(sightings: ObservationArrays, row: int, cell_m: float) -> Int64Array:
    """Half the size of a box, with what surrounds it, in cells: across and upward."""
    half = _MARGIN * np.array([sightings.width_m[row], sightings.height_m[row]]) / 2 / cell_m
    return np.clip(np.round(half), _TEMPLATE_MIN, _TEMPLATE_MAX).astype(np.int64)


def _rectify_patch(
    picture: UInt8Image, posed: PosedCamera, reduction: int, sightings: ObservationArrays, row: int, cell_m: float
) -> Detail | None:
    """The detail of the surface about a sighting, up in rows from the top; None where the photograph ends before."""
    across, upward = (axis[0] for axis in compute_tangents(sightings.normal_site[row : row + 1]))
    steps = cell_m * np.arange(-_HALF_CELLS, _HALF_CELLS + 1)
    grid = sightings.xyz_site_m[row] + steps[None, :, None] * across - steps[:, None, None] * upward
    xy = posed.project_site(grid.reshape(-1, 3)) / reduction - 0.5  # OpenCV counts from the first pixel's centre
    side = len(steps)
    height, width = picture.shape
    outside = ~np.isfinite(xy).all(axis=1) | (xy < 0).any(axis=1) | (xy[:, 0] > width - 1) | (xy[:, 1] > height - 1)
    inner = slice(_HALF_CELLS - _TEMPLATE_MAX, _HALF_CELLS + _TEMPLATE_MAX + 1)
    if outside.reshape(side, side)[inner, inner].any():
        return None
    low, high = np.floor(xy[~outside].min(axis=0)).astype(int), np.ceil(xy[~outside].max(axis=0)).astype(int) + 2
    crop = picture[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    at = np.where(outside[:, None], 0.0, xy - low).astype(np.float32).reshape(side, side, 2)
    sampled = cv2.remap(crop, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    fine = cv2.GaussianBlur(sampled, (0, 0), _FINE_CELLS)
    detail = fine - cv2.GaussianBlur(sampled, (0, 0), _COARSE_CELLS)
    kept: Detail = np.clip(np.round(_GREY_STEPS * detail), -127, 127).astype(np.int8)
    return kept


def _match_patches(a: Detail, b: Detail, size: Int64Array, tolerance: float) -> tuple[float, float]:
    """Best correlation of the middle of ``a`` in ``b`` within ``tolerance`` cells of the centre, and clearly beyond;
    NaN where there is no detail."""
    middle = a[_HALF_CELLS - size[1] : _HALF_CELLS + size[1] + 1, _HALF_CELLS - size[0] : _HALF_CELLS + size[0] + 1]
    if middle.std() < _CONTRAST_MIN * _GREY_STEPS:
        return np.nan, np.nan
    scores = cv2.matchTemplate(b.astype(np.float32), middle.astype(np.float32), cv2.TM_CCOEFF_NORMED)
    rows, columns = (np.arange(n) - n // 2 for n in scores.shape)
    off = np.hypot(rows[:, None], columns[None, :])
    near, far = scores[off <= max(tolerance, 1.0)], scores[off > max(1.5 * tolerance, 3.0)]
    return float(near.max()), float(far.max(initial=-1.0))


def _read_grey_image(path: Path, camera: Camera, reduction: int) -> UInt8Image | None:
    """Grey pixels as the camera model counts them, reduced; None where the file is not such a picture."""
    if not path.is_file():
        return None
    width, height = -(-camera.width_px // reduction), -(-camera.height_px // reduction)
    for orientation in (cv2.IMREAD_IGNORE_ORIENTATION, 0):
        pixels = cv2.imread(str(path), _READ_FLAGS[reduction] | orientation)
        if pixels is not None and abs(pixels.shape[1] - width) <= 1 and abs(pixels.shape[0] - height) <= 1:
            return np.asarray(pixels, dtype=np.uint8)
    return None
