"""Merging of the detections of overlapping tiles: one detection per object, however many tiles it crosses.

Neighbouring tiles overlap in a strip. An object that lies whole in one of two tiles is detected twice, or once whole
and once cut: the more complete detection is kept. An object cut by a tile's border continues in the tile beyond, in the
detection that agrees with it in the strip (``score_agreement``). Across one border each detection is linked to the one
that agrees best, so that a neighbouring object is not taken for the continuation; an unlinked branch may join.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.core.arrays import BoolArray, Float64N, Float64Nx4, RowIndices
from facadelake.detection.boxes import Box
from facadelake.detection.inference.detector import DetectedBox
from facadelake.detection.tiling.agreement import (
    compute_areas,
    compute_contained_shares,
    compute_iou,
    grow_boxes,
    intersect_boxes,
    score_agreement,
)
from facadelake.detection.tiling.plan import DetectorTile, TilePass

# A box that ends this near to a tile's border, in pixels of the model's input, is cut by it; edges vary by as much.
EDGE_TOLERANCE_PX = 8.0
# A cut detection with this share of its area in another detection is a part of it.
CONTAINED_SHARE_MIN = 0.6
# Smallest agreement in the strip of two detections of one object, and of a branch with an object linked already.
AGREEMENT_MIN = 0.25
BRANCH_AGREEMENT_MIN = 0.5


@dataclass(frozen=True, kw_only=True)
class TileDetection:
    """A detection in a tile, in pixels of the photograph."""

    tile: DetectorTile
    detection: DetectedBox


@dataclass(frozen=True, kw_only=True, eq=False)
class _TileDetections:
    """All detections (n) of a tile pass: corners (n, 4) clipped to their tiles (n, 4); ``cut`` (n, 4): sides cut."""

    detections: list[DetectedBox]
    corners: Float64Nx4
    tiles: Float64Nx4
    cut: BoolArray
    classes: RowIndices

    def unite_shapes(self, members: Sequence[int]) -> shapely.Geometry:
        """Union of the masks, or boxes, of several detections; closer than their bounding box."""
        return shapely.union_all([self.detections[i].mask or shapely.box(*self.corners[i]) for i in members])


@dataclass(frozen=True, kw_only=True, eq=False)
class _DetectionPairs:
    """Detections ``first`` and ``second`` (k,) of one class in different tiles, with their agreement (k,).

    ``cut_towards`` (k, 2): the first is cut at a side where the second's tile continues; the second where the first's
    does.
    """

    first: RowIndices
    second: RowIndices
    agreement: Float64N
    cut_towards: BoolArray


def merge_tile_detections(
    detections: Sequence[TileDetection], tile_pass: TilePass, *, width_px: int, height_px: int, nms_iou: float
) -> tuple[DetectedBox, ...]:
    """Merge the detections of the tiles of one pass.

    The score of a merged detection is the highest of its parts, its box their bounding box, its mask the union of their
    masks if each part has one.

    Args:
        detections: Detections of the tiles, in pixels of the photograph.
        tile_pass: The pass.
        width_px: Width of the photograph.
        height_px: Height of the photograph.
        nms_iou: Detections of one class with at least this IoU are of one object.

    Returns:
        One detection per object, highest score first.
    """
    if not detections:
        return ()
    tolerance_px = EDGE_TOLERANCE_PX / tile_pass.gain
    clipped = _clip_to_tiles(detections, (width_px, height_px), tolerance_px)
    pairs = _pair_detections(clipped, tolerance_px)
    duplicates = _find_duplicates(clipped, pairs, tolerance_px, nms_iou)
    links = np.concatenate([_link_cut_detections(clipped, pairs), duplicates])
    count = len(detections)
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    _, component = connected_components(graph, directed=False)
    members: dict[int, list[int]] = {}
    for i in np.setdiff1d(np.arange(count), duplicates[:, 0]):
        members.setdefault(int(component[i]), []).append(int(i))
    groups = _remove_fragments(clipped, list(members.values()), tolerance_px)
    merged = [(_merge_group(clipped, group), clipped.unite_shapes(group)) for group in groups]
    merged.sort(key=lambda detection_and_shape: -detection_and_shape[0].score)
    kept = _suppress_overlaps([detection for detection, _ in merged], [shape for _, shape in merged], nms_iou)
    return tuple(merged[i][0] for i in kept)


def _clip_to_tiles(
    detections: Sequence[TileDetection], size_px: tuple[int, int], tolerance_px: float
) -> _TileDetections:
    tiles = np.array([[d.tile.left, d.tile.top, d.tile.right, d.tile.bottom] for d in detections], dtype=np.float64)
    boxes = [d.detection.box for d in detections]
    corners = np.array([[b.x_px, b.y_px, b.x_px + b.width_px, b.y_px + b.height_px] for b in boxes])
    corners = np.column_stack(
        [np.clip(corners[:, side], tiles[:, side % 2], tiles[:, side % 2 + 2]) for side in range(4)]
    )
    inner = np.column_stack([tiles[:, :2] > 0, tiles[:, 2:] < np.array(size_px)])
    names = {name: i for i, name in enumerate(sorted({d.detection.class_name for d in detections}))}
    return _TileDetections(
        detections=[d.detection for d in detections],
        corners=corners,
        tiles=tiles,
        cut=inner & (np.abs(corners - tiles) <= tolerance_px),
        classes=np.array([names[d.detection.class_name] for d in detections], dtype=np.int64),
    )


def _pair_detections(clipped: _TileDetections, tolerance_px: float) -> _DetectionPairs:
    """Pairs of detections of one class in different tiles whose boxes touch."""
    boxes = shapely.box(*grow_boxes(clipped.corners, tolerance_px).T)
    first, second = shapely.STRtree(boxes).query(boxes, predicate="intersects").astype(np.int64)
    keep = (first < second) & (clipped.classes[first] == clipped.classes[second])
    keep &= (clipped.tiles[first] != clipped.tiles[second]).any(axis=1)
    first, second = first[keep], second[keep]
    masks = [detection.mask for detection in clipped.detections]
    overlap = intersect_boxes(clipped.tiles[first], clipped.tiles[second])
    return _DetectionPairs(
        first=first,
        second=second,
        agreement=score_agreement(clipped.corners, masks, first, second, overlap, tolerance_px),
        cut_towards=np.column_stack([_is_cut_towards(clipped, first, second), _is_cut_towards(clipped, second, first)]),
    )


def _is_cut_towards(clipped: _TileDetections, detection: RowIndices, other: RowIndices) -> BoolArray:
    """Whether each detection (k,) is cut at a side where the other's tile continues."""
    tile, other_tile = clipped.tiles[detection], clipped.tiles[other]
    continues = np.column_stack([other_tile[:, :2] < tile[:, :2], other_tile[:, 2:] > tile[:, 2:]])
    return np.asarray((clipped.cut[detection] & continues).any(axis=1))


