"""A detector run on a photograph of any size, in the pipeline and in evaluations."""

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

TILES_PER_BATCH = 4  # images per call of the detector


class Detector(Protocol):
    """A detector of images up to the size of a tile."""

    @property
    def card(self) -> ModelCard:
        """The model card."""

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        """Detections in each image, in its pixels, highest score first."""


def detect_image(
    detector: Detector,
    image_bgr: UInt8Image,
    *,
    gsd_mm: float | None = None,
    target: BoolArray | None = None,
    workers: int = 1,
) -> tuple[DetectedBox, ...]:
    """Detect objects in a photograph of any size, tile by tile and scale by scale.

    Detections cut by a tile's border are merged (``tile_merging``), and so are those of two scales (``scale_merging``).

    Args:
        detector: The detector.
        image_bgr: The photograph (h, w, 3: blue, green, red).
        gsd_mm: GSD of the photograph in millimetres; None where unknown.
        target: Mask (h, w) of any size that covers the whole photograph, true where to search; None: everywhere.
        workers: Number of batches of tiles processed at once; worthwhile for a detector with one thread.

    Returns:
        Detections, highest score first. Boxes and masks are in pixels of the photograph and may extend beyond it.
    """
    height, width = image_bgr.shape[:2]
    spec = detector.card.input
    passes = plan_tile_passes(spec, width_px=width, height_px=height, gsd_mm=gsd_mm, target=target)
    nms_iou = detector.card.nms_iou
    merged: tuple[DetectedBox, ...] = ()
    for tile_pass in passes:
        in_tiles = _detect_tiles(detector, image_bgr, tile_pass, workers)
        detections = tuple(one.detection for one in in_tiles)
        if len(tile_pass.tiles) > 1:
            detections = merge_tile_detections(in_tiles, tile_pass, width_px=width, height_px=height, nms_iou=nms_iou)
        merged = merge_scales(merged, detections, nms_iou=nms_iou) if merged else detections
    return tuple(sorted(merged, key=lambda detection: -detection.score))


def _detect_tiles(detector: Detector, image_bgr: UInt8Image, tile_pass: TilePass, workers: int) -> list[TileDetection]:
    """Detections of all tiles of a pass, in pixels of the photograph."""

    def detect(tiles: Sequence[DetectorTile]) -> list[TileDetection]:
        crops = [image_bgr[tile.top : tile.bottom, tile.left : tile.right] for tile in tiles]
        return [
            TileDetection(tile=tile, detection=_shift_detection(detection, tile))
            for tile, detections in zip(tiles, detector.detect_batch(crops), strict=True)
            for detection in detections
        ]

    batches = list(_split_batches(tile_pass.tiles))
    if workers == 1 or len(batches) == 1:
        return [detection for batch in batches for detection in detect(batch)]
    with ThreadPoolExecutor(workers) as pool:
        return [detection for detections in pool.map(detect, batches) for detection in detections]


def _split_batches(tiles: Sequence[DetectorTile]) -> Iterator[Sequence[DetectorTile]]:
    for start in range(0, len(tiles), TILES_PER_BATCH):
        yield tiles[start : start + TILES_PER_BATCH]


def _shift_detection(detection: DetectedBox, tile: DetectorTile) -> DetectedBox:
    """``detection`` from pixels of the tile to pixels of the photograph."""
    if tile.left == tile.top == 0:
        return detection
    box = Box(
        x_px=detection.box.x_px + tile.left,
        y_px=detection.box.y_px + tile.top,
        width_px=detection.box.width_px,
        height_px=detection.box.height_px,
    )
    mask = None if detection.mask is None else translate(detection.mask, tile.left, tile.top)
    return replace(detection, box=box, mask=mask)
