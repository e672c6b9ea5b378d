"""A second look at one place of the surface in the photographs of two campaigns: the same, changed, or not to be told.

Each place is rectified from both campaigns onto one grid with one scale, light is removed (band-pass, local
normalisation), the later view is aligned within the accuracy of the poses, and the two are correlated: where the defect
is, and around it. The surroundings tell whether the wall itself is recognised: without that, a change is no evidence.
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

_FINE_CELLS, _COARSE_CELLS = 1.0, 8.0
_SIDE_MAX = 241  # cells of a patch's side
_MARGIN = 1.6  # surroundings, as a factor on the extents
_SURROUND_MIN_M = 0.35
Detail = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """A place on the surface: centre ``xyz_site_m`` (3,), ``normal_site`` (3,), extents in m."""

    xyz_site_m: Float64x3
    normal_site: Float64x3
    width_m: float
    height_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PatchGrid:
    """Cells of a place's patch: ``half`` counts of cells (columns, rows) from its centre, ``cell_m``; ``defect``
    (h, w): cells within the extents."""

    cell_m: float
    half: tuple[int, int]
    defect: BoolArray

    @staticmethod
    def build(place: Place, gsd_m: float) -> PatchGrid:
        half_m = [max(_MARGIN * e / 2, e / 2 + _SURROUND_MIN_M) for e in (place.width_m, place.height_m)]
        cell = max(gsd_m, 2 * max(half_m) / (_SIDE_MAX - 1))
        half = (int(np.ceil(half_m[0] / cell)), int(np.ceil(half_m[1] / cell)))
        columns, rows = (np.abs(np.arange(-n, n + 1)) * cell for n in half)
        defect = (rows[:, None] <= place.height_m / 2 + cell) & (columns[None, :] <= place.width_m / 2 + cell)
        return PatchGrid(cell_m=cell, half=half, defect=defect)


def rectify(image: UInt8Image, posed: PosedCamera, place: Place, grid: PatchGrid) -> Detail | None:
    """Grey values of a patch, rows from the top down; None where the photograph does not contain it."""
    across, upward = (axis[0] for axis in compute_tangents(place.normal_site[None]))
    columns, rows = (np.arange(-n, n + 1) * grid.cell_m for n in grid.half)
    xyz = place.xyz_site_m + columns[None, :, None] * across - rows[:, None, None] * upward
    xy = posed.project_site(xyz.reshape(-1, 3)) - 0.5
    height, width = image.shape
    if not np.isfinite(xy).all() or (xy < 0).any() or (xy[:, 0] > width - 1).any() or (xy[:, 1] > height - 1).any():
        return None
    shape = (len(rows), len(columns), 2)
    low = np.floor(xy.min(axis=0)).astype(int)
    high = np.ceil(xy.max(axis=0)).astype(int) + 2
    crop = image[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    # Cells larger than a pixel are means of pixels: without that, fine texture aliases.
    spread = np.linalg.norm(np.diff(xy.reshape(shape)[shape[0] // 2], axis=0), axis=1).mean()
    if spread > 1.5:
        crop = cv2.GaussianBlur(crop, (0, 0), 0.4 * spread)
    sample = (xy - low).astype(np.float32).reshape(shape)
    return cv2.remap(crop, sample, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def extract_detail(patch: Detail) -> Detail:
    """Band-pass of the logarithm of the grey values: free of noise, shading and exposure."""
    logs = np.log(patch + 8.0)
    return cv2.GaussianBlur(logs, (0, 0), _FINE_CELLS) - cv2.GaussianBlur(logs, (0, 0), _COARSE_CELLS)


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """Comparison of two patches: correlation ``at_defect`` and ``around`` it (NaN without texture), contrast of the
    defect's cells then and now, in log grey values, and the shift in m that aligned them."""

    at_defect: float
    around: float
    contrast_then: float
    contrast_now: float
    shift_m: tuple[float, float]


def compare_patches(then: Detail, now: Detail, grid: PatchGrid, tolerance_m: float) -> Look:
    """Align ``now`` with ``then`` within the tolerance and correlate."""
    reach = max(1, int(round(tolerance_m / grid.cell_m)))
    h, w = then.shape
    reach = min(reach, (h - 9) // 2, (w - 9) // 2)
    inner = (slice(reach, h - reach), slice(reach, w - reach))
    scores = cv2.matchTemplate(now, then[inner], cv2.TM_CCOEFF_NORMED)
    dy, dx = np.unravel_index(int(np.argmax(scores)), scores.shape)
    moved = now[dy : dy + h - 2 * reach, dx : dx + w - 2 * reach]
    first, mask = then[inner], grid.defect[inner]
    return Look(
        at_defect=_correlate(first, moved, mask),
        around=_correlate(first, moved, ~mask),
        contrast_then=float(first[mask].std()),
        contrast_now=float(moved[mask].std()),
        shift_m=(float(dx - reach) * grid.cell_m, float(reach - dy) * grid.cell_m),
    )


def _correlate(first: Detail, second: Detail, mask: BoolArray) -> float:
    a, b = first[mask] - first[mask].mean(), second[mask] - second[mask].mean()
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b / scale) if scale > 1e-9 and mask.sum() > 30 else np.nan
