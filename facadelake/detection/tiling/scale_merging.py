"""Merging of the detections of a fine and a coarse tile pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from facadelake.detection.boxes import Box
from facadelake.detection.inference.detector import DetectedBox
from facadelake.detection.tiling.agreement import compute_iou

# A fine detection with this share of its area in a coarse one is a part of it.
CONTAINED_SHARE_MIN = 0.7
# Fine detections whose common bounding box has this IoU with a coarse one are its pieces.
PIECES_IOU_MIN = 0.4


def merge_scales(
    fine: Sequence[DetectedBox], coarse: Sequence[DetectedBox], *, nms_iou: float
) -> tuple[DetectedBox, ...]:
    """Merge ``fine`` and ``coarse`` detections of one photograph, so that each object is detected once.

    A fine and a coarse detection of one class with an IoU of at least ``nms_iou`` are matched, best overlap first; the
    fine outline is kept with the higher score. Unmatched fine detections that together fill a coarse one are merged as
    pieces of one object, whose extent is that of the pieces. If they fill little of it, the one with the higher score
    is kept.
    """
    if not fine or not coarse:
        return tuple(fine) or tuple(coarse)
    fine_shapes = [_get_shape(detection) for detection in fine]
    coarse_shapes = [_get_shape(detection) for detection in coarse]
    overlaps = [
        (int(i), int(j), compute_iou(fine_shapes[i], coarse_shapes[j]))
        for j, i in zip(*shapely.STRtree(fine_shapes).query(coarse_shapes, predicate="intersects"), strict=True)
        if fine[i].class_name == coarse[j].class_name
    ]
    scores = [detection.score for detection in fine]
    matched_coarse: set[int] = set()
    matched_fine: set[int] = set()
    for i, j, iou in sorted(overlaps, key=lambda overlap: -overlap[2]):
        if iou < nms_iou:
            break
        if i not in matched_fine and j not in matched_coarse:
            scores[i] = max(scores[i], coarse[j].score)
            matched_fine.add(i)
        matched_coarse.add(j)
    merged: list[DetectedBox] = []
    replaced_fine: set[int] = set()
    for j in sorted(set(range(len(coarse))) - matched_coarse, key=lambda k: -coarse[k].score):
        inside = [
            i
            for i, other, _ in overlaps
            if other == j
            and i not in matched_fine
            and _compute_contained_share(fine_shapes[i], coarse_shapes[j]) >= CONTAINED_SHARE_MIN
        ]
        if not inside:
            merged.append(coarse[j])
            continue
        bounds = shapely.union_all([shapely.box(*fine_shapes[i].bounds) for i in inside]).envelope
        score_max = max(scores[i] for i in inside)
        if compute_iou(bounds, shapely.box(*coarse_shapes[j].bounds)) >= PIECES_IOU_MIN:
            merged.append(_merge_pieces([fine[i] for i in inside], bounds, max(score_max, coarse[j].score)))
        elif coarse[j].score > score_max:
            merged.append(coarse[j])
        else:
            continue
        matched_fine |= set(inside)
        replaced_fine |= set(inside)
    kept = (replace(fine[i], score=scores[i]) for i in range(len(fine)) if i not in replaced_fine)
    return (*merged, *kept)


def _merge_pieces(pieces: Sequence[DetectedBox], bounds: shapely.Geometry, score: float) -> DetectedBox:
    left, top, right, bottom = bounds.bounds
    masks = [piece.mask for piece in pieces]
    mask = shapely.union_all(np.array(masks, dtype=object)) if all(mask is not None for mask in masks) else None
    box = Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top)
    return replace(pieces[0], box=box, score=score, mask=mask)


def _get_shape(detection: DetectedBox) -> shapely.Geometry:
    """The mask, or the box where there is no mask."""
    box = detection.box
    return detection.mask or shapely.box(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px)


def _compute_contained_share(part: shapely.Geometry, whole: shapely.Geometry) -> float:
    """Share of the area of ``part`` that lies in ``whole``."""
    return float(part.intersection(whole).area / max(part.area, 1e-9))
