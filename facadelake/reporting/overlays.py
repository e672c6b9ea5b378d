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

from facadelake.building.surface import MISS, Surface
from facadelake.core.arrays import BoolArray, Float32Array, Int64Array, UInt8Image
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.reporting.cards.observations import read_outline
from facadelake.reporting.drawing.legend_strip import LegendEntry, add_legend, write_text
from facadelake.reporting.drawing.palette import OTHER_COLOUR, OUTCOME_COLOURS, bgr_from_hex, get_outcome_colour
from facadelake.reporting.drawing.photograph import decode_image, read_photograph
from facadelake.reporting.elevations.marks import DefectMark, create_marks
from facadelake.reporting.elevations.relief import find_edges, find_openings, has_model_edges
from facadelake.reporting.elevations.visibility import check_visibility, project_points
from facadelake.reporting.inspection import Inspection, PictureSettings

log = logging.getLogger(__name__)

_EDGE_BGR = (255, 255, 0)
_DEFECT_BGR = (255, 255, 255)
_NOT_ACCEPTED = "not accepted"
_COARSE_PX = 4  # edges closer to one another than this may be missed
_ROOMY_PX = 20  # a smaller box gets a thin line, which leaves something of what it shows
# Full colour resolution: lines of one pixel keep their colour.
_JPEG = [
    cv2.IMWRITE_JPEG_QUALITY, 88, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
]  # fmt: skip


def draw_overlays(
    inspection: Inspection,
    surface: Surface,
    photo_ids: Iterable[str],
    folder: Path,
    settings: PictureSettings | None = None,
) -> dict[str, Path]:
    """Write ``overlay_<photo>.jpg`` for each photograph asked for, ``overlay_width_px`` wide; paths by photo_id.

    Drawn: the model's visible edges (lens distortion kept; none of a surface of tie points), boxes or masks coloured by
    outcome, registered points as crosses, defects at real size in white where the photograph sees them; a strip above
    says so. A photograph without a pose shows its boxes alone; one that cannot be read is left out with a warning.
    """
    settings = settings or PictureSettings()
    is_opening, has_edges = find_openings(inspection.building), has_model_edges(inspection.building)
    marks = create_marks(inspection.defects, inspection.building.origin)
    outcome = {row["detection_id"]: row for row in inspection.observations.to_pylist()}
    boxes: dict[str, list[dict[str, Any]]] = {}
    for row in inspection.detections.to_pylist():
        boxes.setdefault(row["photo_id"], []).append(row)
    paths: dict[str, Path] = {}
    for photo_id in track(list(photo_ids), label="Drawing overlays"):
        posed = inspection.posed.get(photo_id)
        path = folder / f"overlay_{photo_id.replace('/', '_').rsplit('.', 1)[0]}.jpg"
        try:
            picture, scale = _read_resized(inspection.locate_photograph(photo_id), posed, settings.overlay_width_px)
        except InputDataError as error:
            log.warning("no overlay: %s", error)
            continue
        if posed is not None:
            if has_edges:
                picture[_find_visible_edges(posed, surface, is_opening, picture.shape[:2])] = _EDGE_BGR
            _draw_defects(picture, scale, posed, surface, marks, settings)
        _draw_boxes(picture, scale, boxes.get(photo_id, []), outcome, posed)
        title = photo_id + ("" if posed is not None else "  (no pose)")
        entries = _list_legend_entries(posed is not None, has_edges, boxes.get(photo_id, []), outcome)
        cv2.imwrite(str(path), add_legend(picture, title, entries), _JPEG)
        paths[photo_id] = path
    return paths


def select_overlay_photographs(inspection: Inspection, count: int) -> list[str]:
    """At most ``count`` localised photographs, each the one that adds most: outcomes not yet shown, then defects."""
    shows: dict[str, set[str]] = {}
    for row in inspection.observations.to_pylist():
        if row["photo_id"] in inspection.posed:
            own = shows.setdefault(row["photo_id"], set())
            own.add(f"outcome {row['observation_outcome']}")
            if row["defect_id"] is not None:
                own.add(f"defect {row['defect_id']}")
    chosen: list[str] = []
    shown: set[str] = set()

    def adds(photo_id: str) -> tuple[int, int]:
        new = shows[photo_id] - shown
        return sum(what.startswith("outcome") for what in new), len(new)

    while len(chosen) < min(count, len(shows)):
        best = max((name for name in sorted(shows) if name not in chosen), key=adds)
        if not shows[best] - shown:
            break
        chosen.append(best)
        shown |= shows[best]
    return chosen


