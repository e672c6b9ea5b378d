"""Boxes that are in a COCO file twice under two ids: files merged with a copy, or one defect marked by two persons.

Observations of one photograph are never merged, so each defect would be in the tables twice.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import shapely

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
        kept: list[int] = []
        for index in sorted(indices, key=lambda i: (-rows[i]["score"], i)):
            other = next((one for one in kept if _is_same(rows[index], rows[one])), None)
            if other is None:
                kept.append(index)
            else:
                repeated[index] = other
    return repeated


def _is_same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    if _measure_overlap(_build_box(one), _build_box(other)) < _SAME_OVERLAP_MIN:
        return False
    masks = one.get("mask"), other.get("mask")
    return None in masks or _measure_overlap(*shapely.make_valid(shapely.from_wkt(masks))) >= _SAME_OVERLAP_MIN


def _build_box(row: Mapping[str, Any]) -> Any:
    left, top = row["box_x_px"], row["box_y_px"]
    return shapely.box(left, top, left + row["box_width_px"], top + row["box_height_px"])


def _measure_overlap(one: Any, other: Any) -> float:
    common = float(shapely.area(shapely.intersection(one, other)))
    both = float(shapely.area(one) + shapely.area(other)) - common
    return common / both if both > 0 else 0.0
