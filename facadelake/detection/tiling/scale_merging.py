"""What a fine and a coarse look both show, told once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from facadelake.detection.boxes import Box
from facadelake.detection.inference.detector import DetectedBox
from facadelake.detection.tiling.agreement import compute_iou

# A fine box that lies in a coarse one by this much of its area shows a part of it, or all.
CONTAINED_SHARE_MIN = 0.7
# Fine boxes that together bound this much of a coarse one are its pieces.
PIECES_IOU_MIN = 0.4


def merge_scales(
    fine: Sequence[DetectedBox], coarse: Sequence[DetectedBox], *, nms_iou: float
) -> tuple[DetectedBox, ...]:
    """``fine`` and ``coarse`` of the same photograph, each thing once.

    What overlaps by ``nms_iou`` or more is one thing, each fine one with the coarse one that fits it best; the fine
    outline stands, and the better score. Where fine ones that found no partner together fill a coarse one, that one
    says they are pieces of one thing, and they say where it ends. Where they show little of it, the better score
    decides.
    """
    if not fine or not coarse:
        return tuple(fine) or tuple(coarse)
    outlines = [_get_shape(one) for one in fine]
    large = [_get_shape(one) for one in coarse]
    near = [
        (int(i), int(j), compute_iou(outlines[i], large[j]))
        for j, i in zip(*shapely.STRtree(outlines).query(large, predicate="intersects"), strict=True)
        if fine[i].class_name == coarse[j].class_name
    ]
    score = [one.score for one in fine]
    told: set[int] = set()  # of coarse
    settled: set[int] = set()  # of fine
    for i, j, share in sorted(near, key=lambda pair: -pair[2]):
        if share < nms_iou:
            break
        if i not in settled and j not in told:
            score[i] = max(score[i], coarse[j].score)
            settled.add(i)
        told.add(j)
    out: list[DetectedBox] = []
    gone: set[int] = set()  # of fine
    for j in sorted(set(range(len(coarse))) - told, key=lambda k: -coarse[k].score):
        inside = [
            i
            for i, other, _ in near
            if other == j
            and i not in settled
            and _compute_contained_share(outlines[i], large[j]) >= CONTAINED_SHARE_MIN
        ]
        if not inside:
            out.append(coarse[j])
            continue
        about = shapely.union_all([shapely.box(*outlines[i].bounds) for i in inside]).envelope
        best = max(score[i] for i in inside)
        if compute_iou(about, shapely.box(*large[j].bounds)) >= PIECES_IOU_MIN:
            out.append(_merge_pieces([fine[i] for i in inside], about, max(best, coarse[j].score)))
        elif coarse[j].score > best:
            out.append(coarse[j])
        else:
            continue
        settled |= set(inside)
        gone |= set(inside)
    return (*out, *(replace(fine[i], score=score[i]) for i in range(len(fine)) if i not in gone))


def _merge_pieces(pieces: Sequence[DetectedBox], about: shapely.Geometry, score: float) -> DetectedBox:
    left, top, right, bottom = about.bounds
    masks = [one.mask for one in pieces]
    mask = shapely.union_all(np.array(masks, dtype=object)) if all(one is not None for one in masks) else None
    box = Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top)
    return replace(pieces[0], box=box, score=score, mask=mask)


def _get_shape(found: DetectedBox) -> shapely.Geometry:
    box = found.box
    return found.mask or shapely.box(box.x_px, box.y_px, box.x_px + box.width_px, box.y_px + box.height_px)


def _compute_contained_share(part: shapely.Geometry, whole: shapely.Geometry) -> float:
    """How much of ``part`` lies in ``whole``."""
    return float(part.intersection(whole).area / max(part.area, 1e-9))
