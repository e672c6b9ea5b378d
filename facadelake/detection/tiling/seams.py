"""What a tile's border cut, put together again: a long crack is one crack, and two side by side are two.

Neighbouring tiles share a strip. What lies whole in one of them is told twice, or once whole and once cut: the better
view stands. What a border cut goes on in the tile beyond it, with the part there that agrees with it in the strip
(``agreement``). Of several that could go together across one border, each part takes the one that fits best, so that
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
from facadelake.detection.inference.detector import Found
from facadelake.detection.tiling.agreement import agreement, areas, common, grown, overlap, shares
from facadelake.detection.tiling.plan import Look, Tile

# A box that ends so near a tile's border, in pixels of the model's input, was cut by it; edges jitter by as much.
EDGE_PX = 8.0
# A cut part that lies in another thing by this much of its area is a part of it.
WITHIN = 0.6
# How well two parts must agree in the strip to be taken for one; and a branch with what is taken already.
AGREE = 0.25
BRANCH = 0.5


@dataclass(frozen=True, kw_only=True)
class TileFound:
    """What was found in a tile, in pixels of the photograph."""

    tile: Tile
    found: Found


@dataclass(frozen=True, kw_only=True, eq=False)
class _Parts:
    """All parts (n) of a look: corners (n, 4) cut to their tiles (n, 4), and their cut sides (n, 4)."""

    found: list[Found]
    corners: Float64Array
    tiles: Float64Array
    cut: BoolArray
    classes: RowIndices

    def covers(self, members: Sequence[int]) -> shapely.Geometry:
        """Where parts lie: their masks, or boxes; closer than the one box about them."""
        return shapely.union_all([self.found[i].mask or shapely.box(*self.corners[i]) for i in members])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pairs:
    """Parts ``first`` and ``second`` (k) of one class whose tiles differ, and how well they agree where both look.

    ``onwards`` (k, 2): was the first cut where the second's tile goes on; and the second where the first's does?
    """

    first: RowIndices
    second: RowIndices
    fit: Float64Array
    onwards: BoolArray


def united_parts(
    parts: Sequence[TileFound], look: Look, *, width_px: int, height_px: int, nms_iou: float
) -> tuple[Found, ...]:
    """The parts of one look as whole things, the best first, in a photograph of ``width_px`` x ``height_px``.

    A thing's score is its best part's. Its box is what bounds its parts; its mask, where every part has one, their
    union. ``nms_iou``: what overlaps by more tells of the same thing.
    """
    if not parts:
        return ()
    slack_px = EDGE_PX / look.gain
    known = _prepared(parts, (width_px, height_px), slack_px)
    pairs = _pairs(known, slack_px)
    twice = _told_twice(known, pairs, slack_px, nms_iou)
    links = np.concatenate([_continued(known, pairs), twice])
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(parts), len(parts)))
    _, group = connected_components(graph, directed=False)
    members: dict[int, list[int]] = {}
    for i in np.setdiff1d(np.arange(len(parts)), twice[:, 0]):
        members.setdefault(int(group[i]), []).append(int(i))
    groups = _without_scraps(known, list(members.values()), slack_px)
    things = [(_thing(known, ones), known.covers(ones)) for ones in groups]
    things.sort(key=lambda thing: -thing[0].score)
    kept = _suppressed([found for found, _ in things], [cover for _, cover in things], nms_iou)
    return tuple(things[i][0] for i in kept)


def _prepared(parts: Sequence[TileFound], size: tuple[int, int], slack_px: float) -> _Parts:
    tiles = np.array([[p.tile.left, p.tile.top, p.tile.right, p.tile.bottom] for p in parts], dtype=np.float64)
    boxes = [part.found.box for part in parts]
    corners = np.array([[b.x_px, b.y_px, b.x_px + b.width_px, b.y_px + b.height_px] for b in boxes])
    corners = np.column_stack(
        [np.clip(corners[:, side], tiles[:, side % 2], tiles[:, side % 2 + 2]) for side in range(4)]
    )
    inner = np.column_stack([tiles[:, :2] > 0, tiles[:, 2:] < np.array(size)])
    names = {name: i for i, name in enumerate(sorted({part.found.class_name for part in parts}))}
    return _Parts(
        found=[part.found for part in parts],
        corners=corners,
        tiles=tiles,
        cut=inner & (np.abs(corners - tiles) <= slack_px),
        classes=np.array([names[part.found.class_name] for part in parts], dtype=np.int64),
    )


def _pairs(known: _Parts, slack_px: float) -> _Pairs:
    """Parts of one class in different tiles whose boxes touch."""
    boxes = shapely.box(*grown(known.corners, slack_px).T)
    first, second = shapely.STRtree(boxes).query(boxes, predicate="intersects").astype(np.int64)
    keep = (first < second) & (known.classes[first] == known.classes[second])
    keep &= (known.tiles[first] != known.tiles[second]).any(axis=1)
    first, second = first[keep], second[keep]
    window = common(known.tiles[first], known.tiles[second])
    return _Pairs(
        first=first,
        second=second,
        fit=agreement(known.corners, [one.mask for one in known.found], first, second, window, slack_px),
        onwards=np.column_stack([_onwards(known, first, second), _onwards(known, second, first)]),
    )


def _onwards(known: _Parts, part: RowIndices, other: RowIndices) -> BoolArray:
    """Which parts (k,) were cut at a side beyond which the other's tile goes on."""
    mine, beyond = known.tiles[part], known.tiles[other]
    further = np.column_stack([beyond[:, :2] < mine[:, :2], beyond[:, 2:] > mine[:, 2:]])
    return np.asarray((known.cut[part] & further).any(axis=1))


