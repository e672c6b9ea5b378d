"""A detector without errors: every dark blob is a crack with the blob's exact box and mask."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import shapely

from facadelake.core.arrays import UInt8Image
from facadelake.detection.boxes import Box
from facadelake.detection.card import ModelCard
from facadelake.detection.inference.detector import DetectedBox


def make_blob_card(input_px: int, gsd_mm: Sequence[float] = ()) -> ModelCard:
    """The card of a model with an input of ``input_px`` x ``input_px``."""
    content: dict[str, Any] = {
        "name": "blobs",
        "licence": "none",
        "class_names": ["crack"],
        "input": {
            "width_px": input_px,
            "height_px": input_px,
            "colour": "bgr",
            "scale": 1.0,
            "resize": "letterbox_corner",
            "gsd_mm": list(gsd_mm),
        },
        "output": {"layout": "yolov8"},
        "score_threshold": 0.3,
    }
    return ModelCard.model_validate(content)


class BlobDetector:
    """Dark blobs (below 128) of each image; ``processed_sizes``: height and width of all images."""

    def __init__(self, input_px: int = 160, *, masks: bool = False, gsd_mm: Sequence[float] = ()) -> None:
        self.card = make_blob_card(input_px, gsd_mm)
        self.processed_sizes: list[tuple[int, int]] = []
        self._masks = masks

    def detect_batch(self, images_bgr: Sequence[UInt8Image]) -> tuple[tuple[DetectedBox, ...], ...]:
        """Every blob of each image, scored by its size."""
        self.processed_sizes += [(image.shape[0], image.shape[1]) for image in images_bgr]
        return tuple(self._detect_blobs(image) for image in images_bgr)

    def _detect_blobs(self, image: UInt8Image) -> tuple[DetectedBox, ...]:
        dark = (image[..., 0] < 128).astype(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(dark, connectivity=8)
        found = []
        for label in range(1, count):
            x, y, width, height, area = (int(value) for value in stats[label])
            mask = None
            if self._masks:
                inside = np.zeros((height, width + 2), dtype=np.int8)
                inside[:, 1:-1] = labels[y : y + height, x : x + width] == label
                rows, starts = np.nonzero(np.diff(inside) == 1)
                _, ends = np.nonzero(np.diff(inside) == -1)
                mask = shapely.union_all(shapely.box(x + starts, y + rows, x + ends, y + rows + 1))
            box = Box(x_px=x, y_px=y, width_px=width, height_px=height)
            found.append(DetectedBox(box=box, score=0.5 + 0.5 * min(1.0, area / 1000), class_name="crack", mask=mask))
        return tuple(found)
