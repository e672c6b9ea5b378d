"""Crops of photographs around a detection, with its outline; the best one of each defect for the report."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from facadelake.core.arrays import Float64Array, UInt8Image
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.reporting.cards.observations import DefectObservation, DetectionOutline, group_observations
from facadelake.reporting.drawing.labels import label_ids
from facadelake.reporting.drawing.palette import bgr_from_hex, get_class_colour
from facadelake.reporting.drawing.photograph import read_photograph
from facadelake.reporting.inspection import Inspection, PictureSettings

log = logging.getLogger(__name__)

_MARGIN = 1.1  # margin around the box, as a share of its longer side
_MIN_SIDE_PX = 24.0
_JPEG_QUALITY = 82
_WHITE_RIM_PX = 400  # smallest width of a crop whose outline gets a white rim


def write_crops(inspection: Inspection, folder: Path, settings: PictureSettings | None = None) -> dict[str, Path]:
    """Write ``defect_<label>.jpg`` for each defect into ``folder``; returns the paths by defect_id.

    The crop is square, ``thumbnail_px`` wide: the defect's box with a margin, in the best of its photographs that can
    be read. A defect without such a photograph has no crop. Each photograph is read once or twice.
    """
    settings = settings or PictureSettings()
    folder.mkdir(parents=True, exist_ok=True)
    rows = inspection.defects.select(["defect_id", "defect_class"]).to_pylist()
    labels = label_ids([row["defect_id"] for row in rows])
    observations = group_observations(inspection)
    views = {
        row["defect_id"]: [view for view in observations[row["defect_id"]] if view.photo_id in inspection.posed]
        for row in rows
    }
    paths: dict[str, Path] = {}
    unreadable: set[str] = set()
    pending = [row for row in rows if views[row["defect_id"]]]
    while pending:
        by_photo: dict[str, list[tuple[Mapping[str, str], DefectObservation]]] = {}
        for row in pending:
            view = next((view for view in views[row["defect_id"]] if view.photo_id not in unreadable), None)
            if view is not None:
                by_photo.setdefault(view.photo_id, []).append((row, view))
        pending = []
        for photo_id, best_views in track(sorted(by_photo.items()), label="Cropping defects"):
            try:
                pixels = read_photograph(inspection.locate_photograph(photo_id), inspection.posed[photo_id].camera)
            except InputDataError as error:
                log.warning("crops are from the next best photographs: %s", error)
                unreadable.add(photo_id)
                pending += [row for row, _ in best_views]
                continue
            for row, observation in best_views:
                path = folder / f"defect_{format_file_label(labels[row['defect_id']])}.jpg"
                crop = crop_detection(
                    pixels, observation.outline, settings.thumbnail_px, get_class_colour(row["defect_class"])
                )
                cv2.imwrite(str(path), crop, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
                paths[row["defect_id"]] = path
    return paths


def format_file_label(text: str) -> str:
    """The text as a part of a file name that is valid on all systems."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", text)


def crop_detection(pixels: UInt8Image, outline: DetectionOutline, size_px: int, colour: str) -> UInt8Image:
    """A square crop (BGR) of a photograph around a detection, with its outline.

    Args:
        pixels: photograph (h, w, 3), RGB.
        outline: outline of the detection.
        size_px: width of the crop.
        colour: colour of the outline, "#rrggbb".
    """
    side = max(outline.width_px, outline.height_px) * (1 + 2 * _MARGIN)
    side = min(max(side, _MIN_SIDE_PX), float(min(pixels.shape[:2])))
    corner = np.clip(outline.centre_px - side / 2, 0, np.array([pixels.shape[1], pixels.shape[0]]) - side)
    left, top = np.floor(corner).astype(int)
    region = pixels[top : top + int(side), left : left + int(side), ::-1]
    scale = size_px / region.shape[0]
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    crop = np.ascontiguousarray(cv2.resize(region, (size_px, size_px), interpolation=method), dtype=np.uint8)
    draw_outline(crop, outline, np.array([left, top]), scale, colour)
    return crop


def draw_outline(
    picture: UInt8Image, outline: DetectionOutline, corner_px: Float64Array, scale: float, colour: str
) -> None:
    """Draw the mask of a detection, else its box, on a crop of its photograph.

    Args:
        picture: crop (h, w, 3), BGR; changed in place.
        outline: outline of the detection.
        corner_px: upper left corner (2,) of the crop in the photograph, pixels.
        scale: scale of the crop.
        colour: colour of the outline, "#rrggbb".
    """
    first = np.array([outline.left_px, outline.top_px])
    size = np.array([outline.width_px, outline.height_px])
    box = first + size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    rings = [np.round((ring - corner_px) * scale).astype(np.int32) for ring in (outline.rings_px or (box,))]
    if max(picture.shape[:2]) >= _WHITE_RIM_PX:
        cv2.polylines(picture, rings, True, (255, 255, 255), 4, cv2.LINE_AA)
    cv2.polylines(picture, rings, True, bgr_from_hex(colour), 2, cv2.LINE_AA)
