"""What a tile's border cut, put together again: a long crack is one crack, and two side by side are two.

Neighbouring tiles share a strip. What lies whole in one of them is told twice, or once whole and once cut: the better
view stands. What a border cut goes on in the tile beyond it, with the part there that agrees with it in the strip
(``score_agreement``). Of several that could go together across one border, each part takes the one that fits best, so that
a neighbour is not taken for the rest; a branch, which nobody takes, may join.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
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

# A box that ends so near a tile's border, in pixels of the model's input, was cut by it; edges jitter by as much.
EDGE_TOLERANCE_PX = 8.0
# A cut part that lies in another thing by this much of its area is a part of it.
CONTAINED_SHARE_MIN = 0.6
# How well two parts must agree in the strip to be taken for one; and a branch with what is taken already.
AGREEMENT_MIN = 0.25
BRANCH_AGREEMENT_MIN = 0.5


@dataclass(frozen=True, kw_only=True)
class TileDetection:
    """What was found in a tile, in pixels of the photograph."""

    tile: DetectorTile
    detection: DetectedBox


@dataclass(frozen=True, kw_only=True, eq=False)
class _TileDetections:
    """All parts (n) of a look: corners (n, 4) cut to their tiles (n, 4), and their cut sides (n, 4)."""

    detection: list[DetectedBox]
    corners: Float64Array
    tiles: Float64Array
    cut: BoolArray
    classes: RowIndices

    def unite_shapes(self, members: Sequence[int]) -> shapely.Geometry:
        """Where parts lie: their masks, or boxes; closer than the one box about them."""
        return shapely.union_all([self.detection[i].mask or shapely.box(*self.corners[i]) for i in members])


@dataclass(frozen=True, kw_only=True, eq=False)
class _DetectionPairs:
    """Parts ``first`` and ``second`` (k) of one class whose tiles differ, and how well they agree where both look.

    ``cut_towards`` (k, 2): was the first cut where the second's tile goes on; and the second where the first's does?
    """

    first: RowIndices
    second: RowIndices
    agreement: Float64Array
    cut_towards: BoolArray


def merge_tile_detections(
    parts: Sequence[TileDetection], look: TilePass, *, width_px: int, height_px: int, nms_iou: float
) -> tuple[DetectedBox, ...]:
    """The parts of one look as whole things, the best first, in a photograph of ``width_px`` x ``height_px``.

    A thing's score is its best part's. Its box is what bounds its parts; its mask, where every part has one, their
    union. ``nms_iou``: what overlaps by more tells of the same thing.
    """
    if not parts:
        return ()
    slack_px = EDGE_TOLERANCE_PX / look.gain
    known = _clip_to_tiles(parts, (width_px, height_px), slack_px)
    pairs = _pair_detections(known, slack_px)
    twice = _find_duplicates(known, pairs, slack_px, nms_iou)
    links = np.concatenate([_link_cut_detections(known, pairs), twice])
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(parts), len(parts)))
    _, group = connected_components(graph, directed=False)
    members: dict[int, list[int]] = {}
    for i in np.setdiff1d(np.arange(len(parts)), twice[:, 0]):
        members.setdefault(int(group[i]), []).append(int(i))
    groups = _remove_fragments(known, list(members.values()), slack_px)
    things = [(_merge_group(known, ones), known.unite_shapes(ones)) for ones in groups]
    things.sort(key=lambda thing: -thing[0].score)
    kept = _suppress_overlaps([found for found, _ in things], [cover for _, cover in things], nms_iou)
    return tuple(things[i][0] for i in kept)


def _clip_to_tiles(parts: Sequence[TileDetection], size: tuple[int, int], slack_px: float) -> _TileDetections:
    tiles = np.array([[p.tile.left, p.tile.top, p.tile.right, p.tile.bottom] for p in parts], dtype=np.float64)
    boxes = [part.detection.box for part in parts]
    corners = np.array([[b.x_px, b.y_px, b.x_px + b.width_px, b.y_px + b.height_px] for b in boxes])
    corners = np.column_stack(
        [np.clip(corners[:, side], tiles[:, side % 2], tiles[:, side % 2 + 2]) for side in range(4)]
    )
    inner = np.column_stack([tiles[:, :2] > 0, tiles[:, 2:] < np.array(size)])
    names = {name: i for i, name in enumerate(sorted({part.detection.class_name for part in parts}))}
    return _TileDetections(
        detection=[part.detection for part in parts],
        corners=corners,
        tiles=tiles,
        cut=inner & (np.abs(corners - tiles) <= slack_px),
        classes=np.array([names[part.detection.class_name] for part in parts], dtype=np.int64),
    )


def _pair_detections(known: _TileDetections, slack_px: float) -> _DetectionPairs:
    """Parts of one class in different tiles whose boxes touch."""
    boxes = shapely.box(*grow_boxes(known.corners, slack_px).T)
    first, second = shapely.STRtree(boxes).query(boxes, predicate="intersects").astype(np.int64)
    keep = (first < second) & (known.classes[first] == known.classes[second])
    keep &= (known.tiles[first] != known.tiles[second]).any(axis=1)
    first, second = first[keep], second[keep]
    window = intersect_boxes(known.tiles[first], known.tiles[second])
    return _DetectionPairs(
        first=first,
        second=second,
        agreement=score_agreement(
            known.corners, [one.mask for one in known.detection], first, second, window, slack_px
        ),
        cut_towards=np.column_stack([_is_cut_towards(known, first, second), _is_cut_towards(known, second, first)]),
    )


def _is_cut_towards(known: _TileDetections, part: RowIndices, other: RowIndices) -> BoolArray:
    """Which parts (k,) were cut at a side beyond which the other's tile goes on."""
    mine, beyond = known.tiles[part], known.tiles[other]
    further = np.column_stack([beyond[:, :2] < mine[:, :2], beyond[:, 2:] > mine[:, 2:]])
    return np.asarray((known.cut[part] & further).any(axis=1))


