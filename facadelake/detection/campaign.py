"""A detector run on a campaign's photographs, in the regions that show the building."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pyarrow as pa
import shapely

from facadelake.core.arrays import BoolArray, UInt8Image
from facadelake.core.progress import track
from facadelake.core.tables import table_from_rows
from facadelake.detection.boxes import clip_box
from facadelake.detection.crosswalk import Crosswalk, build_crosswalk
from facadelake.detection.inference.detector import DetectedBox, OnnxDetector
from facadelake.detection.inference.photograph import read_photograph
from facadelake.detection.tiling.tiled_detection import detect_image
from schemas.vocabulary import DetectionOutcome, PhotoOutcome

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchRegion:
    """Where in a photograph the detector searches, and at which scale.

    ``gsd_mm``: ground sampling distance of the photograph in millimetres, None where unknown. ``target``: a mask (h, w)
    of any size that covers the whole photograph, true where the building is; None: the whole photograph.
    ``remark``: what is unknown and why; it becomes the reason of every row.
    """

    gsd_mm: float | None = None
    target: BoolArray | None = None
    remark: str = ""


def detect_photographs(
    photos: pa.Table,
    root: Path,
    detector: OnnxDetector,
    *,
    class_names: Mapping[str, str] = MappingProxyType({}),
    find_region: Callable[[str], SearchRegion] = lambda photo_id: SearchRegion(),
    workers: int = 1,
) -> pa.Table:
    """Run a detector on the accepted photographs of a campaign.

    A photograph that cannot be read has no detections; a warning names it. Two photographs are in memory at a time: the
    next one is read while the detector processes one.

    Args:
        photos: Table ``photos``.
        root: Folder that ``photo_id`` is relative to.
        detector: The detector.
        class_names: The model's class name -> defect class; overrides the card's classes and the built-in crosswalk.
        find_region: Gives the search region of a photo_id.
        workers: Number of batches of tiles processed at once, as in ``detect_image``.

    Returns:
        Table ``detections``. Boxes are in pixels of the photograph as stored (the EXIF orientation is not applied, as
        in the reconstruction); (0, 0) is the corner of the first pixel.

    Raises:
        InputDataError: ``class_names`` names a defect class that does not exist.
        ModelError: The model gives a class that its card does not name.
    """
    crosswalk = build_crosswalk(detector.card.classes, class_names)
    accepted = [
        row["photo_id"]
        for row in photos.select(["photo_id", "photo_outcome"]).to_pylist()
        if row["photo_outcome"] == PhotoOutcome.ACCEPTED
    ]
    rows: list[dict[str, Any]] = []
    for photo_id, image in track(_read_ahead(root, accepted), label="Detecting", total=len(accepted)):
        if image is None:
            _log.warning("%s cannot be read: the detector did not process it", photo_id)
            continue
        region = find_region(photo_id)
        boxes = detect_image(detector, image, gsd_mm=region.gsd_mm, target=region.target, workers=workers)
        size_px = (image.shape[1], image.shape[0])
        rows += [
            _build_row(photo_id, size_px, detector, crosswalk, rank, box, region.remark)
            for rank, box in enumerate(boxes, start=1)
        ]
    outcomes = Counter(row["detection_outcome"] for row in rows)
    counts = ", ".join(f"{count} {name}" for name, count in outcomes.items()) or "nothing found"
    _log.info("%s: %d boxes in %d photographs, %s", detector.name, len(rows), len(accepted), counts)
    return table_from_rows("detections", rows)


def _read_ahead(root: Path, photo_ids: Sequence[str]) -> Iterator[tuple[str, UInt8Image | None]]:
    """Each photograph with its photo_id; the next one is read in the background."""
    with ThreadPoolExecutor(1) as reader:
        pending: Future[UInt8Image | None] | None = None
        for photo_id, next_id in zip(photo_ids, [*photo_ids, None][1:], strict=True):
            image = (pending or reader.submit(read_photograph, root / photo_id)).result()
            pending = reader.submit(read_photograph, root / next_id) if next_id is not None else None
            yield photo_id, image


def _build_row(
    photo_id: str,
    size_px: tuple[int, int],
    detector: OnnxDetector,
    crosswalk: Crosswalk,
    rank: int,
    detected: DetectedBox,
    remark: str,
) -> dict[str, Any]:
    width, height = size_px
    clipped = clip_box(detected.box, image_width_px=width, image_height_px=height)
    defect_class = crosswalk.find_defect_class(detected.class_name)
    outcome, remarks = DetectionOutcome.ACCEPTED, [clipped.remark, remark]
    if clipped.inside is None:
        outcome = DetectionOutcome.OUTSIDE_IMAGE
    elif defect_class is None:
        outcome, remarks = DetectionOutcome.UNKNOWN_CLASS, [crosswalk.explain_unknown(detected.class_name)]
    box = clipped.inside or detected.box
    return {
        "detection_id": f"{photo_id}#{rank}",
        "photo_id": photo_id,
        "source_annotation": None,
        "detection_outcome": str(outcome),
        "reason": "; ".join(filter(None, remarks)) or None,
        "defect_class": None if defect_class is None else str(defect_class),
        "source_class": detected.class_name,
        "score": detected.score,
        "box_x_px": box.x_px,
        "box_y_px": box.y_px,
        "box_width_px": box.width_px,
        "box_height_px": box.height_px,
        "mask": None if detected.mask is None else shapely.to_wkt(detected.mask, rounding_precision=2),
        "detector": f"onnx:{detector.name}",
        "detector_sha256": detector.sha256,
    }
