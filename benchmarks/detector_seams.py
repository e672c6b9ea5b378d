"""Long cracks across many tiles: how often each method of merging duplicates, cuts, joins or misses a crack.

Cracks are random curves, some of them side by side. Detection is simulated: every tile yields a box for each part of a
crack inside it, with noise on the edges, except for a small share of missed parts. The results therefore differ by the
merging method only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely
import shapely.affinity
from scipy.optimize import linear_sum_assignment

from benchmarks.box_merging import fuse_boxes, merge_boxes, suppress_boxes
from facadelake.core.arrays import Float64N, Float64Nx4
from facadelake.detection import Box
from facadelake.detection.card import CardInput, ResizeMode
from facadelake.detection.inference import DetectedBox
from facadelake.detection.tiling.plan import TilePass, plan_tile_passes
from facadelake.detection.tiling.tile_merging import TileDetection, merge_tile_detections

WIDTH, HEIGHT, INPUT = 4000, 3000, 416
_IOU_MIN = 0.7  # smallest intersection over union of a box with the box of a crack that is detected as one
_CONTAINED_SHARE_MIN = 0.7  # smallest share of a box in another of which it is a part
_MISSED_SHARE = 0.03  # share of the parts of cracks without a detection
_LENGTH_MIN_PX = 12.0  # shorter parts have no detection
_HALF_WIDTH_PX = 2.0
_EDGE_MARGIN_PX = 6.0  # boxes are grown by it before comparison, so that noise on edges matters less for thin boxes


@dataclass(frozen=True, kw_only=True)
class CrackPattern:
    """Course of cracks.

    ``wander_deg``: sigma of the turn per step of 20 px. ``beside_px``: each long crack has two parallel ones at this
    spacing; None for no parallel ones. ``jitter_px``: sigma of the edges of detected boxes.
    """

    name: str
    wander_deg: float
    beside_px: float | None = None
    jitter_px: float = 2.0


PATTERNS = (
    CrackPattern(name="straight", wander_deg=0.5),
    CrackPattern(name="wandering", wander_deg=6.0),
    CrackPattern(name="winding", wander_deg=20.0),
    CrackPattern(name="beside 250 px", wander_deg=3.0, beside_px=250.0),
    CrackPattern(name="beside 80 px", wander_deg=3.0, beside_px=80.0),
)


def compare_merging_methods(scenes: int, seed: int = 7) -> Iterator[tuple[str, str, int, Counter[str]]]:
    """Pattern of cracks, merging method, number of cracks and counts of outcomes, over ``scenes`` photographs."""
    spec = CardInput(width_px=INPUT, height_px=INPUT, colour="bgr", scale=1.0, resize=ResizeMode.CORNER)
    tile_pass = plan_tile_passes(spec, width_px=WIDTH, height_px=HEIGHT)[0]
    for pattern in PATTERNS:
        rng = np.random.default_rng(seed)
        scenes_cracks = [_generate_cracks(rng, pattern) for _ in range(scenes)]
        seen = [_detect_in_tiles(rng, cracks, tile_pass, pattern) for cracks in scenes_cracks]
        for name, merge in _list_methods(tile_pass).items():
            total: Counter[str] = Counter()
            for cracks, (boxes, masks) in zip(scenes_cracks, seen, strict=True):
                truth = np.array([line.buffer(_HALF_WIDTH_PX).bounds for line in cracks])
                total.update(_count_outcomes(truth, merge(masks if name == "union, masks" else boxes)))
            yield pattern.name, name, sum(len(cracks) for cracks in scenes_cracks), total


def _list_methods(tile_pass: TilePass) -> dict[str, Callable[[Sequence[TileDetection]], Float64Nx4]]:
    return {
        "union": partial(_merge_tiles, tile_pass=tile_pass),
        "union, masks": partial(_merge_tiles, tile_pass=tile_pass),
        "NMS": lambda parts: suppress_boxes(*_list_boxes_and_scores(parts)),
        "NMM": lambda parts: merge_boxes(*_list_boxes_and_scores(parts)),
        "WBF": lambda parts: fuse_boxes(*_list_boxes_and_scores(parts)),
    }


def _generate_cracks(rng: np.random.Generator, pattern: CrackPattern) -> list[shapely.LineString]:
    """Nine or more cracks of 40 to 3,000 px inside the photograph."""
    cracks: list[shapely.LineString] = []
    frame = shapely.box(20, 20, WIDTH - 20, HEIGHT - 20)
    while len(cracks) < 9:
        steps = int(np.exp(rng.uniform(np.log(2), np.log(150))))
        heading = np.radians(rng.uniform(0, 360) + np.cumsum(rng.normal(0, pattern.wander_deg, steps)))
        path = np.cumsum(20 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
        line = shapely.LineString(np.vstack([[0, 0], path]) + rng.uniform((0, 0), (WIDTH, HEIGHT)))
        lines = [line]
        if pattern.beside_px is not None and line.length > 800:
            aside = pattern.beside_px * np.array([-np.sin(heading.mean()), np.cos(heading.mean())])
            lines += [shapely.affinity.translate(line, *(aside * k)) for k in (1, 2)]
        apart = all(one.distance(other) > 30 for one in lines for other in cracks)
        if apart and all(frame.contains(one) for one in lines):
            cracks += lines
    return cracks


def _detect_in_tiles(
    rng: np.random.Generator, cracks: Sequence[shapely.LineString], tile_pass: TilePass, pattern: CrackPattern
) -> tuple[list[TileDetection], list[TileDetection]]:
    """Simulated detections of all tiles: without and with masks."""
    boxes, masks = [], []
    for tile in tile_pass.tiles:
        frame = shapely.box(tile.left, tile.top, tile.right, tile.bottom)
        for line in cracks:
            inside = line.intersection(frame)
            for piece in getattr(inside, "geoms", [inside]):
                if piece.length < _LENGTH_MIN_PX or rng.random() < _MISSED_SHARE:
                    continue
                mask = piece.buffer(_HALF_WIDTH_PX).intersection(frame)
                left, top, right, bottom = np.array(mask.bounds) + rng.normal(0, pattern.jitter_px, 4)
                box = Box(x_px=left, y_px=top, width_px=max(right - left, 1.0), height_px=max(bottom - top, 1.0))
                found = DetectedBox(box=box, score=float(rng.uniform(0.4, 0.95)), class_name="crack")
                boxes.append(TileDetection(tile=tile, detection=found))
                masked = DetectedBox(box=box, score=found.score, class_name="crack", mask=mask)
                masks.append(TileDetection(tile=tile, detection=masked))
    return boxes, masks


def _merge_tiles(parts: Sequence[TileDetection], tile_pass: TilePass) -> Float64Nx4:
    found = merge_tile_detections(parts, tile_pass, width_px=WIDTH, height_px=HEIGHT, nms_iou=0.5)
    return _list_corners(found)


def _list_boxes_and_scores(parts: Sequence[TileDetection]) -> tuple[Float64Nx4, Float64N]:
    found = [part.detection for part in parts]
    return _list_corners(found), np.array([one.score for one in found])


def _list_corners(found: Sequence[DetectedBox]) -> Float64Nx4:
    boxes = [one.box for one in found]
    return np.array([[b.x_px, b.y_px, b.x_px + b.width_px, b.y_px + b.height_px] for b in boxes]).reshape(-1, 4)


def _count_outcomes(truth: Float64Nx4, found: Float64Nx4) -> Counter[str]:
    """Counts of cracks detected as one, duplicated, cut, joined to another or missed, and of extra boxes."""
    grow = np.array([-_EDGE_MARGIN_PX, -_EDGE_MARGIN_PX, _EDGE_MARGIN_PX, _EDGE_MARGIN_PX])
    large = shapely.box(*(truth + grow).T)[:, None]
    small = shapely.box(*(found + grow).T)[None, :]
    both = shapely.area(shapely.intersection(large, small))
    iou = both / (shapely.area(large) + shapely.area(small) - both)
    rows, columns = linear_sum_assignment(-iou)
    good = iou[rows, columns] >= _IOU_MIN
    right, used = set(rows[good].tolist()), set(columns[good].tolist())
    over = [j for j in range(len(found)) if j not in used]
    piece = both / shapely.area(small) >= _CONTAINED_SHARE_MIN
    counts: Counter[str] = Counter({"as one": len(right), "extra boxes": len(over)})
    counts["duplicated"] = sum(any(piece[i, j] for j in over) for i in right)
    for i in set(range(len(truth))) - right:
        inside = [j for j in over if piece[i, j]]
        around = [j for j in over if both[i, j] >= _CONTAINED_SHARE_MIN * shapely.area(large[i, 0])]
        counts["cut" if inside else "joined" if around else "missed"] += 1
    return counts