def _link_cut_detections(known: _TileDetections, pairs: _DetectionPairs) -> RowIndices:
    """Pairs (m, 2) of parts that are one thing, of which a border cut at least one."""
    chosen: list[tuple[int, int]] = []
    taken: set[tuple[int, ...]] = set()
    left: list[tuple[float, int, int]] = []
    for k in np.argsort(-pairs.agreement, kind="stable"):
        if pairs.agreement[k] < AGREEMENT_MIN or not pairs.cut_towards[k].any():
            continue
        a, b = int(pairs.first[k]), int(pairs.second[k])
        ends = {(a, *known.tiles[b].astype(int)), (b, *known.tiles[a].astype(int))}
        if taken & ends:
            left.append((float(pairs.agreement[k]), a, b))
            continue
        taken |= ends
        chosen.append((a, b))
    for fit, a, b in left:
        ends = {(a, *known.tiles[b].astype(int)), (b, *known.tiles[a].astype(int))}
        if fit >= BRANCH_AGREEMENT_MIN and len(taken & ends) == 1:
            chosen.append((a, b))
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def _find_duplicates(known: _TileDetections, pairs: _DetectionPairs, slack_px: float, nms_iou: float) -> RowIndices:
    """Pairs (m, 2) of a part and the one that shows it better: whole where it is cut, or alike with a better score."""
    a, b = known.corners[pairs.first], known.corners[pairs.second]
    both = compute_areas(intersect_boxes(a, b))
    alike = both / np.maximum(compute_areas(a) + compute_areas(b) - both, 1e-9) >= nms_iou
    within = (
        np.column_stack(
            [compute_contained_shares(a, grow_boxes(b, slack_px)), compute_contained_shares(b, grow_boxes(a, slack_px))]
        )
        >= CONTAINED_SHARE_MIN
    )
    cuts = known.cut.sum(axis=1)
    rank = np.lexsort([[-one.score for one in known.detection], cuts]).argsort()
    found = []
    for k in np.flatnonzero((pairs.agreement >= AGREEMENT_MIN) & ~pairs.cut_towards.all(axis=1)):
        p, q = int(pairs.first[k]), int(pairs.second[k])
        if pairs.cut_towards[k].any():
            worse = 0 if pairs.cut_towards[k, 0] else 1
            if within[k, worse]:
                found.append((p, q) if worse == 0 else (q, p))
        elif alike[k]:
            found.append((p, q) if rank[p] > rank[q] else (q, p))
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _remove_fragments(known: _TileDetections, groups: list[list[int]], slack_px: float) -> list[list[int]]:
    """The groups but those of a single cut part that lies where another thing of its class is."""
    alone = [k for k, ones in enumerate(groups) if len(ones) == 1 and known.cut[ones[0]].any()]
    whole = [k for k, ones in enumerate(groups) if len(ones) > 1 or not known.cut[ones[0]].any()]
    if not alone or not whole:
        return groups
    covers = [known.unite_shapes(groups[k]).buffer(slack_px) for k in whole]
    scraps = [known.unite_shapes(groups[k]) for k in alone]
    gone = set()
    for i, j in zip(*shapely.STRtree(covers).query(scraps, predicate="intersects"), strict=True):
        same = known.classes[groups[alone[i]][0]] == known.classes[groups[whole[j]][0]]
        if same and scraps[i].intersection(covers[j]).area >= CONTAINED_SHARE_MIN * scraps[i].area:
            gone.add(alone[i])
    return [ones for k, ones in enumerate(groups) if k not in gone]


def _merge_group(known: _TileDetections, members: Sequence[int]) -> DetectedBox:
    best = max((known.detection[i] for i in members), key=lambda one: one.score)
    if len(members) == 1:
        return best
    corners = known.corners[list(members)]
    left, top = (float(value) for value in corners[:, :2].min(axis=0))
    right, bottom = (float(value) for value in corners[:, 2:].max(axis=0))
    masks = [known.detection[i].mask for i in members]
    mask = shapely.union_all(np.array(masks, dtype=object)) if all(one is not None for one in masks) else None
    return replace(best, box=Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top), mask=mask)


def _suppress_overlaps(found: Sequence[DetectedBox], covers: Sequence[shapely.Geometry], nms_iou: float) -> list[int]:
    """Which of ``detection`` (n), the best first, to keep: of those of a class whose covers overlap by more, the first."""
    near: dict[int, list[int]] = {}
    for i, j in zip(*shapely.STRtree(covers).query(covers, predicate="intersects"), strict=True):
        if i < j and found[i].class_name == found[j].class_name:
            near.setdefault(int(i), []).append(int(j))
    gone: set[int] = set()
    for i in range(len(found)):
        if i not in gone:
            gone |= {j for j in near.get(i, []) if compute_iou(covers[i], covers[j]) >= nms_iou}
    return [i for i in range(len(found)) if i not in gone]
