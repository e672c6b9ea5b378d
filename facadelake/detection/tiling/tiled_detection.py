"""A photograph of any size looked at by a detector: the one way, in the pipeline and wherever detectors are judged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Protocol

from shapely.affinity import translate

from facadelake.core.arrays import BoolArray, UInt8Image
from facadelake.detection.boxes import Box
from facadelake.detection.card import ModelCard
from facadelake.detection.inference.detector import DetectedBox
from facadelake.detection.tiling.plan import DetectorTile, TilePass, plan_tile_passes
from facadelake.detection.tiling.scale_merging import merge_scales
from facadelake.detection.tiling.tile_merging import TileDetection, merge_tile_detections

TILES_PER_BATCH = 4  # tiles a call


class Detector(Protocol):
    """What looks at one tile or several."""

    @property
    def card(self) -> ModelCard:
        """How the model sees."""

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        """What each image shows."""


def detect_image(
    detector: Detector,
    image_bgr: UInt8Image,
    *,
    gsd_mm: float | None = None,
    target: BoolArray | None = None,
    workers: int = 1,
) -> tuple[DetectedBox, ...]:
    """What ``detector`` finds in a photograph (h, w, 3: blue, green, red) of any size, best first.

    ``gsd_mm``: millimetres on the facade a pixel of the photograph; None: unknown. ``target``: a mask of any size that
    lies over the whole photograph, true where something is to be found; None: everywhere. ``workers`` tiles are looked
    at at once, which pays with a detector of one thread.

    Boxes and masks are in pixels of the photograph, and may stick out of it. What a tile's border cut is put together
    again (``seams``), what two scales show is told once (``scales``).
    """
    height, width = image_bgr.shape[:2]
    spec = detector.card.input
    looks = plan_tile_passes(spec, width_px=width, height_px=height, gsd_mm=gsd_mm, target=target)
    nms_iou = detector.card.nms_iou
    found: tuple[DetectedBox, ...] = ()
    for look in looks:
        parts = _detect_tiles(detector, image_bgr, look, workers)
        one = tuple(part.detection for part in parts)
        if len(look.tiles) > 1:
            one = merge_tile_detections(parts, look, width_px=width, height_px=height, nms_iou=nms_iou)
        found = merge_scales(found, one, nms_iou=nms_iou) if found else one
    return tuple(sorted(found, key=lambda one: -one.score))


def _detect_tiles(detector: Detector, image_bgr: UInt8Image, look: TilePass, workers: int) -> list[TileDetection]:
    """What the look's tiles show, in pixels of the photograph."""

    def see(tiles: Sequence[DetectorTile]) -> list[TileDetection]:
        crops = [image_bgr[tile.top : tile.bottom, tile.left : tile.right] for tile in tiles]
        seen = detector.detect_batch(crops)
        return [
            TileDetection(tile=tile, detection=_shift_detection(one, tile))
            for tile, all_of_it in zip(tiles, seen, strict=True)
            for one in all_of_it
        ]

    batches = list(_split_batches(look.tiles))
    if workers == 1 or len(batches) == 1:
        return [part for batch in batches for part in see(batch)]
    with ThreadPoolExecutor(workers) as pool:
        return [part for parts in pool.map(see, batches) for part in parts]


def _split_batches(tiles: Sequence[DetectorTile]) -> Iterator[Sequence[DetectorTile]]:
    for start in range(0, len(tiles), TILES_PER_BATCH):
        yield tiles[start : start + TILES_PER_BATCH]


def _shift_detection(found: DetectedBox, tile: DetectorTile) -> DetectedBox:
    """``detection`` in pixels of the photograph instead of the tile's."""
    if tile.left == tile.top == 0:
        return found
    box = Box(
        x_px=found.box.x_px + tile.left,
        y_px=found.box.y_px + tile.top,
        width_px=found.box.width_px,
        height_px=found.box.height_px,
    )
    mask = None if found.mask is None else translate(found.mask, tile.left, tile.top)
    return replace(found, box=box, mask=mask)
