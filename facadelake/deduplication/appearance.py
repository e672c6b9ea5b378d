"""Whether two observations show the same, by correlating their patches, rectified onto the surface at one scale.

Each patch is sampled around the centre of its own box, and the central part of one is searched in the other. Where it
is found at the centre, both boxes show the same defect; where it is found beside the centre, at the distance of a
neighbour, the two are neighbours. This measures the distance of two boxes on the wall independently of poses and
relief.
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

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Int64Array, RowIndices, UInt8Image
from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.progress import track
from facadelake.deduplication.observations import ObservationArrays
from facadelake.registration import compute_tangents

_log = logging.getLogger(__name__)
_HALF_CELLS = 60  # half the side of a patch; one byte per cell, 15 kB per observation
_TEMPLATE_MIN, _TEMPLATE_MAX = 6, 22  # half the side of the search template, in cells
_MARGIN = 1.3  # factor on the boxes: the surroundings of a defect identify it as much as the defect
_FINE_CELLS, _COARSE_CELLS = 1.0, 6.0  # sigmas of the band-pass: removes noise and shading
_GREY_STEPS = 2.0  # quantisation of the detail, in steps per grey value
_CONTRAST_MIN = 1.0  # standard deviation in grey values, below which a patch has no texture to compare
_CORRELATION_MIN = 0.5  # from which two patches show the same
_OFFSET_MARGIN = 0.15  # by which the correlation beside the centre must exceed that at the centre
_READ_FLAGS = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    4: cv2.IMREAD_REDUCED_GRAYSCALE_4,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}

Detail = NDArray[np.int8]


@dataclass(frozen=True, kw_only=True, eq=False)
class AppearanceScore:
    """Appearance of k pairs.

    ``score`` (k,): correlation at the centre, NaN where not compared; ``same`` (k,): both show one defect; ``differs``
    (k,): the content of one is clearly beside the centre of the other.
    """

    score: Float64N
    same: BoolArray
    differs: BoolArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotographSource:
    """The photographs below ``root`` and their cameras by photo_id; each is read once, one at a time."""

    root: Path
    posed: Mapping[str, PosedCamera]

    def prepare_comparison(
        self, photo_ids: Sequence[str]
    ) -> Callable[[ObservationArrays, RowIndices, RowIndices, Float64Array], AppearanceScore]:
        """``compare_pairs`` for observations whose codes of photographs are indices into ``photo_ids``."""

        def compare(
            observations: ObservationArrays, first: RowIndices, second: RowIndices, tolerance_m: Float64Array
        ) -> AppearanceScore:
            return self.compare_pairs(observations, photo_ids, first, second, tolerance_m)

        return compare

    def compare_pairs(
        self,
        observations: ObservationArrays,
        photo_ids: Sequence[str],
        first: RowIndices,
        second: RowIndices,
        tolerance_m: Float64N,
    ) -> AppearanceScore:
        """Compare pairs of observations by appearance.

        A pair is not compared where a photograph cannot be read, a patch leaves its photograph, or one has no texture.

        Args:
            observations: the observations (n).
            photo_ids: the photo_ids of the codes ``observations.photo``.
            first: first rows (k,) of the pairs.
            second: their second rows (k,).
            tolerance_m: distance (k,) from the centre up to which a match counts as at the centre.
        """
        rows, cell = _choose_cell_sizes(observations, first, second)
        patches = self._read_patches(observations, photo_ids, rows, cell)
        score, offset_score = np.full(len(first), np.nan), np.full(len(first), np.nan)
        for k, (i, j, tolerance) in enumerate(zip(first.tolist(), second.tolist(), tolerance_m.tolist(), strict=True)):
            if i in patches and j in patches:
                half_cells = np.minimum(*(_compute_half_cells(observations, row, cell[row]) for row in (i, j)))
                score[k], offset_score[k] = _match_patches(patches[i], patches[j], half_cells, tolerance / cell[i])
        centre, beside = np.nan_to_num(score, nan=-1.0), np.nan_to_num(offset_score, nan=-1.0)
        return AppearanceScore(
            score=score,
            same=(centre >= _CORRELATION_MIN) & (centre >= beside),
            differs=np.isfinite(score) & (beside >= _CORRELATION_MIN) & (beside >= centre + _OFFSET_MARGIN),
        )

    def _read_patches(
        self, observations: ObservationArrays, photo_ids: Sequence[str], rows: RowIndices, cell: Mapping[int, float]
    ) -> dict[int, Detail]:
        """Rectified patches by row, except those whose photograph cannot be read or does not contain them.

        Args:
            observations: the observations (n).
            photo_ids: the photo_ids of the codes ``observations.photo``.
            rows: rows (m,) to be read.
            cell: size of a cell in m, by row.
        """
        patches: dict[int, Detail] = {}
        photos = observations.photo[rows]
        for code in track(np.unique(photos).tolist(), label="Comparing observations"):
            photo_rows, posed = rows[photos == code].tolist(), self.posed[photo_ids[code]]
            gsd_m = float(observations.gsd_m[photo_rows].min())
            reduction = max(n for n in _READ_FLAGS if n == 1 or n * gsd_m <= min(cell[row] for row in photo_rows))
            image = _read_grey_image(self.root / photo_ids[code], posed.camera, reduction)
            if image is None:
                _log.warning("%s cannot be read: its observations are merged by position alone", photo_ids[code])
                continue
            for row in photo_rows:
                patch = _rectify_patch(image, posed, reduction, observations, row, cell[row])
                if patch is not None:
                    patches[row] = patch
        return patches


def _choose_cell_sizes(
    observations: ObservationArrays, first: RowIndices, second: RowIndices
) -> tuple[RowIndices, dict[int, float]]:
    """Rows to be sampled, and the size of a cell in m by row: one for all that are compared with one another."""
    count = len(observations)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _, component = connected_components(graph, directed=False)
    rows = np.unique(np.r_[first, second])
    # The GSD of the coarsest photograph, and no finer than fits the box into the patch.
    cell_min = np.maximum(observations.gsd_m, _MARGIN * observations.half_diagonal_m / _TEMPLATE_MAX)
    coarsest = np.zeros(count)
    np.maximum.at(coarsest, component[rows], cell_min[rows])
    return rows, dict(zip(rows.tolist(), coarsest[component[rows]].tolist(), strict=True))


def _compute_half_cells(observations: ObservationArrays, row: int, cell_m: float) -> Int64Array:
    """Half the size (2,) of a box with its margin, in cells: across and upward."""
    half = _MARGIN * np.array([observations.width_m[row], observations.height_m[row]]) / 2 / cell_m
    return np.clip(np.round(half), _TEMPLATE_MIN, _TEMPLATE_MAX).astype(np.int64)


def _rectify_patch(
    image: UInt8Image, posed: PosedCamera, reduction: int, observations: ObservationArrays, row: int, cell_m: float
) -> Detail | None:
    """Sample the surface around an observation, band-pass filtered; rows run from the top down.

    Args:
        image: grey image, reduced.
        posed: the photograph's camera.
        reduction: factor by which the image is reduced.
        observations: the observations (n).
        row: the observation.
        cell_m: size of a cell.

    Returns:
        The patch; None where the photograph does not contain its central part.
    """
    across, upward = (axis[0] for axis in compute_tangents(observations.normal_site[row : row + 1]))
    steps = cell_m * np.arange(-_HALF_CELLS, _HALF_CELLS + 1)
    grid = observations.xyz_site_m[row] + steps[None, :, None] * across - steps[:, None, None] * upward
    xy = posed.project_site(grid.reshape(-1, 3)) / reduction - 0.5  # in OpenCV the first pixel's centre is (0, 0)
    side = len(steps)
    height, width = image.shape
    outside = ~np.isfinite(xy).all(axis=1) | (xy < 0).any(axis=1) | (xy[:, 0] > width - 1) | (xy[:, 1] > height - 1)
    central = slice(_HALF_CELLS - _TEMPLATE_MAX, _HALF_CELLS + _TEMPLATE_MAX + 1)
    if outside.reshape(side, side)[central, central].any():
        return None
    low, high = np.floor(xy[~outside].min(axis=0)).astype(int), np.ceil(xy[~outside].max(axis=0)).astype(int) + 2
    crop = image[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    sample_xy = np.where(outside[:, None], 0.0, xy - low).astype(np.float32).reshape(side, side, 2)
    sampled = cv2.remap(crop, sample_xy, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    smoothed = cv2.GaussianBlur(sampled, (0, 0), _FINE_CELLS)
    detail = smoothed - cv2.GaussianBlur(sampled, (0, 0), _COARSE_CELLS)
    quantised: Detail = np.clip(np.round(_GREY_STEPS * detail), -127, 127).astype(np.int8)
    return quantised


def _match_patches(a: Detail, b: Detail, half_cells: Int64Array, tolerance: float) -> tuple[float, float]:
    """Correlate the central part of patch ``a`` with patch ``b``.

    Args:
        a: patch of one observation.
        b: patch of the other.
        half_cells: half the size (2,) of the central part, in cells.
        tolerance: distance from the centre up to which a match counts as at the centre, in cells.

    Returns:
        Largest correlation at the centre, and clearly beside it; NaN where there is no texture.
    """
    template = a[
        _HALF_CELLS - half_cells[1] : _HALF_CELLS + half_cells[1] + 1,
        _HALF_CELLS - half_cells[0] : _HALF_CELLS + half_cells[0] + 1,
    ]
    if template.std() < _CONTRAST_MIN * _GREY_STEPS:
        return np.nan, np.nan
    scores = cv2.matchTemplate(b.astype(np.float32), template.astype(np.float32), cv2.TM_CCOEFF_NORMED)
    rows, columns = (np.arange(n) - n // 2 for n in scores.shape)
    distance = np.hypot(rows[:, None], columns[None, :])
    at_centre, beside = scores[distance <= max(tolerance, 1.0)], scores[distance > max(1.5 * tolerance, 3.0)]
    return float(at_centre.max()), float(beside.max(initial=-1.0))


def _read_grey_image(path: Path, camera: Camera, reduction: int) -> UInt8Image | None:
    """Grey pixels in the orientation of the camera model, reduced; None where the file is no such image."""
    if not path.is_file():
        return None
    width, height = -(-camera.width_px // reduction), -(-camera.height_px // reduction)
    for orientation in (cv2.IMREAD_IGNORE_ORIENTATION, 0):
        pixels = cv2.imread(str(path), _READ_FLAGS[reduction] | orientation)
        if pixels is not None and abs(pixels.shape[1] - width) <= 1 and abs(pixels.shape[0] - height) <= 1:
            return np.asarray(pixels, dtype=np.uint8)
    return None
