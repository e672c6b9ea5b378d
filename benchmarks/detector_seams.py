"""Long cracks across many tiles: how often each way to unite the tiles' boxes doubles, cuts, glues or misses one.

Cracks are drawn as wandering lines, some of them side by side. A detector without a weakness but its tiles sees of each
what lies in a tile, with edges that jitter, and now and then nothing: what differs is the uniting alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.box_merging import Boxes, nmm, nms, wbf
from facadelake.detection import Box
from facadelake.detection.card import CardInput, ResizeMode
from facadelake.detection.inference import DetectedBox
from facadelake.detection.tiling.plan import TilePass, plan_tile_passes
from facadelake.detection.tiling.tile_merging import TileDetection, merge_tile_detections

WIDTH, HEIGHT, INPUT = 4000, 3000, 416
_RIGHT = 0.7  # intersection over union with the crack's own box, from which it was found as one
_WITHIN = 0.7  # share of a box in another, from which it is a piece of it
_MISSED = 0.03  # of a crack's parts
_LEAST_PX = 12.0  # shorter parts are not seen
_HALF_WIDTH_PX = 2.0
_EDGES_PX = 6.0  # boxes are compared grown by this much: edges that jitter say little of a thin box


@dataclass(frozen=True, kw_only=True)
class Kind:
    """How cracks run: ``wander_deg`` a step of 20 px; with ``beside_px`` each has two others that far beside it."""

    name: str
    wander_deg: float
    beside_px: float | None = None
    jitter_px: float = 2.0


KINDS = (
    Kind(name="straight", wander_deg=0.5),
    Kind(name="wandering", wander_deg=6.0),
    Kind(name="winding", wander_deg=20.0),
    Kind(name="beside 250 px", wander_deg=3.0, beside_px=250.0),
    Kind(name="beside 80 px", wander_deg=3.0, beside_px=80.0),
)


def compare(scenes: int, seed: int = 7) -> Iterator[tuple[str, str, int, Counter[str]]]:
    """Kind of crack, way of uniting, number of cracks, and what became of them."""
    spec = CardInput(width_px=INPUT, height_px=INPUT, colour="bgr", scale=1.0, resize=ResizeMode.CORNER)
    tile_pass = plan_tile_passes(spec, width_px=WIDTH, height_px=HEIGHT)[0]
    for kind in KINDS:
        rng = np.random.default_rng(seed)
        made = [_cracks(rng, kind) for _ in range(scenes)]
        seen = [_seen(rng, cracks, tile_pass, kind) for cracks in made]
        for name, unite in _list_methods(tile_pass).items():
            total: Counter[str] = Counter()
            for cracks, (boxes, masks) in zip(made, seen, strict=True):
                truth = np.array([line.buffer(_HALF_WIDTH_PX).bounds for line in cracks])
                total.update(_judged(truth, unite(masks if name == "union, masks" else boxes)))
            yield kind.name, name, sum(len(cracks) for cracks in made), total


def _list_methods(tile_pass: TilePass) -> dict[str, Callable[[Sequence[TileDetection]], Boxes]]:
    return {
        "union": partial(_merge_tiles, tile_pass=tile_pass),
        "union, masks": partial(_merge_tiles, tile_pass=tile_pass),
        "NMS": lambda parts: nms(*_arrays(parts)),
        "NMM": lambda parts: nmm(*_arrays(parts)),
        "WBF": lambda parts: wbf(*_arrays(parts)),
    }


def _cracks(rng: np.random.Generator, kind: Kind) -> list[shapely.LineString]:
    """Some cracks of 40 to 3,000 px inside the photograph."""
    cracks: list[shapely.LineString] = []
    frame = shapely.box(20, 20, WIDTH - 20, HEIGHT - 20)
    while len(cracks) < 9:
        steps = int(np.exp(rng.uniform(np.log(2), np.log(150))))
        heading = np.radians(rng.uniform(0, 360) + np.cumsum(rng.normal(0, kind.wander_deg, steps)))
        path = np.cumsum(20 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
        line = shapely.LineString(np.vstack([[0, 0], path]) + rng.uniform((0, 0), (WIDTH, HEIGHT)))
        lines = [line]
        if kind.beside_px is not None and line.length > 800:
            aside = kind.beside_px * np.array([-np.sin(heading.mean()), np.cos(heading.mean())])
            lines += [shapely.affinity.translate(line, *(aside * k)) for k in (1, 2)]
        apart = all(one.distance(other) > 30 for one in lines for other in cracks)
        if apart and all(frame.contains(one) for one in lines):
            cracks += lines
    return cracks


def _seen(
    rng: np.random.Generator, cracks: Sequence[shapely.LineString], tile_pass: TilePass, kind: Kind
) -> tuple[list[TileDetection], list[TileDetection]]:
    """What the tiles show of the cracks: boxes alone, and with masks."""
    boxes, masks = [], []
    for tile in tile_pass.tiles:
        frame = shapely.box(tile.left, tile.top, tile.right, tile.bottom)
        for line in cracks:
            inside = line.intersection(frame)
            for piece in getattr(inside, "geoms", [inside]):
                if piece.length < _LEAST_PX or rng.random() < _MISSED:
                    continue
                mask = piece.buffer(_HALF_WIDTH_PX).intersection(frame)
                left, top, right, bottom = np.array(mask.bounds) + rng.normal(0, kind.jitter_px, 4)
                box = Box(x_px=left, y_px=top, width_px=max(right - left, 1.0), height_px=max(bottom - top, 1.0))
                found = DetectedBox(box=box, score=float(rng.uniform(0.4, 0.95)), class_name="crack")
                boxes.append(TileDetection(tile=tile, detection=found))
                masked = DetectedBox(box=box, score=found.score, class_name="crack", mask=mask)
                masks.append(TileDetection(tile=tile, detection=masked))
    return boxes, masks


def _merge_tiles(parts: Sequence[TileDetection], tile_pass: TilePass) -> Boxes:
    found = merge_tile_detections(parts, tile_pass, width_px=WIDTH, height_px=HEIGHT, nms_iou=0.5)
    return _boxes(found)


def _arrays(parts: Sequence[TileDetection]) -> tuple[Boxes, NDArray[np.float64]]:
    found = [part.detection for part in parts]
    return _boxes(found), np.array([one.score for one in found])


def _boxes(found: Sequence[DetectedBox]) -> Boxes:
    boxes = [one.box for one in found]
    return np.array([[b.x_px, b.y_px, b.x_px + b.width_px, b.y_px + b.height_px] for b in boxes]).reshape(-1, 4)


def _judged(truth: Boxes, found: Boxes) -> Counter[str]:
    """Cracks found as one, cut, glued to another or missed; and boxes over and above."""
    grow = np.array([-_EDGES_PX, -_EDGES_PX, _EDGES_PX, _EDGES_PX])
    large = shapely.box(*(truth + grow).T)[:, None]
    small = shapely.box(*(found + grow).T)[None, :]
    both = shapely.area(shapely.intersection(large, small))
    iou = both / (shapely.area(large) + shapely.area(small) - both)
    rows, columns = linear_sum_assignment(-iou)
    good = iou[rows, columns] >= _RIGHT
    right, used = set(rows[good].tolist()), set(columns[good].tolist())
    over = [j for j in range(len(found)) if j not in used]
    piece = both / shapely.area(small) >= _WITHIN
    said: Counter[str] = Counter({"as one": len(right), "boxes too many": len(over)})
    said["doubled"] = sum(any(piece[i, j] for j in over) for i in right)
    for i in set(range(len(truth))) - right:
        inside = [j for j in over if piece[i, j]]
        around = [j for j in over if both[i, j] >= _WITHIN * shapely.area(large[i, 0])]
        said["cut" if inside else "glued" if around else "missed"] += 1
    return said