def _link_cut_detections(clipped: _TileDetections, pairs: _DetectionPairs) -> RowIndices:
    """Pairs (m, 2) of detections of one object of which at least one is cut, best agreement first."""
    links: list[tuple[int, int]] = []
    linked_ends: set[tuple[int, ...]] = set()
    rejected: list[tuple[float, int, int]] = []
    for k in np.argsort(-pairs.agreement, kind="stable"):
        if pairs.agreement[k] < AGREEMENT_MIN or not pairs.cut_towards[k].any():
            continue
        a, b = int(pairs.first[k]), int(pairs.second[k])
        ends = {(a, *clipped.tiles[b].astype(int)), (b, *clipped.tiles[a].astype(int))}
        if linked_ends & ends:
            rejected.append((float(pairs.agreement[k]), a, b))
            continue
        linked_ends |= ends
        links.append((a, b))
    for agreement, a, b in rejected:
        ends = {(a, *clipped.tiles[b].astype(int)), (b, *clipped.tiles[a].astype(int))}
        if agreement >= BRANCH_AGREEMENT_MIN and len(linked_ends & ends) == 1:
            links.append((a, b))
    return np.array(links, dtype=np.int64).reshape(-1, 2)


def _find_duplicates(
    clipped: _TileDetections, pairs: _DetectionPairs, tolerance_px: float, nms_iou: float
) -> RowIndices:
    """Pairs (m, 2) of a duplicate and the better detection: the less cut one, else the one with the higher score."""
    a, b = clipped.corners[pairs.first], clipped.corners[pairs.second]
    intersection = compute_areas(intersect_boxes(a, b))
    equal = intersection / np.maximum(compute_areas(a) + compute_areas(b) - intersection, 1e-9) >= nms_iou
    shares = np.column_stack(
        [
            compute_contained_shares(a, grow_boxes(b, tolerance_px)),
            compute_contained_shares(b, grow_boxes(a, tolerance_px)),
        ]
    )
    contained = shares >= CONTAINED_SHARE_MIN
    cut_sides = clipped.cut.sum(axis=1)
    rank = np.lexsort([[-detection.score for detection in clipped.detections], cut_sides]).argsort()
    duplicates = []
    for k in np.flatnonzero((pairs.agreement >= AGREEMENT_MIN) & ~pairs.cut_towards.all(axis=1)):
        p, q = int(pairs.first[k]), int(pairs.second[k])
        if pairs.cut_towards[k].any():
            worse = 0 if pairs.cut_towards[k, 0] else 1
            if contained[k, worse]:
                duplicates.append((p, q) if worse == 0 else (q, p))
        elif equal[k]:
            duplicates.append((p, q) if rank[p] > rank[q] else (q, p))
    return np.array(duplicates, dtype=np.int64).reshape(-1, 2)


