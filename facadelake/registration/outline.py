"""What of a photograph a detection covers: its outline in pixels, and the few hundred pixels that stand for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array

TREE_SEPARATION = 1e7  # pitches; keeps the detections of one search tree apart
_NEIGHBOUR_PITCHES = 1.5  # of a mask's pixels, in pitches of its lattice: the eight around it
_SIMPLIFY_SHARE = 0.002  # of a mask's size: bends of its outline smaller than this are left out
_LATTICE_POINTS_MAX = (
    10_000  # lattice points about one mask; a mask thinner than this finds is sampled along its outline
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Outlines:
    """Outlines of n detections and k pixels inside them.

    ``polygon_img`` (n,) shapely, in pixels. ``centre_img`` (n, 2): of the box. ``has_mask`` (n,): a mask, not a box.
    ``area_px2`` (n,), ``pitch_px`` (n, 2) of the lattice of pixels. ``detection`` (k,) rows of the n, ascending;
    ``xy_img`` (k, 2); ``weight`` (k,), which adds up to 1 in each detection: how likely the defect is there. ``neighbours``
    (e, 2): pairs of the k that lie side by side in one detection.
    """

    polygon_img: NDArray[Any]
    centre_img: Float64Array
    has_mask: BoolArray
    area_px2: Float64Array
    pitch_px: Float64Array
    detection: Int64Array
    xy_img: Float64Array
    weight: Float64Array
    neighbours: Int64Array

    def __len__(self) -> int:
        return len(self.polygon_img)


@dataclass(frozen=True, kw_only=True, eq=False)
class _OutlineSamples:
    """Pixels inside one outline, as in ``Outlines``."""

    polygon_img: Any
    pitch_px: Float64Array
    xy_img: Float64Array
    weight: Float64Array
    neighbours: Int64Array


def sample_outlines(detections: Sequence[Mapping[str, Any]], side: int) -> Outlines:
    """Outlines of rows of table ``detections``: of the mask where there is one, else of the box.

    A box is sampled by ``side`` x ``side`` pixels in the middle of equal cells, a mask by about as many on a lattice.
    Boxes are drawn about defects, so their middle has more say in what the defect is on: the vote falls off linearly
    to the edges. A mask is the defect itself, and votes alike everywhere.
    """
    boxes = np.array([[row[f"box_{name}_px"] for name in ("x", "y", "width", "height")] for row in detections])
    boxes = boxes.reshape(-1, 4)
    template = _build_box_template(side)
    masks = [_read_mask_polygon(row.get("mask"), box) for row, box in zip(detections, boxes, strict=True)]
    insides = [
        _sample_box(box, template, side) if mask is None else _sample_mask(mask, side * side)
        for mask, box in zip(masks, boxes, strict=True)
    ]
    counts = np.array([len(inside.xy_img) for inside in insides], dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]) if len(counts) else counts
    polygons = np.array([inside.polygon_img for inside in insides], dtype=object)
    return Outlines(
        polygon_img=polygons,
        centre_img=boxes[:, :2] + boxes[:, 2:] / 2,
        has_mask=np.array([mask is not None for mask in masks], dtype=bool),
        area_px2=shapely.area(polygons),
        pitch_px=np.array([inside.pitch_px for inside in insides]).reshape(-1, 2),
        detection=np.repeat(np.arange(len(insides)), counts),
        xy_img=np.concatenate([inside.xy_img for inside in insides]) if insides else np.zeros((0, 2)),
        weight=np.concatenate([inside.weight for inside in insides]) if insides else np.zeros(0),
        neighbours=np.concatenate([inside.neighbours + start for inside, start in zip(insides, first, strict=True)])
        if insides
        else np.zeros((0, 2), dtype=np.int64),
    )


def _build_box_template(side: int) -> _OutlineSamples:
    """The unit box."""
    share = (np.arange(side) + 0.5) / side
    number = np.arange(side * side).reshape(side, side)
    rows = np.column_stack([number[:, :-1].ravel(), number[:, 1:].ravel()])
    columns = np.column_stack([number[:-1].ravel(), number[1:].ravel()])
    middle = 0.5 - np.abs(share - 0.5)
    vote = np.outer(middle, middle).ravel()
    return _OutlineSamples(
        polygon_img=None,
        pitch_px=np.ones(2) / side,
        xy_img=np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2),
        weight=vote / vote.sum(),
        neighbours=np.vstack([rows, columns]),
    )


def _sample_box(box: Float64Array, template: _OutlineSamples, side: int) -> _OutlineSamples:
    return _OutlineSamples(
        polygon_img=shapely.box(box[0], box[1], box[0] + box[2], box[1] + box[3]),
        pitch_px=box[2:] / side,
        xy_img=box[:2] + template.xy_img * box[2:],
        weight=template.weight,
        neighbours=template.neighbours,
    )


def _read_mask_polygon(text: str | None, box: Float64Array) -> Any | None:
    """The mask's polygon inside its box, None where there is none of any size."""
    if text is None:
        return None
    mask = shapely.make_valid(shapely.from_wkt(text))
    mask = shapely.simplify(mask, _SIMPLIFY_SHARE * np.sqrt(mask.area))
    cut = shapely.intersection(mask, shapely.box(box[0], box[1], box[0] + box[2], box[1] + box[3]))
    parts = [part for part in shapely.get_parts(cut) if part.geom_type == "Polygon" and part.area > 0]
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def _sample_mask(mask: Any, wanted: int) -> _OutlineSamples:
    left, top, right, bottom = mask.bounds
    pitch = max(
        float(np.sqrt(mask.area / wanted)), float(np.sqrt((right - left) * (bottom - top) / _LATTICE_POINTS_MAX))
    )
    columns = np.arange(left + pitch / 2, right + pitch / 2, pitch)
    rows = np.arange(top + pitch / 2, bottom + pitch / 2, pitch)
    lattice = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    shapely.prepare(mask)
    xy = lattice[shapely.contains_xy(mask, lattice[:, 0], lattice[:, 1])]
    if len(xy) < wanted // 4:  # thinner than its lattice
        along = shapely.segmentize(mask, max(mask.length / (2 * wanted), 1e-3))
        xy = np.vstack([xy, shapely.get_coordinates(along)])
    return _OutlineSamples(
        polygon_img=mask,
        pitch_px=np.full(2, pitch),
        xy_img=xy,
        weight=np.full(len(xy), 1.0 / len(xy)),
        neighbours=_connect_neighbours(xy, _NEIGHBOUR_PITCHES * pitch),
    )


def _connect_neighbours(xy: Float64Array, reach_px: float) -> Int64Array:
    """Pairs (e, 2) of points within reach, and the shortest bridges that make one whole of what is left in parts."""
    tree = cKDTree(xy)
    pairs = tree.query_pairs(reach_px, output_type="ndarray").astype(np.int64)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(xy), len(xy)))
    count, part = connected_components(graph, directed=False)
    bridges = []
    joined = part == part[0]
    while not joined.all():
        here, there = np.flatnonzero(joined), np.flatnonzero(~joined)
        gap, nearest = cKDTree(xy[here]).query(xy[there])
        k = int(np.argmin(gap))
        bridges.append([here[nearest[k]], there[k]])
        joined |= part == part[there[k]]
    return np.vstack([pairs, np.array(bridges, dtype=np.int64).reshape(-1, 2)]) if count > 1 else pairs
