"""Dark ridges of an image, and the centreline of a crack: the minimal path through its box or along its mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter1d
from skimage.graph import MCP_Geometric
from skimage.measure import block_reduce

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, Float64N, Float64Nx2, Int64Array

_SCALES_PX = (0.8, 1.2, 1.8, 2.7, 4.0, 6.0, 9.0, 13.5)
_WIDTH_PER_SIGMA = 2.0  # sigma**2 times the second derivative of a slit is largest where sigma is half its width
# Exponent of scale normalisation, less than 2: of two equally dark lines the narrower is the crack, and the wider a
# course of bricks.
_GAMMA = 1.5
_MIN_LENGTH_PER_SIGMA = 20.0  # minimum length of a crack in units of the scale of its ridge
_MAX_SEARCH_PIXELS = 200_000  # of a path search; a larger box is reduced to the strongest ridge of each block of pixels
_COST_OFFSET = 0.03  # cost of a pixel is 1 / (offset + strength), so that a short gap is cheaper than a detour
_MAX_ASPECT_BOTH_WAYS = 2.5  # boxes with a larger aspect ratio are crossed along their longer side only
_MIN_END_STRENGTH = 0.3  # relative to the strength of the line; its weaker ends are cut off
_STRENGTH_SMOOTHING_PX = 4.0
_MIN_LENGTH_PX = 8.0
_OFF_MASK_COST = 10.0  # cost factor of pixels outside the mask, for gaps between its parts


@dataclass(frozen=True, kw_only=True, eq=False)
class Ridges:
    """Ridge strength (h, w), the largest curvature across a dark line over all scales, and its ``width_px`` (h, w)."""

    strength: Float32Array
    width_px: Float32Array


def detect_dark_ridges(grey: Float32Array, length_px: float) -> Ridges:
    """Detect dark ridges in luma (h, w) by the Hessian, at the scales of a crack about ``length_px`` long.

    The curvature along the line is subtracted, since a blob is curved in both directions.
    Sources: Lindeberg, "Edge Detection and Ridge Detection with Automatic Scale Selection", IJCV 1998; Frangi et al.,
    MICCAI 1998.
    """
    strength, width = np.zeros_like(grey), np.full_like(grey, _WIDTH_PER_SIGMA * _SCALES_PX[0])
    for scale in _SCALES_PX:
        if scale > max(length_px / _MIN_LENGTH_PER_SIGMA, _SCALES_PX[1]):
            break
        smooth = cv2.GaussianBlur(grey, (0, 0), sigmaX=scale, borderType=cv2.BORDER_REFLECT)
        at_scale = _compute_ridge_strength(np.asarray(smooth, dtype=np.float32)) * np.float32(scale**_GAMMA)
        stronger = at_scale > strength
        strength[stronger] = at_scale[stronger]
        width[stronger] = _WIDTH_PER_SIGMA * scale
    return Ridges(strength=strength, width_px=width)


def _compute_ridge_strength(smooth: Float32Array) -> Float32Array:
    """Curvature across a dark line minus curvature along it (h, w), from the eigenvalues of the Hessian."""
    xx = cv2.filter2D(smooth, -1, np.array([[1, -2, 1]], dtype=np.float32), borderType=cv2.BORDER_REFLECT)
    yy = cv2.filter2D(smooth, -1, np.array([[1], [-2], [1]], dtype=np.float32), borderType=cv2.BORDER_REFLECT)
    corner = np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 1]], dtype=np.float32) / 4
    xy = cv2.filter2D(smooth, -1, corner, borderType=cv2.BORDER_REFLECT)
    mean, deviation = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    across, along = mean + deviation, np.abs(mean - deviation)
    return np.asarray(np.maximum(across - along, 0), dtype=np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Centreline:
    """Points (k, 2: column, row; 0 is the centre of the first pixel) about 1 px apart, and ridge widths (k,), px."""

    xy: Float64Nx2
    width_px: Float64N

    @property
    def length_px(self) -> float:
        """Length of the line, px."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum())


def trace_through_box(ridges: Ridges, inside: BoolArray) -> Centreline | None:
    """The strongest line between opposite sides of the rectangle ``inside`` (h, w), without its weak ends, or None."""
    cost, block = _compute_costs(ridges, inside)
    rows, columns = np.nonzero(np.isfinite(cost))
    if len(rows) == 0:
        return None
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    height, width = bottom - top + 1, right - left + 1
    candidates = []
    if height * _MAX_ASPECT_BOTH_WAYS >= width:
        across = np.arange(left, right + 1)
        candidates.append(_find_cheapest_path(cost, [(top, c) for c in across], [(bottom, c) for c in across]))
    if width * _MAX_ASPECT_BOTH_WAYS >= height:
        down = np.arange(top, bottom + 1)
        candidates.append(_find_cheapest_path(cost, [(r, left) for r in down], [(r, right) for r in down]))
    lines = [_trim_ends(path, ridges, block) for path in candidates]
    traced = [(strength, line) for strength, line in lines if line is not None]
    return max(traced, key=lambda candidate: candidate[0])[1] if traced else None


