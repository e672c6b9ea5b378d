"""Outlines of detections in pixels, and a few hundred sample pixels inside each."""

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

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx2, Int64Array, RowIndices

# Pitches between the detections in one search tree, so that no pixel finds those of another detection.
TREE_SEPARATION = 1e7
_NEIGHBOUR_PITCHES = 1.5  # reaches the eight neighbours of a sample in its lattice
_SIMPLIFY_SHARE = 0.002  # of the square root of a mask's area: tolerance of simplifying its outline
_LATTICE_POINTS_MAX = 10_000  # per mask; where too few of them lie inside, the mask is sampled along its outline


@dataclass(frozen=True, kw_only=True, eq=False)
class Outlines:
    """Outlines of n detections and k sample pixels inside them.

    ``polygon_img`` (n,) shapely polygons, in pixels; ``centre_img`` (n, 2) of the boxes; ``has_mask`` (n,): the outline
    is that of a mask, otherwise of the box; ``area_px2`` (n,); ``pitch_px`` (n, 2) of the sampling lattice.
    ``detection`` (k,): row of the n that a sample belongs to, ascending; ``xy_img`` (k, 2); ``weight`` (k,): likelihood
    that the defect is at the sample, adding up to 1 in each detection; ``neighbours`` (e, 2): pairs of samples that are
    adjacent in one detection.
    """

    polygon_img: NDArray[Any]
    centre_img: Float64Nx2
    has_mask: BoolArray
    area_px2: Float64N
    pitch_px: Float64Nx2
    detection: RowIndices
    xy_img: Float64Nx2
    weight: Float64N
    neighbours: Int64Array

    def __len__(self) -> int:
        return len(self.polygon_img)


@dataclass(frozen=True, kw_only=True, eq=False)
class _OutlineSamples:
    """Samples inside one outline; fields as in ``Outlines``."""

    polygon_img: Any
    pitch_px: Float64Array
    xy_img: Float64Nx2
    weight: Float64N
    neighbours: Int64Array


def sample_outlines(detections: Sequence[Mapping[str, Any]], side: int) -> Outlines:
    """Outlines of rows of table ``detections``: of the mask where there is one, otherwise of the box.

    A box is sampled at the centres of ``side`` x ``side`` equal cells, a mask by about as many samples on a lattice.
    A box is drawn around its defect, so its centre is more likely to be on the defect: the weights decrease linearly
    towards the edges. A mask is the defect itself; its weights are uniform.
    """
    boxes = np.array([[row[f"box_{name}_px"] for name in ("x", "y", "width", "height")] for row in detections])
    boxes = boxes.reshape(-1, 4)
    template = _build_box_template(side)
    masks = [_read_mask_polygon(row.get("mask"), box) for row, box in zip(detections, boxes, strict=True)]
    samples = [
        _sample_box(box, template, side) if mask is None else _sample_mask(mask, side * side)
        for mask, box in zip(masks, boxes, strict=True)
    ]
    counts = np.array([len(sample.xy_img) for sample in samples], dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]) if len(counts) else counts
    polygons = np.array([sample.polygon_img for sample in samples], dtype=object)
    return Outlines(
        polygon_img=polygons,
        centre_img=boxes[:, :2] + boxes[:, 2:] / 2,
        has_mask=np.array([mask is not None for mask in masks], dtype=bool),
        area_px2=shapely.area(polygons),
        pitch_px=np.array([sample.pitch_px for sample in samples]).reshape(-1, 2),
        detection=np.repeat(np.arange(len(samples)), counts),
        xy_img=np.concatenate([sample.xy_img for sample in samples]) if samples else np.zeros((0, 2)),
        weight=np.concatenate([sample.weight for sample in samples]) if samples else np.zeros(0),
        neighbours=np.concatenate([sample.neighbours + start for sample, start in zip(samples, first, strict=True)])
        if samples
        else np.zeros((0, 2), dtype=np.int64),
    )


