"""Overlays: photographs with the projected model edges, the detections by outcome, and the defects."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from facadelake.building.surface import MISS, Surface, check_visibility, project_points
from facadelake.core.arrays import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Image
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import InputDataError
from facadelake.core.progress import track
from facadelake.reporting.cards.observations import read_outline
from facadelake.reporting.drawing.labels import place_labels
from facadelake.reporting.drawing.legend_strip import LegendEntry, add_legend, measure_text, write_text
from facadelake.reporting.drawing.palette import OTHER_COLOUR, OUTCOME_COLOURS, bgr_from_hex, get_outcome_colour
from facadelake.reporting.drawing.photograph import decode_image, name_photograph_files, read_photograph
from facadelake.reporting.elevations.marks import DefectMark, create_marks
from facadelake.reporting.elevations.relief import find_edges, find_openings, has_model_edges
from facadelake.reporting.inspection import Inspection, PictureSettings

log = logging.getLogger(__name__)

_EDGE_BGR = (255, 255, 0)
_DEFECT_BGR = (255, 255, 255)
_NOT_ACCEPTED = "not accepted"
_LABEL_SIZE = 0.36
_COARSE_PX = 4  # spacing of the coarse search; edges closer to one another may be missed
_THICK_LINE_PX = 20  # smaller boxes are drawn with thin lines
# Without chroma subsampling, so that lines of one pixel keep their colour.
_JPEG = [
    cv2.IMWRITE_JPEG_QUALITY, 88, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
]  # fmt: skip


def draw_overlays(
    inspection: Inspection,
    surface: Surface,
    photo_ids: Collection[str],
    folder: Path,
    settings: PictureSettings | None = None,
) -> dict[str, Path]:
    """Write ``overlay_<photo>.jpg`` for each photograph.

    An overlay shows the model's visible edges with lens distortion (not those of an as-built surface), boxes or masks
    coloured by outcome, registered positions as crosses, visible defects in white, and a legend. An overlay of a
    photograph without a pose shows the boxes only. Unreadable photographs have no overlay, with a warning.

    Args:
        inspection: the campaign.
        surface: surface of its building model.
        photo_ids: photographs.
        folder: existing folder to write into.
        settings: width of the overlays, tolerance of visibility; None: the defaults.

    Returns:
        Paths by photo_id.
    """
    settings = settings or PictureSettings()
    is_opening, has_edges = find_openings(inspection.building), has_model_edges(inspection.building)
    marks = create_marks(inspection.defects, inspection.building.origin)
    observations = {row["detection_id"]: row for row in inspection.observations.to_pylist()}
    boxes: dict[str, list[dict[str, Any]]] = {}
    for row in inspection.detections.to_pylist():
        boxes.setdefault(row["photo_id"], []).append(row)
    paths: dict[str, Path] = {}
    names = name_photograph_files([*inspection.photos.column("photo_id").to_pylist(), *photo_ids])
    for photo_id in track(list(photo_ids), label="Drawing overlays"):
        posed = inspection.posed.get(photo_id)
        path = folder / f"overlay_{names[photo_id]}.jpg"
        try:
            picture, scale = _read_resized(inspection.locate_photograph(photo_id), posed, settings.overlay_width_px)
        except InputDataError as error:
            log.warning("overlay not drawn: %s", error)
            continue
        if posed is not None:
            if has_edges:
                picture[_find_visible_edges(posed, surface, is_opening, picture.shape[:2])] = _EDGE_BGR
            _draw_defects(picture, scale, posed, surface, marks, settings)
        _draw_boxes(picture, scale, boxes.get(photo_id, []), observations, posed)
        title = photo_id + ("" if posed is not None else "  (no pose)")
        entries = _list_legend_entries(posed is not None, has_edges, boxes.get(photo_id, []), observations)
        cv2.imwrite(str(path), add_legend(picture, title, entries), _JPEG)
        paths[photo_id] = path
    return paths


def select_overlay_photographs(inspection: Inspection, count: int) -> list[str]:
    """At most ``count`` localised photographs, chosen greedily: those that add most outcomes, then most defects."""
    contents: dict[str, set[str]] = {}
    for row in inspection.observations.to_pylist():
        if row["photo_id"] in inspection.posed:
            own = contents.setdefault(row["photo_id"], set())
            own.add(f"outcome {row['observation_outcome']}")
            if row["defect_id"] is not None:
                own.add(f"defect {row['defect_id']}")
    selected: list[str] = []
    covered: set[str] = set()

    def count_new(photo_id: str) -> tuple[int, int]:
        new = contents[photo_id] - covered
        return sum(item.startswith("outcome") for item in new), len(new)

    while len(selected) < min(count, len(contents)):
        best = max((name for name in sorted(contents) if name not in selected), key=count_new)
        if not contents[best] - covered:
            break
        selected.append(best)
        covered |= contents[best]
    return selected


def _read_resized(path: Path, posed: PosedCamera | None, width_px: int) -> tuple[UInt8Image, float]:
    """The photograph (BGR), at most ``width_px`` wide, and its scale to full resolution."""
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
    """Mask (h, w) of the model's visible edges in a photograph reduced to ``shape``.

    A coarse search finds the regions with edges; only these are searched at full resolution.
    """
    coarse = -(-shape[0] // _COARSE_PX), -(-shape[1] // _COARSE_PX)
    rows, columns = np.indices(coarse).reshape(2, -1) * _COARSE_PX + _COARSE_PX // 2
    coarse_edges = find_edges(*_cast_pixels(posed, surface, shape, rows, columns, coarse), is_opening)
    near = (
        cv2.dilate(coarse_edges.astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
        .repeat(_COARSE_PX, axis=0)
        .repeat(_COARSE_PX, axis=1)
    )
    searched = near[: shape[0], : shape[1]].astype(bool)
    xyz, normal = np.zeros((*shape, 3), dtype=np.float32), np.zeros((*shape, 3), dtype=np.float32)
    element = np.full(shape, MISS, dtype=np.int32)
    rows, columns = np.nonzero(searched)
    xyz[searched], normal[searched], element[searched] = _cast_pixels(
        posed, surface, shape, rows, columns, (len(rows),)
    )
    # An edge is a difference to the pixel to the right or below: both must have been searched.
    inside = searched.copy()
    inside[:, :-1] &= searched[:, 1:]
    inside[:-1] &= searched[1:]
    edges: BoolArray = find_edges(xyz, normal, element, is_opening) & inside
    return edges


def _cast_pixels(
    posed: PosedCamera, surface: Surface, shape: tuple[int, int], rows: Int64Array, columns: Int64Array,
    out_shape: tuple[int, ...],
) -> tuple[Float32Array, Float32Array, NDArray[np.int32]]:  # fmt: skip
    """Surface points relative to the camera's centre, normals and elements at pixels, as arrays of ``out_shape``.

    ``rows`` and ``columns`` (n,) are pixels of a photograph reduced to ``shape``.
    """
    camera = posed.camera
    x = (columns + 0.5) * camera.width_px / shape[1]
    y = (rows + 0.5) * camera.height_px / shape[0]
    hits = surface.cast(*posed.rays_site_from_img(np.column_stack([x, y])))
    xyz = np.nan_to_num(hits.xyz_site_m - posed.centre_site_m).astype(np.float32).reshape(*out_shape, 3)
    normal = np.nan_to_num(hits.normal_site).astype(np.float32).reshape(*out_shape, 3)
    return xyz, normal, hits.element.astype(np.int32).reshape(out_shape)


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
    visibility = check_visibility(
        posed, surface, centres, normals, tolerance_m=2 * settings.visibility_tolerance_m, max_incidence_deg=85
    )
    labels: list[str] = []
    boxes: list[Float64Array] = []
    for row in np.flatnonzero(visibility.visible).tolist():
        xy, inside = project_points(posed, marks[row].corners_site_m)
        if inside.all():
            rings = np.split(xy, np.cumsum([len(ring) for ring in marks[row].outlines_site_m])[:-1])
            rings_px = [np.round(ring * scale).astype(np.int32) for ring in rings]
            cv2.polylines(picture, rings_px, True, _DEFECT_BGR, 1, cv2.LINE_AA)
            labels.append(marks[row].label)
            boxes.append(np.concatenate([xy.min(axis=0), xy.max(axis=0)]) * scale)
    _write_labels(picture, labels, np.array(boxes).reshape(-1, 4))


def _write_labels(picture: UInt8Image, labels: Sequence[str], boxes: Float64Array) -> None:
    """Write the labels of defects beside their boxes (n, 4), pixels, without overlaps; a line leads to a far one."""
    sizes = np.array([measure_text(label, _LABEL_SIZE) for label in labels], dtype=np.float64).reshape(-1, 2)
    bounds = np.array([0.0, 0.0, picture.shape[1], picture.shape[0]])
    centres = place_labels(boxes, sizes, bounds)
    for label, box, size, centre in zip(labels, boxes, sizes, centres, strict=True):
        nearest = np.clip(centre, box[:2], box[2:])
        if (np.abs(nearest - centre) > size).any():
            start, end = (np.round(point).astype(int).tolist() for point in (nearest, centre))
            cv2.line(picture, start, end, _DEFECT_BGR, 1, cv2.LINE_AA)
        write_text(picture, label, centre, _DEFECT_BGR, _LABEL_SIZE)


def _draw_boxes(
    picture: UInt8Image,
    scale: float,
    boxes: Sequence[dict[str, Any]],
    observations: dict[str, dict[str, Any]],
    posed: PosedCamera | None,
) -> None:
    for box in boxes:
        observation = observations.get(box["detection_id"])
        colour = bgr_from_hex(get_outcome_colour(observation["observation_outcome"]) if observation else OTHER_COLOUR)
        if box["box_x_px"] is None:
            continue
        outline = read_outline(box)
        first = np.array([outline.left_px, outline.top_px]) * scale
        last = first + np.array([outline.width_px, outline.height_px]) * scale
        thickness = 2 if max(last - first) >= _THICK_LINE_PX else 1
        if outline.rings_px:
            rings = [np.round(ring * scale).astype(np.int32) for ring in outline.rings_px]
            cv2.polylines(picture, rings, True, colour, 1, cv2.LINE_AA)
        else:
            cv2.rectangle(
                picture, np.round(first).astype(int).tolist(), np.round(last).astype(int).tolist(), colour, thickness,
                cv2.LINE_AA,
            )  # fmt: skip
        if posed is not None and observation and observation["x_site_m"] is not None:
            position = np.array([[observation[name] for name in ("x_site_m", "y_site_m", "z_site_m")]])
            xy, inside = project_points(posed, position)
            if inside[0]:
                pixel = np.round(xy[0] * scale).astype(int).tolist()
                cv2.drawMarker(picture, pixel, colour, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)


def _list_legend_entries(
    has_pose: bool, has_edges: bool, boxes: Sequence[dict[str, Any]], observations: dict[str, dict[str, Any]]
) -> list[LegendEntry]:
    """Legend of an overlay, with the number of boxes of each outcome."""
    outcomes = Counter(
        observations[box["detection_id"]]["observation_outcome"]
        if box["detection_id"] in observations
        else _NOT_ACCEPTED
        for box in boxes
    )
    entries = [LegendEntry(colour_bgr=_EDGE_BGR, text="model edges")] if has_pose and has_edges else []
    entries += [LegendEntry(colour_bgr=_DEFECT_BGR, text="defect: registered outline")] if has_pose else []
    order = [*OUTCOME_COLOURS, _NOT_ACCEPTED]
    for outcome, count in sorted(outcomes.items(), key=lambda item: order.index(item[0])):
        entries.append(
            LegendEntry(
                colour_bgr=bgr_from_hex(get_outcome_colour(outcome)), text=f"{count} {outcome.replace('_', ' ')}"
            )
        )
    if outcomes["registered"]:
        entries.append(
            LegendEntry(colour_bgr=bgr_from_hex(get_outcome_colour("registered")), text="cross: registered position")
        )
    return entries
