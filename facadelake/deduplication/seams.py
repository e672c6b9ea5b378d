"""Detections of one photograph that are one defect: those that a tile's seam or something before the wall cut.

Else a photograph shows each defect once, so two of its detections are two defects.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from facadelake.core.arrays import BoolArray, Float64Array, RowIndices
from facadelake.deduplication.linkage import label_groups
from facadelake.deduplication.observations import ObservationArrays
from facadelake.deduplication.pairs import ObservationPairs

_SEAM_PX = 1.0  # boxes cut by one seam end on one line, to rounding
_ALIGNED_SHARE = 0.9  # share of both boxes' sides along a seam that they have in common, where nothing else tells
_COLLINEAR_SHARE = 0.5  # share of the narrower box's side that both have in common across the cut
_GAP_SHARE = 0.5  # of both boxes' lengths together that an occluder may hide
_COVERED_SHARE = 0.7  # share of a patch that a sighting of the whole defect covers
_WHOLE_SHARE = 0.85  # of both patches' extent, and area, together that a sighting of the whole has at least


def find_units(sightings: ObservationArrays, pairs: ObservationPairs) -> RowIndices:
    """What each sighting (n,) is a part of: 0 on, in the order of first rows; most are whole.

    Two detections of one photograph and class are parts of one where their boxes lie in one line and more of the other
    photographs show both as one than as two; or where they meet at a line, their sides go on beyond it, and no other
    photograph shows two. Neighbours that merely touch, as the arms of a cracked corner do, are two.
    """
    i, j = _find_adjacent_boxes(sightings)
    gap, common, level, length = _measure_alignment(sightings.box_img[i], sightings.box_img[j])
    line = np.flatnonzero((common >= _COLLINEAR_SHARE) & (gap >= -_SEAM_PX) & (gap <= _GAP_SHARE * length))
    as_one, as_two = _count_other_photographs(sightings, pairs, i, j, line)
    i, j = i[line], j[line]
    cut = (as_one > as_two) | ((np.abs(gap[line]) <= _SEAM_PX) & (level[line] >= _ALIGNED_SHARE) & (as_two == 0))
    count = len(sightings)
    graph = coo_array((np.ones(int(cut.sum())), (i[cut], j[cut])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    return label_groups(label.astype(np.int64))


def merge_units(sightings: ObservationArrays, unit: RowIndices) -> ObservationArrays:
    """One sighting for each unit: its parts' rectangle on the surface of the largest part."""
    if len(sightings) == 0 or unit.max() + 1 == len(sightings):
        return sightings
    area = sightings.width_m * sightings.height_m
    order = np.lexsort((np.arange(len(unit)), -area, unit))
    main = order[np.r_[True, np.diff(unit[order]) != 0]]
    values = {field.name: getattr(sightings, field.name)[main] for field in fields(ObservationArrays)}
    across, upward = (axis[main][unit] for axis in sightings.compute_tangents())
    off = sightings.xyz_site_m - sightings.xyz_site_m[main][unit]
    moved = np.zeros((len(main), 3))
    for name, axis in (("width_m", across), ("height_m", upward)):
        along, half = np.einsum("ij,ij->i", off, axis), getattr(sightings, name) / 2
        low, high = np.full(len(main), np.inf), np.full(len(main), -np.inf)
        np.minimum.at(low, unit, along - half)
        np.maximum.at(high, unit, along + half)
        values[name] = high - low
        moved += ((low + high) / 2)[:, None] * axis[order[np.searchsorted(unit[order], np.arange(len(main)))]]
    centre = values["xyz_site_m"] - values["distance_m"][:, None] * values["ray_site"]
    away = values["xyz_site_m"] + moved - centre
    values["distance_m"] = np.linalg.norm(away, axis=1)
    values["xyz_site_m"], values["ray_site"] = centre + away, away / values["distance_m"][:, None]
    return ObservationArrays(**values)