def _read_resized(path: Path, posed: PosedCamera | None, width_px: int) -> tuple[UInt8Image, float]:
    """The photograph (BGR) ``width_px`` wide or smaller, and its scale to the full one."""
    if posed is not None:
        reduction = next((n for n in (8, 4, 2) if posed.camera.width_px // n >= width_px), 1)
        bgr = read_photograph(path, posed.camera, reduction)[..., ::-1]
        full_width = posed.camera.width_px
    else:
        bgr = decode_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        full_width = bgr.shape[1]
    scale = min(1.0, width_px / full_width)
    size = (round(full_width * scale), max(1, round(bgr.shape[0] * full_width * scale / bgr.shape[1])))
    return np.ascontiguousarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), scale


def _find_visible_edges(
    posed: PosedCamera, surface: Surface, is_opening: BoolArray, shape: tuple[int, int]
) -> BoolArray:
    """Edges of the model as the camera sees them, (h, w) of a reduced photograph.

    A coarse look finds where edges are, a fine one there alone draws them: most of a picture is none.
    """
    coarse = -(-shape[0] // _COARSE_PX), -(-shape[1] // _COARSE_PX)
    rows, columns = np.indices(coarse).reshape(2, -1) * _COARSE_PX + _COARSE_PX // 2
    found = find_edges(*_cast_pixels(posed, surface, shape, rows, columns, coarse), is_opening).astype(np.uint8)
    near = cv2.dilate(found, np.ones((3, 3), dtype=np.uint8)).repeat(_COARSE_PX, axis=0).repeat(_COARSE_PX, axis=1)
    wanted = near[: shape[0], : shape[1]].astype(bool)
    xyz, normal = np.zeros((*shape, 3), dtype=np.float32), np.zeros((*shape, 3), dtype=np.float32)
    element = np.full(shape, MISS, dtype=np.int32)
    rows, columns = np.nonzero(wanted)
    xyz[wanted], normal[wanted], element[wanted] = _cast_pixels(posed, surface, shape, rows, columns, (len(rows),))
    # An edge is one against the pixel to the right or below: both must have been looked at.
    inside = wanted.copy()
    inside[:, :-1] &= wanted[:, 1:]
    inside[:-1] &= wanted[1:]
    edges: BoolArray = find_edges(xyz, normal, element, is_opening) & inside
    return edges


def _cast_pixels(
    posed: PosedCamera, surface: Surface, shape: tuple[int, int], rows: Int64Array, columns: Int64Array,
    form: tuple[int, ...],
) -> tuple[Float32Array, Float32Array, NDArray[np.int32]]:  # fmt: skip
    """Points from the camera's centre, normals and elements at pixels of a photograph reduced to ``shape``."""
    camera = posed.camera
    x = (columns + 0.5) * camera.width_px / shape[1]
    y = (rows + 0.5) * camera.height_px / shape[0]
    hits = surface.cast(*posed.rays_site_from_img(np.column_stack([x, y])))
    xyz = np.nan_to_num(hits.xyz_site_m - posed.centre_site_m).astype(np.float32).reshape(*form, 3)
    normal = np.nan_to_num(hits.normal_site).astype(np.float32).reshape(*form, 3)
    return xyz, normal, hits.element.astype(np.int32).reshape(form)


def _draw_defects(
    picture: UInt8Image,
    scale: float,
    posed: PosedCamera,
    surface: Surface,
    marks: Sequence[DefectMark],
    settings: PictureSettings,
) -> None:
    if not marks:
        return
    centres = np.array([mark.centre_site_m for mark in marks])
    normals = np.array([mark.normal_site for mark in marks])
    sight = check_visibility(
        posed, surface, centres, normals, tolerance_m=2 * settings.visibility_tolerance_m, max_incidence_deg=85
    )
    for row in np.flatnonzero(sight.visible).tolist():
        xy, inside = project_points(posed, marks[row].corners_site_m)
        if inside.all():
            rings = np.split(xy, np.cumsum([len(ring) for ring in marks[row].outlines_site_m])[:-1])
            drawn = [np.round(ring * scale).astype(np.int32) for ring in rings]
            cv2.polylines(picture, drawn, True, _DEFECT_BGR, 1, cv2.LINE_AA)
            write_text(picture, marks[row].label, xy.min(axis=0) * scale - (0, 5), _DEFECT_BGR, 0.36)


def _draw_boxes(
    picture: UInt8Image,
    scale: float,
    boxes: Sequence[dict[str, Any]],
    outcome: dict[str, dict[str, Any]],
    posed: PosedCamera | None,
) -> None:
    for box in boxes:
        seen = outcome.get(box["detection_id"])
        colour = bgr_from_hex(get_outcome_colour(seen["observation_outcome"]) if seen else OTHER_COLOUR)
        if box["box_x_px"] is None:
            continue
        outline = read_outline(box)
        first = np.array([outline.left_px, outline.top_px]) * scale
        last = first + np.array([outline.width_px, outline.height_px]) * scale
        thickness = 2 if max(last - first) >= _ROOMY_PX else 1
        if outline.rings_px:
            rings = [np.round(ring * scale).astype(np.int32) for ring in outline.rings_px]
            cv2.polylines(picture, rings, True, colour, 1, cv2.LINE_AA)
        else:
            cv2.rectangle(
                picture, np.round(first).astype(int).tolist(), np.round(last).astype(int).tolist(), colour, thickness,
                cv2.LINE_AA,
            )  # fmt: skip
        if posed is not None and seen and seen["x_site_m"] is not None:
            xy, inside = project_points(posed, np.array([[seen["x_site_m"], seen["y_site_m"], seen["z_site_m"]]]))
            if inside[0]:
                at = np.round(xy[0] * scale).astype(int).tolist()
                cv2.drawMarker(picture, at, colour, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)


def _list_legend_entries(
    has_pose: bool, has_edges: bool, boxes: Sequence[dict[str, Any]], outcome: dict[str, dict[str, Any]]
) -> list[LegendEntry]:
    """What the colours mean, and how many boxes met each outcome."""
    words = Counter(
        outcome[box["detection_id"]]["observation_outcome"] if box["detection_id"] in outcome else _NOT_ACCEPTED
        for box in boxes
    )
    entries = [LegendEntry(colour_bgr=_EDGE_BGR, text="model edges")] if has_pose and has_edges else []
    entries += [LegendEntry(colour_bgr=_DEFECT_BGR, text="defect where it was placed, real size")] if has_pose else []
    order = [*OUTCOME_COLOURS, _NOT_ACCEPTED]
    for word, count in sorted(words.items(), key=lambda item: order.index(item[0])):
        entries.append(
            LegendEntry(colour_bgr=bgr_from_hex(get_outcome_colour(word)), text=f"{count} {word.replace('_', ' ')}")
        )
    if words["registered"]:
        entries.append(
            LegendEntry(colour_bgr=bgr_from_hex(get_outcome_colour("registered")), text="cross: registered point")
        )
    return entries
