"""Dark lines in a picture, and the crack's main line: the path of most darkness through a box, or along a mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter1d
from skimage.graph import MCP_Geometric
from skimage.measure import block_reduce

from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, Int64Array

_SCALES_PX = (0.8, 1.2, 1.8, 2.7, 4.0, 6.0, 9.0, 13.5)
_WIDTH_PER_SIGMA = 2.0  # sigma**2 times the second derivative of a bar is largest where sigma is half its width
_GAMMA = 1.5  # instead of 2: of two lines equally dark the narrower is the crack, the wider a course of bricks
_MIN_LENGTH_PER_SIGMA = 20.0  # a crack is this many times longer than its ridge's scale, or more


@dataclass(frozen=True, kw_only=True, eq=False)
class Ridges:
    """``strength`` (h, w): curvature across the darkest line through a pixel, over the scales; ``width_px`` (h, w)."""

    strength: Float32Array
    width_px: Float32Array


def detect_dark_ridges(coded: Float32Array, length_px: float) -> Ridges:
    """Ridges of darkness in brightness (h, w) from the Hessian at the scales of a crack about ``length_px`` long.

    A blob bends both ways: what it bends along the line is taken off. Sources: Lindeberg, "Edge Detection and Ridge
    Detection with Automatic Scale Selection", IJCV 1998; Frangi et al., MICCAI 1998.
    """
    strength, width = np.zeros_like(coded), np.full_like(coded, _WIDTH_PER_SIGMA * _SCALES_PX[0])
    for scale in _SCALES_PX:
        if scale > max(length_px / _MIN_LENGTH_PER_SIGMA, _SCALES_PX[1]):
            break
        smooth = cv2.GaussianBlur(coded, (0, 0), sigmaX=scale, borderType=cv2.BORDER_REFLECT)
        found = _compute_ridge_strength(np.asarray(smooth, dtype=np.float32)) * np.float32(scale**_GAMMA)
        better = found > strength
        strength[better] = found[better]
        width[better] = _WIDTH_PER_SIGMA * scale
    return Ridges(strength=strength, width_px=width)


def _compute_ridge_strength(smooth: Float32Array) -> Float32Array:
    xx = cv2.filter2D(smooth, -1, np.array([[1, -2, 1]], dtype=np.float32), borderType=cv2.BORDER_REFLECT)
    yy = cv2.filter2D(smooth, -1, np.array([[1], [-2], [1]], dtype=np.float32), borderType=cv2.BORDER_REFLECT)
    corner = np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 1]], dtype=np.float32) / 4
    xy = cv2.filter2D(smooth, -1, corner, borderType=cv2.BORDER_REFLECT)
    mean, away = (xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    most, least = mean + away, np.abs(mean - away)
    return np.asarray(np.maximum(most - least, 0), dtype=np.float32)


_MAX_SEARCH_PIXELS = (
    200_000  # of a path search; a larger box is searched on the strongest ridge of each block of pixels
)
_COST_OFFSET = (
    0.03  # cost of a pixel is 1 / (this + strength), so that a gap of some pixels is cheaper than a way round
)
_MAX_ASPECT_BOTH_WAYS = 2.5  # a box longer than this many times its width is crossed along its length alone
_MIN_END_STRENGTH = 0.3  # of the line's usual strength: its ends are cut off up to where it is stronger
_STRENGTH_SMOOTHING_PX = 4.0
_MIN_LENGTH_PX = 8.0
_OFF_MASK_COST = 10.0  # a pixel beside the mask costs this many times more: bridges between a mask's parts


@dataclass(frozen=True, kw_only=True, eq=False)
class Centreline:
    """Points (k, 2: column, row; 0 the centre of the first pixel) about 1 px apart, and the ridge's width (k,), px."""

    xy: Float64Array
    width_px: Float64Array

    @property
    def length_px(self) -> float:
        """Its length."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum())


def trace_through_box(ridges: Ridges, inside: BoolArray) -> Centreline | None:
    """The strongest line from side to side of the rectangle ``inside`` (h, w), cut to where it shows, or None."""
    cost, block = _compute_costs(ridges, inside)
    rows, columns = np.nonzero(np.isfinite(cost))
    if len(rows) == 0:
        return None
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    high, wide = bottom - top + 1, right - left + 1
    candidates = []
    if high * _MAX_ASPECT_BOTH_WAYS >= wide:
        across = np.arange(left, right + 1)
        candidates.append(_find_cheapest_path(cost, [(top, c) for c in across], [(bottom, c) for c in across]))
    if wide * _MAX_ASPECT_BOTH_WAYS >= high:
        down = np.arange(top, bottom + 1)
        candidates.append(_find_cheapest_path(cost, [(r, left) for r in down], [(r, right) for r in down]))
    lines = [_trim_ends(path, ridges, block) for path in candidates]
    found = [(strength, line) for strength, line in lines if line is not None]
    return max(found, key=lambda one: one[0])[1] if found else None


def trace_along_mask(ridges: Ridges, mask: BoolArray) -> Centreline | None:
    """The longest way through a mask (h, w), where it is darkest; gaps between its parts are bridged."""
    cost, block = _compute_costs(ridges, np.ones_like(mask))
    inside = block_reduce(mask, (block, block), np.max) if block > 1 else mask
    spots = np.argwhere(inside)
    if len(spots) < 2:
        return None
    plain = np.where(inside, 1.0, _OFF_MASK_COST)
    start = _find_farthest(plain, spots, spots[0])
    end = _find_farthest(plain, spots, start)
    near = binary_dilation(inside, iterations=1)
    path = _find_cheapest_path(np.where(near, cost, _OFF_MASK_COST * np.nanmax(cost)), [tuple(start)], [tuple(end)])
    return _smooth_path(path, ridges, block)


def _compute_costs(ridges: Ridges, inside: BoolArray) -> tuple[Float64Array, int]:
    """Cost of a path by pixel or block of pixels (infinite outside), and the block's side."""
    block = max(1, int(np.ceil(np.sqrt(np.count_nonzero(inside) / _MAX_SEARCH_PIXELS))))
    strength = ridges.strength
    usual = max(float(np.percentile(strength[inside], 98)) if inside.any() else 0.0, 1e-6)
    if block > 1:
        strength = block_reduce(strength, (block, block), np.max)
        inside = block_reduce(inside, (block, block), np.min, cval=True)  # a picture's last blocks may be cut
    cost = 1 / (_COST_OFFSET + np.minimum(strength / usual, 1.0))
    return np.where(inside, cost, np.inf), block