def _find_adjacent_boxes(sightings: ObservationArrays) -> tuple[RowIndices, RowIndices]:
    """Pairs (k,) of one photograph and class whose boxes lie no further apart than an occluder may part them."""
    none = np.zeros(0, dtype=np.int64)
    box = sightings.box_img
    rows = np.flatnonzero(np.isfinite(box).all(axis=1))
    if len(rows) < 2:
        return none, none
    sheet = (sightings.photo[rows] * (int(sightings.defect_class.max()) + 1) + sightings.defect_class[rows]) * 1e7
    points = np.column_stack([box[rows, :2] + box[rows, 2:] / 2, sheet])
    reach = (1 + 2 * _GAP_SHARE) * box[rows, 2:].max(axis=1)  # the longer of two boxes reaches the other's centre
    tree = cKDTree(points)
    nearest = tree.query(points, k=2)[0][:, 1]
    near = np.flatnonzero(nearest <= reach)
    lists = tree.query_ball_point(points[near], reach[near])
    mine = np.repeat(near, [len(found) for found in lists])
    other = np.concatenate([none, *(np.asarray(found, dtype=np.int64) for found in lists)])
    pairs = np.unique(np.sort(np.column_stack([mine, other])[mine != other], axis=1), axis=0)
    return rows[pairs[:, 0]], rows[pairs[:, 1]]


def _measure_alignment(
    a: Float64Array, b: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Gap (k,) between boxes (k, 4) along the side on which they part; across it, what both have in common as a share
    of the narrower one and of both; and both lengths along it together. Without boxes the shares are 0."""
    low, high = np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    gap = low - high  # negative: they overlap
    axis = (gap[:, 1] > gap[:, 0]).astype(np.int64)
    rows = np.arange(len(a))
    side_a, side_b, both = a[rows, 3 - axis], b[rows, 3 - axis], -gap[rows, 1 - axis]
    common = np.nan_to_num(both / np.minimum(side_a, side_b))
    level = np.nan_to_num(both / (side_a + side_b - both))
    return gap[rows, axis], common, level, (a[:, 2:] + b[:, 2:])[rows, axis]


def _count_other_photographs(
    sightings: ObservationArrays, pairs: ObservationPairs, i: RowIndices, j: RowIndices, line: RowIndices
) -> tuple[Float64Array, Float64Array]:
    """How many sightings of other photographs cover both of the pairs ``line`` (k,) of ``i``, ``j``, and how many pairs
    show them as two."""
    count = len(sightings)
    if len(line) == 0:
        return np.zeros(0), np.zeros(0)

    def table(first: RowIndices, second: RowIndices) -> csr_array:
        return csr_array((np.ones(2 * len(first)), (np.r_[first, second], np.r_[second, first])), shape=(count, count))

    alike = sightings.defect_class[pairs.first] == sightings.defect_class[pairs.second]
    same = sightings.photo[pairs.first] == sightings.photo[pairs.second]
    cover = alike & ~same & (pairs.overlap >= _COVERED_SHARE)
    covered = table(pairs.first[cover], pairs.second[cover])
    beside = table(i, j)
    i, j = i[line], j[line]
    row, whole = covered[i].multiply(covered[j]).tocoo().coords
    large = _are_as_large(sightings, i[row], j[row], whole)
    as_one = np.bincount(row[large], minlength=len(i)).astype(np.float64)
    as_two: Float64Array = np.asarray((covered[i] @ beside).multiply(covered[j]).sum(axis=1), dtype=np.float64).ravel()
    return as_one, as_two


def _are_as_large(sightings: ObservationArrays, i: RowIndices, j: RowIndices, whole: RowIndices) -> BoolArray:
    """Whether the patch of each sighting ``whole`` (k,) is as large as those of ``i`` and ``j`` (k,) together."""
    area, enough = np.ones(len(i)), np.ones(len(i), dtype=bool)
    apart = sightings.xyz_site_m[j] - sightings.xyz_site_m[i]
    for extent, axes in zip((sightings.width_m, sightings.height_m), sightings.compute_tangents(), strict=True):
        along = np.einsum("ij,ij->i", apart, axes[i])
        low = np.minimum(-extent[i] / 2, along - extent[j] / 2)
        span = np.maximum(extent[i] / 2, along + extent[j] / 2) - low
        enough &= extent[whole] >= _WHOLE_SHARE * span
        area *= span
    large: BoolArray = enough & (sightings.width_m[whole] * sightings.height_m[whole] >= _WHOLE_SHARE * area)
    return large
