"""Detections of one photograph that are parts of one defect, cut by a tile seam or an occluder.

Otherwise a photograph shows each defect once, so two of its detections are two defects.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx4, RowIndices
from facadelake.deduplication.average_linkage import label_groups
from facadelake.deduplication.candidate_pairs import ObservationPairs
from facadelake.deduplication.observations import ObservationArrays

_SEAM_PX = 1.0  # boxes cut by one seam end on one line, to rounding
_ALIGNED_SHARE = 0.9  # common part of both boxes' sides along a seam, where there is no other evidence
_COLLINEAR_SHARE = 0.5  # common part of both boxes' sides across the cut, over the shorter side
_GAP_SHARE = 0.5  # maximum gap behind an occluder, over the sum of both boxes' lengths
_COVERED_SHARE = 0.7  # of a patch that an observation of the whole defect covers
# Minimum extent, and area, of an observation of the whole defect, over those of both parts together.
_WHOLE_SHARE = 0.85


def find_units(observations: ObservationArrays, pairs: ObservationPairs) -> RowIndices:
    """Units of observations (n,), from 0 in the order of first rows; most observations are units of their own.

    Two detections of one photograph and class are parts of one unit where their boxes are in line and more of the other
    photographs show both as one defect than as two; or where they meet at a line, their sides continue beyond it, and
    no other photograph shows two. Neighbours that merely touch, like the arms of a cracked corner, are two.
    """
    i, j = _find_adjacent_boxes(observations)
    gap, common, aligned, length = _measure_alignment(observations.box_img[i], observations.box_img[j])
    in_line = np.flatnonzero((common >= _COLLINEAR_SHARE) & (gap >= -_SEAM_PX) & (gap <= _GAP_SHARE * length))
    as_one, as_two = _count_other_photographs(observations, pairs, i, j, in_line)
    i, j = i[in_line], j[in_line]
    same_unit = (as_one > as_two) | (
        (np.abs(gap[in_line]) <= _SEAM_PX) & (aligned[in_line] >= _ALIGNED_SHARE) & (as_two == 0)
    )
    count = len(observations)
    graph = coo_array((np.ones(int(same_unit.sum())), (i[same_unit], j[same_unit])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    return label_groups(label.astype(np.int64))


def merge_units(observations: ObservationArrays, unit: RowIndices) -> ObservationArrays:
    """One observation per ``unit`` (n,): the bounding rectangle of its parts, on the surface of the largest part."""
    if len(observations) == 0 or unit.max() + 1 == len(observations):
        return observations
    area = observations.width_m * observations.height_m
    order = np.lexsort((np.arange(len(unit)), -area, unit))
    main = order[np.r_[True, np.diff(unit[order]) != 0]]
    values = {field.name: getattr(observations, field.name)[main] for field in fields(ObservationArrays)}
    across, upward = (axis[main][unit] for axis in observations.compute_tangents())
    offset = observations.xyz_site_m - observations.xyz_site_m[main][unit]
    shift = np.zeros((len(main), 3))
    for name, axis in (("width_m", across), ("height_m", upward)):
        along, half = np.einsum("ij,ij->i", offset, axis), getattr(observations, name) / 2
        low, high = np.full(len(main), np.inf), np.full(len(main), -np.inf)
        np.minimum.at(low, unit, along - half)
        np.maximum.at(high, unit, along + half)
        values[name] = high - low
        shift += ((low + high) / 2)[:, None] * axis[order[np.searchsorted(unit[order], np.arange(len(main)))]]
    centre = values["xyz_site_m"] - values["distance_m"][:, None] * values["ray_site"]
    ray = values["xyz_site_m"] + shift - centre
    values["distance_m"] = np.linalg.norm(ray, axis=1)
    values["xyz_site_m"], values["ray_site"] = centre + ray, ray / values["distance_m"][:, None]
    return ObservationArrays(**values)


def _find_adjacent_boxes(observations: ObservationArrays) -> tuple[RowIndices, RowIndices]:
    """Pairs (k,) of one photograph and class whose boxes are no farther apart than an occluder may separate them."""
    no_rows = np.zeros(0, dtype=np.int64)
    box = observations.box_img
    rows = np.flatnonzero(np.isfinite(box).all(axis=1))
    if len(rows) < 2:
        return no_rows, no_rows
    photo_class = (
        observations.photo[rows] * (int(observations.defect_class.max()) + 1) + observations.defect_class[rows]
    ) * 1e7
    points = np.column_stack([box[rows, :2] + box[rows, 2:] / 2, photo_class])
    reach = (1 + 2 * _GAP_SHARE) * box[rows, 2:].max(axis=1)  # from the longer of two boxes to the other's centre
    tree = cKDTree(points)
    nearest = tree.query(points, k=2)[0][:, 1]
    near = np.flatnonzero(nearest <= reach)
    lists = tree.query_ball_point(points[near], reach[near])
    owner = np.repeat(near, [len(found) for found in lists])
    other = np.concatenate([no_rows, *(np.asarray(found, dtype=np.int64) for found in lists)])
    pairs = np.unique(np.sort(np.column_stack([owner, other])[owner != other], axis=1), axis=0)
    return rows[pairs[:, 0]], rows[pairs[:, 1]]


def _measure_alignment(a: Float64Nx4, b: Float64Nx4) -> tuple[Float64N, Float64N, Float64N, Float64N]:
    """Alignment of pairs of boxes.

    Args:
        a: boxes (k, 4): x, y, width, height in pixels.
        b: boxes (k, 4).

    Returns:
        Gap (k,) along the axis in which the boxes are separated, negative where they overlap; across it, their common
            part
        over the shorter side (k,) and over the union of both sides (k,); sum of their lengths along it (k,). Without
            boxes
        the shares are 0.
    """
    low, high = np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    gap = low - high
    axis = (gap[:, 1] > gap[:, 0]).astype(np.int64)
    rows = np.arange(len(a))
    side_a, side_b, overlap = a[rows, 3 - axis], b[rows, 3 - axis], -gap[rows, 1 - axis]
    common = np.nan_to_num(overlap / np.minimum(side_a, side_b))
    common_of_union = np.nan_to_num(overlap / (side_a + side_b - overlap))
    return gap[rows, axis], common, common_of_union, (a[:, 2:] + b[:, 2:])[rows, axis]


def _count_other_photographs(
    observations: ObservationArrays, pairs: ObservationPairs, i: RowIndices, j: RowIndices, in_line: RowIndices
) -> tuple[Float64N, Float64N]:
    """How other photographs show pairs of adjacent detections.

    Args:
        observations: the observations (n).
        pairs: candidate pairs of them.
        i: first rows of all adjacent detections.
        j: their second rows.
        in_line: those (k,) of ``i`` and ``j`` that are in line.

    Returns:
        Number (k,) of observations that cover both as one defect, and of pairs that show them as two.
    """
    count = len(observations)
    if len(in_line) == 0:
        return np.zeros(0), np.zeros(0)

    def build_adjacency(first: RowIndices, second: RowIndices) -> csr_array:
        return csr_array((np.ones(2 * len(first)), (np.r_[first, second], np.r_[second, first])), shape=(count, count))

    same_class = observations.defect_class[pairs.first] == observations.defect_class[pairs.second]
    same_photo = observations.photo[pairs.first] == observations.photo[pairs.second]
    covers = same_class & ~same_photo & (pairs.overlap >= _COVERED_SHARE)
    covered = build_adjacency(pairs.first[covers], pairs.second[covers])
    adjacent = build_adjacency(i, j)
    i, j = i[in_line], j[in_line]
    row, whole = covered[i].multiply(covered[j]).tocoo().coords
    large = _are_as_large(observations, i[row], j[row], whole)
    as_one = np.bincount(row[large], minlength=len(i)).astype(np.float64)
    as_two: Float64Array = np.asarray(
        (covered[i] @ adjacent).multiply(covered[j]).sum(axis=1), dtype=np.float64
    ).ravel()
    return as_one, as_two


def _are_as_large(observations: ObservationArrays, i: RowIndices, j: RowIndices, whole: RowIndices) -> BoolArray:
    """Whether the patches of observations are as large as those of two others together.

    Args:
        observations: the observations (n).
        i: rows (k,) of one part.
        j: rows (k,) of the other part.
        whole: rows (k,) of the observations that are compared.
    """
    area, is_enough = np.ones(len(i)), np.ones(len(i), dtype=bool)
    difference = observations.xyz_site_m[j] - observations.xyz_site_m[i]
    for extent, axes in zip(
        (observations.width_m, observations.height_m), observations.compute_tangents(), strict=True
    ):
        along = np.einsum("ij,ij->i", difference, axes[i])
        low = np.minimum(-extent[i] / 2, along - extent[j] / 2)
        span = np.maximum(extent[i] / 2, along + extent[j] / 2) - low
        is_enough &= extent[whole] >= _WHOLE_SHARE * span
        area *= span
    large: BoolArray = is_enough & (observations.width_m[whole] * observations.height_m[whole] >= _WHOLE_SHARE * area)
    return large
