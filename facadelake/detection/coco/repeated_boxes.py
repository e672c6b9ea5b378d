"""Boxes that are in a COCO file twice under two ids: files merged with a copy, or one defect marked by two persons.

Observations of one photograph are never merged, so each defect would be in the tables twice.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely

from facadelake.core.arrays import Float64Array, Float64N, Float64Nx4
from schemas.vocabulary import DetectionOutcome

# Two defects of one class do not fill nine tenths of each other; crossing cracks with one box differ in their masks.
_SAME_OVERLAP_MIN = 0.9  # common area over that of both


def find_repeated_boxes(rows: Sequence[Mapping[str, Any]]) -> dict[int, int]:
    """Accepted rows of table ``detections`` that repeat another of their photograph and class: index -> the other's.

    The row with the highest score is the one that counts; of equal ones the first. Masks are compared where both rows
    have one, else boxes.
    """
    alike: dict[tuple[str, str], list[int]] = defaultdict(list)
    for index, row in enumerate(rows):
        if row["detection_outcome"] == DetectionOutcome.ACCEPTED:
            alike[row["photo_id"], row["defect_class"]].append(index)
    repeated: dict[int, int] = {}
    for indices in alike.values():
        order = sorted(indices, key=lambda i: (-rows[i]["score"], i))
        boxes = np.array([_read_corners(rows[index]) for index in order])
        for place, index in enumerate(order):
            overlap = _measure_box_overlaps(boxes[place], boxes[:place])
            for earlier in np.flatnonzero(overlap >= _SAME_OVERLAP_MIN):
                other = order[earlier]
                if other not in repeated and _have_same_masks(rows[index], rows[other]):
                    repeated[index] = other
                    break
    return repeated


def _read_corners(row: Mapping[str, Any]) -> tuple[float, float, float, float]:
    left, top = row["box_x_px"], row["box_y_px"]
    return left, top, left + row["box_width_px"], top + row["box_height_px"]


def _measure_box_overlaps(box: Float64Array, others: Float64Nx4) -> Float64N:
    """Common area over that of both, of a box (4: left, top, right, bottom) and each of the others (n, 4)."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    common = np.prod(np.maximum(sides, 0.0), axis=1)
    areas = np.prod(others[:, 2:] - others[:, :2], axis=1) + np.prod(box[2:] - box[:2])
    overlap: Float64N = common / (areas - common)
    return overlap


def _have_same_masks(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether the masks of two rows are the same; also where one of them has none."""
    masks = one.get("mask"), other.get("mask")
    if None in masks:
        return True
    shapes = shapely.make_valid(shapely.from_wkt(masks))
    common = float(shapely.area(shapely.intersection(*shapes)))
    return common >= _SAME_OVERLAP_MIN * (float(shapely.area(shapes).sum()) - common)
