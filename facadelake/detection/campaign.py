"""A detector run over a campaign's photographs, where the poses say the building is."""

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


def detect_photographs(
    photos: pa.Table,
    root: Path,
    detector: OnnxDetector,
    *,
    class_names: Mapping[str, str] = MappingProxyType({}),
    view_of: Callable[[str], SearchRegion] = lambda photo_id: SearchRegion(),
    workers: int = 1,
) -> pa.Table:
    """What ``detector`` finds in the accepted photographs, as table ``detections``.

    ``photos`` is table ``photos``, ``photo_id`` a path below ``root``; ``class_names`` (the model's class name ->
    defect class) goes over the card's and the built-in crosswalk. ``view_of`` says of a photo_id what is known of the
    photograph; ``workers`` as in ``detect_image``. Boxes are pixels of the photograph as stored (EXIF's orientation is
    not applied, as in reconstruction); (0, 0) is the corner of the first pixel.
    A photograph that cannot be read has no detections; a warning names it. Two are in memory at a time: the next is
    read while one is looked at.
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
            _log.warning("%s cannot be read: nothing was looked for in it", photo_id)
            continue
        view = view_of(photo_id)
        found = detect_image(detector, image, gsd_mm=view.gsd_mm, target=view.target, workers=workers)
        size = (image.shape[1], image.shape[0])
        rows += [
            _build_row(photo_id, size, detector, crosswalk, i, one, view.remark) for i, one in enumerate(found, start=1)
        ]
    outcomes = Counter(row["detection_outcome"] for row in rows)
    counts = ", ".join(f"{count} {name}" for name, count in outcomes.items()) or "nothing found"
    _log.info("%s: %d boxes in %d photographs, %s", detector.name, len(rows), len(accepted), counts)
    return table_from_rows("detections", rows)


def _read_ahead(root: Path, photo_ids: Sequence[str]) -> Iterator[tuple[str, UInt8Image | None]]:
    """Each photograph, the next one being read meanwhile."""
    with ThreadPoolExecutor(1) as reader:
        coming: Future[UInt8Image | None] | None = None
        for photo_id, after in zip(photo_ids, [*photo_ids[1:], None], strict=True):
            image = (coming or reader.submit(read_photograph, root / photo_id)).result()
            coming = reader.submit(read_photograph, root / after) if after is not None else None
            yield photo_id, image


def _build_row(
    photo_id: str,
    size_px: tuple[int, int],
    detector: OnnxDetector,
    crosswalk: Crosswalk,
    rank: int,
    found: DetectedBox,
    remark: str,
) -> dict[str, Any]:
    width, height = size_px
    clipped = clip_box(found.box, image_width_px=width, image_height_px=height)
    defect_class = crosswalk.defect_class(found.class_name)
    outcome, remarks = DetectionOutcome.ACCEPTED, [clipped.remark, remark]
    if clipped.inside is None:
        outcome = DetectionOutcome.OUTSIDE_IMAGE
    elif defect_class is None:
        outcome, remarks = DetectionOutcome.UNKNOWN_CLASS, [crosswalk.why_unknown(found.class_name)]
    box = clipped.inside or found.box
    return {
        "detection_id": f"{photo_id}#{rank}",
        "photo_id": photo_id,
        "source_annotation": None,
        "detection_outcome": str(outcome),
        "reason": "; ".join(filter(None, remarks)) or None,
        "defect_class": None if defect_class is None else str(defect_class),
        "source_class": found.class_name,
        "score": found.score,
        "box_x_px": box.x_px,
        "box_y_px": box.y_px,
        "box_width_px": box.width_px,
        "box_height_px": box.height_px,
        "mask": None if found.mask is None else shapely.to_wkt(found.mask, rounding_precision=2),
        "detector": f"onnx:{detector.name}",
        "detector_sha256": detector.sha256,
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchRegion:
    """``gsd_mm``: millimetres on the facade a pixel of the photograph, None where unknown.

    ``target``: a mask of any size that lies over the whole photograph, true where the building is; None: it may be
    anywhere. ``remark`` says what is not known and why, for the rows of what is found.
    """

    gsd_mm: float | None = None
    target: BoolArray | None = None
    remark: str = ""