def _build_box_template(side: int) -> _OutlineSamples:
    """Samples of the unit square."""
    share = (np.arange(side) + 0.5) / side
    index = np.arange(side * side).reshape(side, side)
    rows = np.column_stack([index[:, :-1].ravel(), index[:, 1:].ravel()])
    columns = np.column_stack([index[:-1].ravel(), index[1:].ravel()])
    centrality = 0.5 - np.abs(share - 0.5)
    weight = np.outer(centrality, centrality).ravel()
    return _OutlineSamples(
        polygon_img=None,
        pitch_px=np.ones(2) / side,
        xy_img=np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2),
        weight=weight / weight.sum(),
        neighbours=np.vstack([rows, columns]),
    )


def _sample_box(box: Float64Array, template: _OutlineSamples, side: int) -> _OutlineSamples:
    """The samples of the unit square, ``template``, in a box (4,): x, y, width, height in pixels."""
    return _OutlineSamples(
        polygon_img=shapely.box(box[0], box[1], box[0] + box[2], box[1] + box[3]),
        pitch_px=box[2:] / side,
        xy_img=box[:2] + template.xy_img * box[2:],
        weight=template.weight,
        neighbours=template.neighbours,
    )


def _read_mask_polygon(wkt: str | None, box: Float64Array) -> Any | None:
    """The polygon of a mask (WKT), clipped to its box; None where it has no area inside."""
    if wkt is None:
        return None
    mask = shapely.make_valid(shapely.from_wkt(wkt))
    mask = shapely.simplify(mask, _SIMPLIFY_SHARE * np.sqrt(mask.area))
    clipped = shapely.intersection(mask, shapely.box(box[0], box[1], box[0] + box[2], box[1] + box[3]))
    parts = [part for part in shapely.get_parts(clipped) if part.geom_type == "Polygon" and part.area > 0]
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def _sample_mask(mask: Any, count: int) -> _OutlineSamples:
    """About ``count`` samples of a mask on a square lattice; of a mask thinner than the pitch, also of its boundary."""
    left, top, right, bottom = mask.bounds
    pitch = max(
        float(np.sqrt(mask.area / count)), float(np.sqrt((right - left) * (bottom - top) / _LATTICE_POINTS_MAX))
    )
    columns = np.arange(left + pitch / 2, right + pitch / 2, pitch)
    rows = np.arange(top + pitch / 2, bottom + pitch / 2, pitch)
    lattice = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    shapely.prepare(mask)
    xy = lattice[shapely.contains_xy(mask, lattice[:, 0], lattice[:, 1])]
    if len(xy) < count // 4:  # the mask is thinner than the pitch
        boundary = shapely.segmentize(mask, max(mask.length / (2 * count), 1e-3))
        xy = np.vstack([xy, shapely.get_coordinates(boundary)])
    return _OutlineSamples(
        polygon_img=mask,
        pitch_px=np.full(2, pitch),
        xy_img=xy,
        weight=np.full(len(xy), 1.0 / len(xy)),
        neighbours=_connect_neighbours(xy, _NEIGHBOUR_PITCHES * pitch),
    )


def _connect_neighbours(xy: Float64Nx2, reach_px: float) -> Int64Array:
    """Pairs (e, 2) of points ``xy`` (k, 2) within ``reach_px``, and the shortest links between separate components."""
    tree = cKDTree(xy)
    pairs = tree.query_pairs(reach_px, output_type="ndarray").astype(np.int64)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(xy), len(xy)))
    components, component = connected_components(graph, directed=False)
    links = []
    connected = component == component[0]
    while not connected.all():
        inside, outside = np.flatnonzero(connected), np.flatnonzero(~connected)
        gap, nearest = cKDTree(xy[inside]).query(xy[outside])
        k = int(np.argmin(gap))
        links.append([inside[nearest[k]], outside[k]])
        connected |= component == component[outside[k]]
    return np.vstack([pairs, np.array(links, dtype=np.int64).reshape(-1, 2)]) if components > 1 else pairs
