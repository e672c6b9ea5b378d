"""A detector run over a campaign's photographs, one in memory at a time."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import pyarrow as pa

from facadelake.detect.boxes import clip_box
from facadelake.detect.crosswalk import Crosswalk, crosswalk_with
from facadelake.detect.detector import Found, OnnxDetector, load_detector
from facadelake.detect.letterbox import Image
from facadelake.progress import track
from facadelake.tables import table_of_rows
from schemas.vocabulary import DetectionOutcome, PhotoOutcome

__all__ = ["OnnxDetector", "detect_photographs", "load_detector"]

_log = logging.getLogger(__name__)


def detect_photographs(
    photos: pa.Table, root: Path, detector: OnnxDetector, *, class_names: Mapping[str, str] = MappingProxyType({})
) -> pa.Table:
    """What ``detector`` finds in the accepted photographs, as table ``detections``.

    ``photos`` is table ``photos``, ``photo_id`` a path below ``root``; ``class_names`` (the model's class name ->
    defect class) goes over the built-in crosswalk. Boxes are pixels of the photograph as stored (EXIF's orientation
    is not applied, as in reconstruction); (0, 0) is the corner of the first pixel. The whole photograph is shrunk to
    the model's input, so what is smaller than a few of its pixels is not found (no tiling yet).
    A photograph that cannot be read has no detections; a warning names it.
    """
    crosswalk = crosswalk_with(detector.card.classes, class_names)
    accepted = [
        row["photo_id"]
        for row in photos.select(["photo_id", "photo_outcome"]).to_pylist()
        if row["photo_outcome"] == PhotoOutcome.ACCEPTED
    ]
    rows: list[dict[str, Any]] = []
    for photo_id in track(accepted, label="Detecting"):
        image = _read(root / photo_id)
        if image is None:
            _log.warning("%s cannot be read: nothing was looked for in it", photo_id)
            continue
        found = detector.detect(image)
        rows += [_row(photo_id, image, detector, crosswalk, i, one) for i, one in enumerate(found, start=1)]
    outcomes = Counter(row["detection_outcome"] for row in rows)
    counts = ", ".join(f"{count} {name}" for name, count in outcomes.items())
    _log.info("%s: %d boxes in %d photographs, %s", detector.name, len(rows), len(accepted), counts)
    return table_of_rows("detections", rows)


def _read(path: Path) -> Image | None:
    """The photograph (h, w, 3: blue, green, red), or None where it cannot be decoded."""
    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:  # a size beyond OpenCV's limit
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


def _row(
    photo_id: str, image: Image, detector: OnnxDetector, crosswalk: Crosswalk, rank: int, found: Found
) -> dict[str, Any]:
    height, width = image.shape[:2]
    clipped = clip_box(found.box, image_width_px=width, image_height_px=height)
    defect_class = crosswalk.defect_class(found.class_name)
    outcome, reason = DetectionOutcome.ACCEPTED, clipped.remark or None
    if clipped.inside is None:
        outcome = DetectionOutcome.OUTSIDE_IMAGE
    elif defect_class is None:
        outcome, reason = DetectionOutcome.UNKNOWN_CLASS, crosswalk.why_unknown(found.class_name)
    box = clipped.inside or found.box
    return {
        "detection_id": f"{photo_id}#{rank}",
        "photo_id": photo_id,
        "source_annotation": None,
        "detection_outcome": str(outcome),
        "reason": reason,
        "defect_class": None if defect_class is None else str(defect_class),
        "source_class": found.class_name,
        "score": found.score,
        "box_x_px": box.x_px,
        "box_y_px": box.y_px,
        "box_width_px": box.width_px,
        "box_height_px": box.height_px,
        "detector": f"onnx:{detector.name}",
        "detector_sha256": detector.sha256,
    }