def _remove_fragments(clipped: _TileDetections, groups: list[list[int]], tolerance_px: float) -> list[list[int]]:
    """The groups without single cut detections that lie in another group of their class."""
    single = [k for k, group in enumerate(groups) if len(group) == 1 and clipped.cut[group[0]].any()]
    complete = [k for k, group in enumerate(groups) if len(group) > 1 or not clipped.cut[group[0]].any()]
    if not single or not complete:
        return groups
    shapes = [clipped.unite_shapes(groups[k]).buffer(tolerance_px) for k in complete]
    fragments = [clipped.unite_shapes(groups[k]) for k in single]
    removed = set()
    for i, j in zip(*shapely.STRtree(shapes).query(fragments, predicate="intersects"), strict=True):
        same_class = clipped.classes[groups[single[i]][0]] == clipped.classes[groups[complete[j]][0]]
        if same_class and fragments[i].intersection(shapes[j]).area >= CONTAINED_SHARE_MIN * fragments[i].area:
            removed.add(single[i])
    return [group for k, group in enumerate(groups) if k not in removed]


def _merge_group(clipped: _TileDetections, members: Sequence[int]) -> DetectedBox:
    best = max((clipped.detections[i] for i in members), key=lambda detection: detection.score)
    if len(members) == 1:
        return best
    corners = clipped.corners[list(members)]
    left, top = (float(value) for value in corners[:, :2].min(axis=0))
    right, bottom = (float(value) for value in corners[:, 2:].max(axis=0))
    masks = [clipped.detections[i].mask for i in members]
    mask = shapely.union_all(np.array(masks, dtype=object)) if all(mask is not None for mask in masks) else None
    return replace(best, box=Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top), mask=mask)


def _suppress_overlaps(
    detections: Sequence[DetectedBox], shapes: Sequence[shapely.Geometry], nms_iou: float
) -> list[int]:
    """Rows to keep of ``detections`` (n), highest score first: non-maximum suppression of shapes within each class."""
    neighbours: dict[int, list[int]] = {}
    for i, j in zip(*shapely.STRtree(shapes).query(shapes, predicate="intersects"), strict=True):
        if i < j and detections[i].class_name == detections[j].class_name:
            neighbours.setdefault(int(i), []).append(int(j))
    suppressed: set[int] = set()
    for i in range(len(detections)):
        if i not in suppressed:
            suppressed |= {j for j in neighbours.get(i, []) if compute_iou(shapes[i], shapes[j]) >= nms_iou}
    return [i for i in range(len(detections)) if i not in suppressed]