def _find_cheapest_path(cost: Float64Array, starts: list[tuple[int, int]], ends: list[tuple[int, int]]) -> Float64Array:
    """The cheapest path (k, 2: column, row) from any of ``starts`` to any of ``ends``."""
    search = MCP_Geometric(np.where(np.isfinite(cost), cost, -1.0))
    total, _ = search.find_costs([s for s in starts if np.isfinite(cost[s])], [e for e in ends if np.isfinite(cost[e])])
    reached = min((end for end in ends), key=lambda end: total[end])
    return np.asarray(search.traceback(reached), dtype=np.float64)[:, ::-1]


def _find_farthest(plain: Float64Array, spots: Int64Array, start: Int64Array) -> Int64Array:
    total, _ = MCP_Geometric(plain).find_costs([tuple(start)])
    found: Int64Array = spots[int(np.argmax(total[spots[:, 0], spots[:, 1]]))]
    return found


def _trim_ends(path: Float64Array, ridges: Ridges, block: int) -> tuple[float, Centreline | None]:
    """The path without its ends that show no line, and the strength that it gathers."""
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


def _smooth_path(path: Float64Array, ridges: Ridges, block: int) -> Centreline | None:
    """A path of blocks as a smooth line in pixels, its points evenly spaced."""
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


def resample_evenly(xy: Float64Array) -> Float64Array:
    """The line (n, 2) as points (k, 2) about 1 px apart."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    wanted = np.linspace(0.0, along[-1], max(2, round(along[-1]) + 1))
    return np.column_stack([np.interp(wanted, along, xy[:, axis]) for axis in (0, 1)])


def _sample_maximum(field: Float32Array, xy: Float64Array, block: int) -> Float64Array:
    """Largest value (k,) of a field about points (k, 2), within the block that the path was found in."""
    column, row = np.round(xy).astype(np.int64).T
    reach = np.arange(-(block // 2) - 1, block // 2 + 2)
    dy, dx = (grid.ravel() for grid in np.meshgrid(reach, reach))
    rows = np.clip(row[:, None] + dy, 0, field.shape[0] - 1)
    columns = np.clip(column[:, None] + dx, 0, field.shape[1] - 1)
    return np.asarray(field[rows, columns].max(axis=1), dtype=np.float64)
