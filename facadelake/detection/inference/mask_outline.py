"""A mask on a model's coarse grid as an outline in pixels of the photograph, cut to its box."""

from __future__ import annotations

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from skimage.measure import find_contours

from facadelake.core.arrays import Float32Array, Float64Array
from facadelake.detection.inference.letterbox import Letterbox
from facadelake.detection.layouts.masks import CandidateMasks

_MARGIN_CELLS = 2  # beyond the box, so that the outline is interpolated up to its edge
_OUTSIDE_LOGIT = -1.0


def trace_mask(
    masks: CandidateMasks, candidate: int, corners_input: Float32Array, box: Letterbox
) -> Polygon | MultiPolygon | None:
    """The outline of ``candidate``'s mask inside its box and the photograph; None where nothing of it lies there.

    ``corners_input`` (4) is the box in pixels of the input. The line where the logit is 0 is drawn between the centres
    of the grid's cells (marching squares, Lorensen and Cline 1987), not around whole cells.
    """
    left, top, right, bottom = (float(side) for side in corners_input)
    height, width = masks.grid_shape
    cell = np.array([box.spec.width_px / width, box.spec.height_px / height])
    columns = _select_cells(left / cell[0], right / cell[0], width)
    rows = _select_cells(top / cell[1], bottom / cell[1], height)
    logits = masks.get_logits(candidate, rows, columns)
    if not logits.size:
        return None
    logits = np.nan_to_num(logits, nan=_OUTSIDE_LOGIT)
    # The outermost cells go on beyond the border of the input; then every line is closed.
    closed = np.pad(np.pad(logits, 1, mode="edge"), 1, constant_values=_OUTSIDE_LOGIT)
    first = np.array([columns.start, rows.start]) - 2
    rings = []
    for line in find_contours(closed, 0.0):
        if len(line) >= 4:
            points = (line[:, ::-1] + first + 0.5) * cell
            rings.append(shapely.linestrings(box.points_from_input(points)))
    area = shapely.build_area(shapely.geometrycollections(rings))
    return _extract_polygons(
        shapely.intersection(area, _clip_to_photograph(box.image_from_input(corners_input)[0], box))
    )


def _select_cells(low: float, high: float, cells: int) -> slice:
    """The cells from ``low`` to ``high`` with a margin, as far as they exist."""
    start = int(np.clip(np.floor(low) - _MARGIN_CELLS, 0, cells))
    return slice(start, int(np.clip(np.ceil(high) + _MARGIN_CELLS, start, cells)))


def _clip_to_photograph(corners: Float64Array, box: Letterbox) -> Polygon:
    """What of a box lies in the photograph."""
    left, top = max(corners[0], 0.0), max(corners[1], 0.0)
    right, bottom = min(corners[2], float(box.image_width_px)), min(corners[3], float(box.image_height_px))
    return shapely.box(left, top, right, bottom) if right > left and bottom > top else Polygon()


def _extract_polygons(shape: shapely.Geometry) -> Polygon | MultiPolygon | None:
    """The areas of a geometry, without the points and lines that cutting leaves."""
    areas = [part for part in shapely.get_parts(shape) if isinstance(part, Polygon) and part.area > 0]
    if not areas:
        return None
    return areas[0] if len(areas) == 1 else MultiPolygon(areas)