def _continued(known: _Parts, pairs: _Pairs) -> RowIndices:
    """Pairs (m, 2) of parts that are one thing, of which a border cut at least one."""
    chosen: list[tuple[int, int]] = []
    taken: set[tuple[int, ...]] = set()
    left: list[tuple[float, int, int]] = []
    for k in np.argsort(-pairs.fit, kind="stable"):
        if pairs.fit[k] < AGREE or not pairs.onwards[k].any():
            continue
        a, b = int(pairs.first[k]), int(pairs.second[k])
        ends = {(a, *known.tiles[b].astype(int)), (b, *known.tiles[a].astype(int))}
        if taken & ends:
            left.append((float(pairs.fit[k]), a, b))
            continue
        taken |= ends
        chosen.append((a, b))
    for fit, a, b in left:
        ends = {(a, *known.tiles[b].astype(int)), (b, *known.tiles[a].astype(int))}
        if fit >= BRANCH and len(taken & ends) == 1:
            chosen.append((a, b))
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def _told_twice(known: _Parts, pairs: _Pairs, slack_px: float, nms_iou: float) -> RowIndices:
    """Pairs (m, 2) of a part and the one that shows it better: whole where it is cut, or alike with a better score."""
    a, b = known.corners[pairs.first], known.corners[pairs.second]
    both = areas(common(a, b))
    alike = both / np.maximum(areas(a) + areas(b) - both, 1e-9) >= nms_iou
    within = np.column_stack([shares(a, grown(b, slack_px)), shares(b, grown(a, slack_px))]) >= WITHIN
    cuts = known.cut.sum(axis=1)
    rank = np.lexsort([[-one.score for one in known.found], cuts]).argsort()
    found = []
    for k in np.flatnonzero((pairs.fit >= AGREE) & ~pairs.onwards.all(axis=1)):
        p, q = int(pairs.first[k]), int(pairs.second[k])
        if pairs.onwards[k].any():
            worse = 0 if pairs.onwards[k, 0] else 1
            if within[k, worse]:
                found.append((p, q) if worse == 0 else (q, p))
        elif alike[k]:
            found.append((p, q) if rank[p] > rank[q] else (q, p))
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _without_scraps(known: _Parts, groups: list[list[int]], slack_px: float) -> list[list[int]]:
    """The groups but those of a single cut part that lies where another thing of its class is."""
    alone = [k for k, ones in enumerate(groups) if len(ones) == 1 and known.cut[ones[0]].any()]
    whole = [k for k, ones in enumerate(groups) if len(ones) > 1 or not known.cut[ones[0]].any()]
    if not alone or not whole:
        return groups
    covers = [known.covers(groups[k]).buffer(slack_px) for k in whole]
    scraps = [known.covers(groups[k]) for k in alone]
    gone = set()
    for i, j in zip(*shapely.STRtree(covers).query(scraps, predicate="intersects"), strict=True):
        same = known.classes[groups[alone[i]][0]] == known.classes[groups[whole[j]][0]]
        if same and scraps[i].intersection(covers[j]).area >= WITHIN * scraps[i].area:
            gone.add(alone[i])
    return [ones for k, ones in enumerate(groups) if k not in gone]


def _thing(known: _Parts, members: Sequence[int]) -> Found:
    best = max((known.found[i] for i in members), key=lambda one: one.score)
    if len(members) == 1:
        return best
    corners = known.corners[list(members)]
    left, top = (float(value) for value in corners[:, :2].min(axis=0))
    right, bottom = (float(value) for value in corners[:, 2:].max(axis=0))
    masks = [known.found[i].mask for i in members]
    mask = shapely.union_all(np.array(masks, dtype=object)) if all(one is not None for one in masks) else None
    return replace(best, box=Box(x_px=left, y_px=top, width_px=right - left, height_px=bottom - top), mask=mask)


def _suppressed(found: Sequence[Found], covers: Sequence[shapely.Geometry], nms_iou: float) -> list[int]:
    """Which of ``found`` (n), the best first, to keep: of those of a class whose covers overlap by more, the first."""
    near: dict[int, list[int]] = {}
    for i, j in zip(*shapely.STRtree(covers).query(covers, predicate="intersects"), strict=True):
        if i < j and found[i].class_name == found[j].class_name:
            near.setdefault(int(i), []).append(int(j))
    gone: set[int] = set()
    for i in range(len(found)):
        if i not in gone:
            gone |= {j for j in near.get(i, []) if overlap(covers[i], covers[j]) >= nms_iou}
    return [i for i in range(len(found)) if i not in gone]
