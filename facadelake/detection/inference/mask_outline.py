"""Mask logits on a model's coarse grid to an outline in pixels of the photograph, clipped to the box."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from skimage.measure import find_contours

from facadelake.core.arrays import Float32Array, Float64N
from facadelake.detection.inference.letterbox import Letterbox
from facadelake.detection.layouts.masks import CandidateMasks

_MARGIN_CELLS = 2  # beyond the box, so that the outline is interpolated up to the box's edge
_OUTSIDE_LOGIT = -1.0


def trace_mask(
    masks: CandidateMasks, candidate: int, corners_input: Float32Array, letterbox: Letterbox
) -> Polygon | MultiPolygon | None:
    """Trace the outline of a candidate's mask inside its box and the photograph.

    The contour of logit 0 is interpolated between the centres of the grid's cells (marching squares, after Lorensen and
    Cline 1987), not drawn around whole cells.

    Args:
        masks: Mask logits of all candidates.
        candidate: Row of the candidate.
        corners_input: Its box (4: left, top, right, bottom) in pixels of the model's input.
        letterbox: Placement of the photograph in the input.

    Returns:
        The outline in pixels of the photograph; None where the mask is empty there.
    """
    left, top, right, bottom = (float(side) for side in corners_input)
    height, width = masks.grid_shape
    cell = np.array([letterbox.spec.width_px / width, letterbox.spec.height_px / height])
    columns = _select_cells(left / cell[0], right / cell[0], width)
    rows = _select_cells(top / cell[1], bottom / cell[1], height)
    logits = masks.get_logits(candidate, rows, columns)
    if not logits.size:
        return None
    logits = np.nan_to_num(logits, nan=_OUTSIDE_LOGIT)
    # The outermost cells are repeated beyond the border of the input; then every contour is closed.
    closed = np.pad(np.pad(logits, 1, mode="edge"), 1, constant_values=_OUTSIDE_LOGIT)
    first = np.array([columns.start, rows.start]) - 2
    rings = []
    for line in find_contours(closed, 0.0):
        if len(line) >= 4:
            points = (line[:, ::-1] + first + 0.5) * cell
            rings.append(shapely.linestrings(letterbox.points_from_input(points)))
    area = shapely.build_area(shapely.geometrycollections(rings))
    return _extract_polygons(
        shapely.intersection(area, _clip_to_photograph(letterbox.image_from_input(corners_input)[0], letterbox))
    )


def _select_cells(low: float, high: float, cells: int) -> slice:
    """The cells from ``low`` to ``high`` with a margin, within the grid."""
    start = int(np.clip(np.floor(low) - _MARGIN_CELLS, 0, cells))
    return slice(start, int(np.clip(np.ceil(high) + _MARGIN_CELLS, start, cells)))


def _clip_to_photograph(corners: Float64N, letterbox: Letterbox) -> Polygon:
    """The part of a box inside the photograph."""
    left, top = max(corners[0], 0.0), max(corners[1], 0.0)
    right, bottom = min(corners[2], float(letterbox.image_width_px)), min(corners[3], float(letterbox.image_height_px))
    return shapely.box(left, top, right, bottom) if right > left and bottom > top else Polygon()


def _extract_polygons(shape: shapely.Geometry) -> Polygon | MultiPolygon | None:
    """The areas of a geometry, without the points and lines that clipping leaves; None if there are none."""
    areas = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon) and part.area > 0]
    if not areas:
        return None
    return areas[0] if len(areas) == 1 else MultiPolygon(areas)
