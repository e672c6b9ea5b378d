"""Photographs with the model's visible edges, the boxes and what became of them: the quickest check of a pose."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.camera import PosedCamera
from facadelake.errors import InputDataError
from facadelake.geobim.surface import Surface
from facadelake.pictures.inspection import Inspection, PictureSettings
from facadelake.pictures.marks import Mark, marks_of
from facadelake.pictures.palette import OTHER_COLOUR, bgr_of, class_colour, outcome_colour
from facadelake.pictures.photofile import decoded, read_photograph
from facadelake.pictures.relief import Picture, edges_of, openings_of
from facadelake.pictures.sight import pixels_of, sees
from facadelake.progress import track

log = logging.getLogger(__name__)

_EDGE_BGR = (255, 255, 0)
# Full colour resolution: lines of one pixel keep their colour.
_JPEG = [
    cv2.IMWRITE_JPEG_QUALITY, 88, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
]  # fmt: skip


def photo_overlays(
    inspection: Inspection,
    surface: Surface,
    photo_ids: Iterable[str],
    folder: Path,
    settings: PictureSettings | None = None,
) -> list[Path]:
    """Write ``overlay_<photo>.jpg`` for each photograph asked for, ``overlay_width_px`` wide.

    Drawn: the model's visible edges (lens distortion kept), boxes coloured by outcome, registered points as crosses,
    defects at real size where the photograph sees them. A photograph without a pose shows its boxes alone; one that
    cannot be read is left out with a warning.
    """
    settings = settings or PictureSettings()
    is_opening = openings_of(inspection.building)
    marks = marks_of(inspection.defects, inspection.building.origin)
    outcome = {row["detection_id"]: row for row in inspection.observations.to_pylist()}
    boxes: dict[str, list[dict[str, Any]]] = {}
    for row in inspection.detections.to_pylist():
        boxes.setdefault(row["photo_id"], []).append(row)
    paths = []
    for photo_id in track(list(photo_ids), label="Drawing overlays"):
        posed = inspection.posed.get(photo_id)
        path = folder / f"overlay_{photo_id.replace('/', '_').rsplit('.', 1)[0]}.jpg"
        try:
            picture, scale = _base(inspection.photograph(photo_id), posed, settings.overlay_width_px)
        except InputDataError as error:
            log.warning("no overlay: %s", error)
            continue
        if posed is not None:
            picture[_visible_edges(posed, surface, is_opening, picture.shape[:2])] = _EDGE_BGR
            _draw_defects(picture, scale, posed, surface, marks, settings)
        _draw_boxes(picture, scale, boxes.get(photo_id, []), outcome, posed)
        _caption(picture, photo_id, posed is not None, boxes.get(photo_id, []), outcome)
        cv2.imwrite(str(path), picture, _JPEG)
        paths.append(path)
    return paths


def _base(path: Path, posed: PosedCamera | None, width_px: int) -> tuple[Picture, float]:
    """The photograph (BGR) ``width_px`` wide or smaller, and its scale to the full one."""
    if posed is not None:
        reduction = next((n for n in (8, 4, 2) if posed.camera.width_px // n >= width_px), 1)
        bgr = read_photograph(path, posed.camera, reduction)[..., ::-1]
        full_width = posed.camera.width_px
    else:
        bgr = decoded(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        full_width = bgr.shape[1]
    scale = min(1.0, width_px / full_width)
    size = (round(full_width * scale), max(1, round(bgr.shape[0] * full_width * scale / bgr.shape[1])))
    return np.ascontiguousarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), scale


def _visible_edges(
    posed: PosedCamera, surface: Surface, is_opening: NDArray[np.bool_], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Edges of the model as the camera sees them, (h, w) of a reduced photograph."""
    height, width = shape
    x = (np.arange(width) + 0.5) * posed.camera.width_px / width
    y = (np.arange(height) + 0.5) * posed.camera.height_px / height
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    hits = surface.cast(*posed.rays_site(grid))
    xyz = np.nan_to_num(hits.xyz_site_m - posed.centre_site_m).astype(np.float32).reshape(height, width, 3)
    normal = np.nan_to_num(hits.normal_site).astype(np.float32).reshape(height, width, 3)
    return edges_of(xyz, normal, hits.element.astype(np.int32).reshape(height, width), is_opening)


