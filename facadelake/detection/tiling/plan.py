"""Tile passes over a photograph: the whole photograph, or overlapping tiles at one or two scales.

A detector finds objects that are as large in its input as in its training data. A model card may state the GSD of the
input; tiles are then sized so that, resized to the model's input, they have that GSD. If the GSD is unknown for card or
photograph, one pass has tiles at the photograph's own resolution for small objects, and one pass has the whole
photograph for large ones. Sliced inference with overlap follows SAHI (Akyon et al. 2022).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray
from facadelake.detection.card import CardInput

# Up to this multiple of the input's size a photograph is one tile: it loses at most half of its resolution.
WHOLE_INPUTS_MAX = 2.0
# Overlap of neighbouring tiles as a fraction of the tile: a smaller object lies whole in one of them.
OVERLAP_RATIO = 0.2
# Limit of enlargement: it adds no information, but photographs slightly coarser than requested keep their pass.
GAIN_MAX = 1.25
# Scales with a smaller ratio are treated as one.
SCALE_RATIO_MIN = 1.5


@dataclass(frozen=True, kw_only=True)
class DetectorTile:
    """A tile of the photograph in whole pixels; ``right`` and ``bottom`` are exclusive."""

    left: int
    top: int
    right: int
    bottom: int


@dataclass(frozen=True, kw_only=True)
class TilePass:
    """All tiles of one scale; ``gain``: pixels of the model's input per pixel of the photograph."""

    gain: float
    tiles: tuple[DetectorTile, ...]


def plan_tile_passes(
    spec: CardInput, *, width_px: int, height_px: int, gsd_mm: float | None = None, target: BoolArray | None = None
) -> tuple[TilePass, ...]:
    """Plan the tile passes over a photograph, finest first.

    Args:
        spec: The model's input.
        width_px: Width of the photograph.
        height_px: Height of the photograph.
        gsd_mm: GSD of the photograph in millimetres; None, or not a positive number, where unknown.
        target: Mask (h, w) of any size that covers the whole photograph, true where to search; None: everywhere.

    Returns:
        The passes; tiles without a pixel of the target are omitted. Empty if the target is empty.
    """
    if target is not None and not target.any():
        return ()
    if gsd_mm is not None and not 0 < gsd_mm < math.inf:
        gsd_mm = None
    whole = TilePass(
        gain=min(spec.width_px / width_px, spec.height_px / height_px),
        tiles=(DetectorTile(left=0, top=0, right=width_px, bottom=height_px),),
    )
    if max(width_px, height_px) <= WHOLE_INPUTS_MAX * max(spec.width_px, spec.height_px):
        return (whole,)
    gains = _plan_gains(spec, gsd_mm)
    passes = [
        _tile_target(spec, gain, width_px, height_px, target) for gain in gains if gain > whole.gain * SCALE_RATIO_MIN
    ]
    if len(passes) < len(gains) or not spec.gsd_mm or gsd_mm is None:
        passes.append(whole)
    return tuple(passes)


def _plan_gains(spec: CardInput, gsd_mm: float | None) -> list[float]:
    """Pixels of the input per pixel of the photograph, largest first, without gains of nearly the same scale."""
    if not spec.gsd_mm or gsd_mm is None:
        return [1.0]
    gains = sorted((min(gsd_mm / input_mm, GAIN_MAX) for input_mm in spec.gsd_mm), reverse=True)
    return [gain for i, gain in enumerate(gains) if i == 0 or gains[i - 1] > gain * SCALE_RATIO_MIN]


def _tile_target(spec: CardInput, gain: float, width_px: int, height_px: int, target: BoolArray | None) -> TilePass:
    """Tiles over the bounding box of the target, without those that contain no pixel of it."""
    tile_width = min(width_px, round(spec.width_px / gain))
    tile_height = min(height_px, round(spec.height_px / gain))
    left, top, right, bottom = (
        (0, 0, width_px, height_px) if target is None else _bound_target(target, width_px, height_px)
    )
    tiles = tuple(
        DetectorTile(left=x, top=y, right=x + tile_width, bottom=y + tile_height)
        for y in _distribute_starts(top, bottom, tile_height, height_px)
        for x in _distribute_starts(left, right, tile_width, width_px)
    )
    return TilePass(gain=gain, tiles=tiles if target is None else _select_tiles(target, tiles, width_px, height_px))


def _distribute_starts(low: int, high: int, tile: int, limit: int) -> list[int]:
    """First pixels of tiles that cover ``low`` to ``high`` evenly, within 0 to ``limit``."""
    if high - low <= tile:
        return [min(max(0, (low + high - tile) // 2), limit - tile)]
    overlap = round(OVERLAP_RATIO * tile)
    count = math.ceil((high - low - overlap) / (tile - overlap))
    return [round(start) for start in np.linspace(low, high - tile, count)]


def _bound_target(target: BoolArray, width_px: int, height_px: int) -> tuple[int, int, int, int]:
    """Bounding box (left, top, right, bottom) of the target, in pixels of the photograph."""
    rows, columns = np.flatnonzero(target.any(axis=1)), np.flatnonzero(target.any(axis=0))
    across, down = width_px / target.shape[1], height_px / target.shape[0]
    return (
        math.floor(columns[0] * across),
        math.floor(rows[0] * down),
        min(width_px, math.ceil((columns[-1] + 1) * across)),
        min(height_px, math.ceil((rows[-1] + 1) * down)),
    )


def _select_tiles(
    target: BoolArray, tiles: tuple[DetectorTile, ...], width_px: int, height_px: int
) -> tuple[DetectorTile, ...]:
    """The tiles that contain at least one pixel of the target."""
    height, width = target.shape
    sums = cv2.integral(target.astype(np.uint8))
    kept = []
    for tile in tiles:
        left, right = tile.left * width // width_px, math.ceil(tile.right * width / width_px)
        top, bottom = tile.top * height // height_px, math.ceil(tile.bottom * height / height_px)
        if sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left] > 0:
            kept.append(tile)
    return tuple(kept)
