"""Where a detector looks in a photograph: the whole of it, or overlapping tiles at one or two scales.

A detector finds what is as large in its input as what it learned from. Its card may say at which sizes of a pixel on
the facade (GSD) it wants to look; the tiles are then cut so that their pixels, brought to the model's input, have that
GSD. Where card or photograph does not say, tiles of the photograph's own pixels show the fine and one look at the whole
shows the coarse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray
from facadelake.detection.card import CardInput

# Up to this many inputs long, a photograph is looked at whole: it loses at most half of its resolution.
WHOLE_INPUTS_MAX = 2.0
# Neighbouring tiles share at least this part of a tile, so that what is smaller lies whole in one of them.
OVERLAP_RATIO = 0.2
# Enlarging shows nothing new; this much spares a tile plan of another scale for a photograph that is nearly right.
GAIN_MAX = 1.25
# Two scales nearer than this factor show the same.
SCALE_RATIO_MIN = 1.5


@dataclass(frozen=True, kw_only=True)
class DetectorTile:
    """A part of the photograph in whole pixels, ``right`` and ``bottom`` not included."""

    left: int
    top: int
    right: int
    bottom: int


@dataclass(frozen=True, kw_only=True)
class TilePass:
    """All tiles of one scale; a pixel of the photograph is ``gain`` pixels of the model's input."""

    gain: float
    tiles: tuple[DetectorTile, ...]


def plan_tile_passes(
    spec: CardInput, *, width_px: int, height_px: int, gsd_mm: float | None = None, target: BoolArray | None = None
) -> tuple[TilePass, ...]:
    """The looks at a photograph of ``width_px`` x ``height_px``, finest first.

    ``gsd_mm``: millimetres on the facade a pixel of the photograph; None, or no positive number, where unknown.
    ``target``: mask of any size that lies over the whole photograph, true where something is to be found; tiles that
    show nothing of it are left out, and where it is empty there is no look at all.
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
    looks = [
        _tile_target(spec, gain, width_px, height_px, target) for gain in gains if gain > whole.gain * SCALE_RATIO_MIN
    ]
    if len(looks) < len(gains) or not spec.gsd_mm or gsd_mm is None:
        looks.append(whole)
    return tuple(looks)


def _plan_gains(spec: CardInput, gsd_mm: float | None) -> list[float]:
    """Pixels of the input a pixel of the photograph, largest first; what is nearly the same once."""
    if not spec.gsd_mm or gsd_mm is None:
        return [1.0]
    wanted = sorted((min(gsd_mm / one, GAIN_MAX) for one in spec.gsd_mm), reverse=True)
    return [gain for i, gain in enumerate(wanted) if i == 0 or wanted[i - 1] > gain * SCALE_RATIO_MIN]


def _tile_target(spec: CardInput, gain: float, width_px: int, height_px: int, target: BoolArray | None) -> TilePass:
    """Tiles over the box around the target, those left out that show nothing of it."""
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
    """Where tiles begin that cover ``low`` to ``high`` evenly and stay within 0 to ``limit``."""
    if high - low <= tile:
        return [min(max(0, (low + high - tile) // 2), limit - tile)]
    overlap = round(OVERLAP_RATIO * tile)
    count = math.ceil((high - low - overlap) / (tile - overlap))
    return [round(start) for start in np.linspace(low, high - tile, count)]


def _bound_target(target: BoolArray, width_px: int, height_px: int) -> tuple[int, int, int, int]:
    """The box (left, top, right, bottom) about the target, in pixels of the photograph."""
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
    """The tiles in which at least a pixel of the target lies."""
    height, width = target.shape
    sums = cv2.integral(target.astype(np.uint8))
    kept = []
    for tile in tiles:
        left, right = tile.left * width // width_px, math.ceil(tile.right * width / width_px)
        top, bottom = tile.top * height // height_px, math.ceil(tile.bottom * height / height_px)
        if sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left] > 0:
            kept.append(tile)
    return tuple(kept)
