"""Each defect as its best photograph shows it: small crops for the report."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from facadelake.errors import InputDataError
from facadelake.pictures.inspection import Inspection, PictureSettings
from facadelake.pictures.palette import bgr_of, class_colour, short_ids
from facadelake.pictures.photofile import read_photograph
from facadelake.pictures.relief import Picture
from facadelake.progress import track

log = logging.getLogger(__name__)

_MARGIN = 1.1  # of the box's longer side, left free around it
_JPEG_QUALITY = 82


def defect_crops(inspection: Inspection, folder: Path, settings: PictureSettings | None = None) -> dict[str, Path]:
    """Write ``defect_<label>.jpg`` for each defect into ``folder``; returns the paths by defect_id.

    The crop is the defect's box in its best photograph with room around it, square, ``thumbnail_px`` wide. A defect
    whose best photograph has no box of it, or cannot be read, has no crop. Photographs are read one by one, once.
    """
    settings = settings or PictureSettings()
    folder.mkdir(parents=True, exist_ok=True)
    labels = short_ids(inspection.defects.column("defect_id").to_pylist())
    by_photo: dict[str, list[tuple[str, str, dict[str, Any]]]] = {}
    best_box = _best_boxes(inspection)
    for row in inspection.defects.to_pylist():
        box = best_box.get(row["defect_id"])
        if box is not None:
            by_photo.setdefault(box["photo_id"], []).append((row["defect_id"], row["defect_class"], box))
    paths: dict[str, Path] = {}
    for photo_id, wanted in track(sorted(by_photo.items()), label="Cutting out defects"):
        if photo_id not in inspection.posed:
            continue
        try:
            pixels = read_photograph(inspection.photograph(photo_id), inspection.posed[photo_id].camera)
        except InputDataError as error:
            log.warning("no crops of its defects: %s", error)
            continue
        for defect_id, defect_class, box in wanted:
            path = folder / f"defect_{re.sub(r'[^A-Za-z0-9_-]', '_', labels[defect_id])}.jpg"
            crop = _crop(pixels, box, settings.thumbnail_px, bgr_of(class_colour(defect_class)))
            cv2.imwrite(str(path), crop, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            paths[defect_id] = path
    return paths


def _best_boxes(inspection: Inspection) -> Mapping[str, dict[str, Any]]:
    """Detection row of each defect in its best photograph (the most confident one where there are several)."""
    detections = {row["detection_id"]: row for row in inspection.detections.to_pylist()}
    best_photo = dict(
        zip(
            inspection.defects.column("defect_id").to_pylist(),
            inspection.defects.column("best_photo_id").to_pylist(),
            strict=True,
        )
    )
    found: dict[str, dict[str, Any]] = {}
    for row in inspection.observations.to_pylist():
        box = detections.get(row["detection_id"])
        if box is None or row["defect_id"] is None or best_photo.get(row["defect_id"]) != row["photo_id"]:
            continue
        known = found.get(row["defect_id"])
        if known is None or box["score"] > known["score"]:
            found[row["defect_id"]] = box
    return found


def _crop(pixels: Picture, box: Mapping[str, Any], size_px: int, colour: tuple[int, int, int]) -> Picture:
    """A square piece (BGR) of the photograph (RGB) round the box, the box's corners marked."""
    side = max(box["box_width_px"], box["box_height_px"]) * (1 + 2 * _MARGIN)
    side = min(max(side, 24.0), float(min(pixels.shape[:2])))
    centre = np.array([box["box_x_px"] + box["box_width_px"] / 2, box["box_y_px"] + box["box_height_px"] / 2])
    corner = np.clip(centre - side / 2, 0, np.array([pixels.shape[1], pixels.shape[0]]) - side)
    left, top = np.floor(corner).astype(int)
    piece = pixels[top : top + int(side), left : left + int(side), ::-1]
    scale = size_px / piece.shape[0]
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    crop = np.ascontiguousarray(cv2.resize(piece, (size_px, size_px), interpolation=method), dtype=np.uint8)
    first = (np.array([box["box_x_px"], box["box_y_px"]]) - (left, top)) * scale
    last = first + np.array([box["box_width_px"], box["box_height_px"]]) * scale
    cv2.rectangle(
        crop, np.round(first).astype(int).tolist(), np.round(last).astype(int).tolist(), colour, 1, cv2.LINE_AA
    )
    return crop