def _draw_defects(
    picture: Picture,
    scale: float,
    posed: PosedCamera,
    surface: Surface,
    marks: Sequence[Mark],
    settings: PictureSettings,
) -> None:
    if not marks:
        return
    centres = np.array([mark.centre_site_m for mark in marks])
    normals = np.array([mark.normal_site for mark in marks])
    sight = sees(
        posed, surface, centres, normals, tolerance_m=2 * settings.visibility_tolerance_m, max_incidence_deg=85
    )
    for row in np.flatnonzero(sight.visible).tolist():
        xy, inside = pixels_of(posed, marks[row].corners_site_m)
        if inside.all():
            colour = bgr_of(class_colour(marks[row].defect_class))
            cv2.polylines(picture, [np.round(xy * scale).astype(np.int32)], True, colour, 1, cv2.LINE_AA)
            _text(picture, marks[row].label, xy.min(axis=0) * scale - (0, 5), (255, 255, 255), 0.36)


def _draw_boxes(
    picture: Picture,
    scale: float,
    boxes: Sequence[dict[str, Any]],
    outcome: dict[str, dict[str, Any]],
    posed: PosedCamera | None,
) -> None:
    for box in boxes:
        seen = outcome.get(box["detection_id"])
        colour = bgr_of(outcome_colour(seen["observation_outcome"]) if seen else OTHER_COLOUR)
        corner = np.array([box["box_x_px"], box["box_y_px"]])
        size = np.array([box["box_width_px"], box["box_height_px"]])
        first, last = np.round(corner * scale).astype(int), np.round((corner + size) * scale).astype(int)
        cv2.rectangle(picture, first.tolist(), last.tolist(), colour, 2, cv2.LINE_AA)
        if posed is not None and seen and seen["x_site_m"] is not None:
            xy, inside = pixels_of(posed, np.array([[seen["x_site_m"], seen["y_site_m"], seen["z_site_m"]]]))
            if inside[0]:
                at = np.round(xy[0] * scale).astype(int).tolist()
                cv2.drawMarker(picture, at, colour, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)


def _caption(
    picture: Picture,
    photo_id: str,
    has_pose: bool,
    boxes: Sequence[dict[str, Any]],
    outcome: dict[str, dict[str, Any]],
) -> None:
    """The photograph's name and its boxes by outcome, on a dark strip at the top."""
    words = Counter(
        outcome[box["detection_id"]]["observation_outcome"] if box["detection_id"] in outcome else "not accepted"
        for box in boxes
    )
    picture[:24] = (0.2 * picture[:24]).astype(np.uint8)
    # OpenCV's letters are ASCII alone.
    name = photo_id.encode("ascii", "replace").decode()
    x = _text(picture, name + ("" if has_pose else "  (no pose)"), np.array([8.0, 16.0]), (255, 255, 255), 0.48)
    if has_pose:
        x = _text(picture, "model edges", np.array([x + 18, 16.0]), _EDGE_BGR, 0.45)
    for word, count in sorted(words.items()):
        colour = bgr_of(outcome_colour(word))
        x = _text(picture, f"{count} {word.replace('_', ' ')}", np.array([x + 18, 16.0]), colour, 0.45)


def _text(picture: Picture, text: str, at: NDArray[np.float64], colour: tuple[int, int, int], size: float) -> float:
    """Write ``text`` on a dark ground from ``at`` (its lower left); returns the x where it ends."""
    place = np.round(at).astype(int).tolist()
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    left, top = max(0, place[0] - 2), max(0, place[1] - height - 2)
    ground = picture[top : place[1] + below, left : place[0] + width + 2]
    ground[:] = (0.3 * ground).astype(np.uint8)
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
    return float(at[0] + width)