def trace_along_mask(ridges: Ridges, mask: BoolArray) -> Centreline | None:
    """The darkest path between the two ends of a mask (h, w); gaps between its parts are bridged."""
    cost, block = _compute_costs(ridges, np.ones_like(mask))
    inside = block_reduce(mask, (block, block), np.max) if block > 1 else mask
    pixels = np.argwhere(inside)
    if len(pixels) < 2:
        return None
    uniform = np.where(inside, 1.0, _OFF_MASK_COST)
    start = _find_farthest(uniform, pixels, pixels[0])
    end = _find_farthest(uniform, pixels, start)
    near = binary_dilation(inside, iterations=1)
    path = _find_cheapest_path(np.where(near, cost, _OFF_MASK_COST * np.nanmax(cost)), [tuple(start)], [tuple(end)])
    return _smooth_path(path, ridges, block)


def _compute_costs(ridges: Ridges, inside: BoolArray) -> tuple[Float64Array, int]:
    """Cost of a path per pixel or block of pixels (infinite outside), and the side of the block."""
    block = max(1, int(np.ceil(np.sqrt(np.count_nonzero(inside) / _MAX_SEARCH_PIXELS))))
    strength = ridges.strength
    reference = max(float(np.percentile(strength[inside], 98)) if inside.any() else 0.0, 1e-6)
    if block > 1:
        strength = block_reduce(strength, (block, block), np.max)
        # cval: the last blocks of an image may be incomplete.
        inside = block_reduce(inside, (block, block), np.min, cval=True)
    cost = 1 / (_COST_OFFSET + np.minimum(strength / reference, 1.0))
    return np.where(inside, cost, np.inf), block


def _find_cheapest_path(cost: Float64Array, starts: list[tuple[int, int]], ends: list[tuple[int, int]]) -> Float64Nx2:
    """The cheapest path (k, 2: column, row) from any of ``starts`` to any of ``ends``."""
    search = MCP_Geometric(np.where(np.isfinite(cost), cost, -1.0))
    total, _ = search.find_costs([s for s in starts if np.isfinite(cost[s])], [e for e in ends if np.isfinite(cost[e])])
    reached = min((end for end in ends), key=lambda end: total[end])
    return np.asarray(search.traceback(reached), dtype=np.float64)[:, ::-1]


def _find_farthest(cost: Float64Array, pixels: Int64Array, start: Int64Array) -> Int64Array:
    """The pixel (2,) of ``pixels`` (n, 2: row, column) with the most expensive path from ``start``."""
    total, _ = MCP_Geometric(cost).find_costs([tuple(start)])
    farthest: Int64Array = pixels[int(np.argmax(total[pixels[:, 0], pixels[:, 1]]))]
    return farthest


def _trim_ends(path: Float64Nx2, ridges: Ridges, block: int) -> tuple[float, Centreline | None]:
    """The sum of the ridge strength along the path, and the line without its weak ends; None where it is too short."""
    line = _smooth_path(path, ridges, block)
    if line is None:
        return 0.0, None
    strength = gaussian_filter1d(_sample_maximum(ridges.strength, line.xy, block), _STRENGTH_SMOOTHING_PX)
    strong = np.flatnonzero(strength > _MIN_END_STRENGTH * np.percentile(strength, 70))
    if len(strong) == 0:
        return 0.0, None
    kept = slice(strong[0], strong[-1] + 1)
    cut = Centreline(xy=line.xy[kept], width_px=line.width_px[kept])
    return float(strength[kept].sum()), cut if cut.length_px >= _MIN_LENGTH_PX else None


def _smooth_path(path: Float64Nx2, ridges: Ridges, block: int) -> Centreline | None:
    """The smoothed line in pixels of a path (k, 2) of blocks, its points evenly spaced; None where it is too short."""
    xy = path * block + (block - 1) / 2
    if len(xy) < 3:
        return None
    xy = gaussian_filter1d(xy, 2.0, axis=0, mode="nearest")
    line = resample_evenly(xy)
    return (
        Centreline(xy=line, width_px=_sample_maximum(ridges.width_px, line, block))
        if len(line) >= _MIN_LENGTH_PX
        else None
    )


def resample_evenly(xy: Float64Nx2) -> Float64Nx2:
    """Resample a line (n, 2) to points (k, 2) about 1 px apart."""
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    regular = np.linspace(0.0, distance[-1], max(2, round(distance[-1]) + 1))
    return np.column_stack([np.interp(regular, distance, xy[:, axis]) for axis in (0, 1)])


def _sample_maximum(image: Float32Array, xy: Float64Nx2, block: int) -> Float64N:
    """Largest value (k,) of an image (h, w) around points (k, 2), within the block size of the path search."""
    column, row = np.round(xy).astype(np.int64).T
    reach = np.arange(-(block // 2) - 1, block // 2 + 2)
    dy, dx = (grid.ravel() for grid in np.meshgrid(reach, reach))
    rows = np.clip(row[:, None] + dy, 0, image.shape[0] - 1)
    columns = np.clip(column[:, None] + dx, 0, image.shape[1] - 1)
    return np.asarray(image[rows, columns].max(axis=1), dtype=np.float64)
