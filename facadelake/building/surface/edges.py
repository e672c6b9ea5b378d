"""The model's straight edges in 3D: creases and free borders of its surface, welded across elements.

Where elements abut (a wall made of piers and lintels), their borders stay in the list although nothing is to be seen
there: what is visible depends on the view, and is asked of the rays (``facadelake.georeferencing.model.edge_samples``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from facadelake.core.arrays import Float64Array, Int64Array

_WELD_M = 0.001
# Directions have no sign; the sign is taken from a vector that no building is built along.
_SIGN = np.array([0.613, 0.352, 0.707])


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelEdges:
    """Straight pieces of edges in site, without duplicates.

    ``start_site_m``, ``end_site_m`` (m, 3); ``feature`` (m,) counts from 0: edges of one feature lie along one line of
    the building (a row of sills, the reveals of windows above one another) and are taken to move together where the
    building was not built as designed.
    """

    start_site_m: Float64Array
    end_site_m: Float64Array
    feature: Int64Array

    @property
    def length_m(self) -> Float64Array:
        """Lengths (m,)."""
        length: Float64Array = np.linalg.norm(self.end_site_m - self.start_site_m, axis=1)
        return length


def extract_model_edges(
    vertices_site_m: Float64Array,
    triangles: Int64Array,
    element_of_triangle: Int64Array,
    *,
    crease_deg: float = 25.0,
    shortest_m: float = 0.10,
    same_line_m: float = 0.005,
    feature_radius_m: float = 0.25,
) -> ModelEdges:
    """Edges of a triangle mesh (n, 3), (m, 3) whose triangles belong to elements (m,).

    An edge is a border of an element's surface, or a crease: its two faces turn by more than ``crease_deg`` (less is
    a curve that the mesh made of flat pieces). Collinear pieces (within ``same_line_m``) are joined, what is shorter
    than ``shortest_m`` is left out. Parallel lines within ``feature_radius_m`` of the longest of them are one feature.
    """
    start, end = _find_creases(vertices_site_m, triangles, element_of_triangle, np.cos(np.radians(crease_deg)))
    length = np.linalg.norm(end - start, axis=1)
    kept = length > _WELD_M
    start, end = start[kept], end[kept]
    if len(start) == 0:
        return ModelEdges(start_site_m=start, end_site_m=end, feature=np.zeros(0, dtype=np.int64))
    middle = (start.min(axis=0) + start.max(axis=0)) / 2
    joined_start, joined_end, line = _join_collinear(start - middle, end - middle, same_line_m)
    long_enough = np.linalg.norm(joined_end - joined_start, axis=1) >= shortest_m
    joined_start, joined_end, line = joined_start[long_enough], joined_end[long_enough], line[long_enough]
    return ModelEdges(
        start_site_m=joined_start + middle,
        end_site_m=joined_end + middle,
        feature=_group_features(joined_start, joined_end, line, feature_radius_m),
    )


def _find_creases(
    vertices: Float64Array, triangles: Int64Array, owner: Int64Array, flat_cosine: float
) -> tuple[Float64Array, Float64Array]:
    """Ends (k, 3) of the creases and borders of each element's own welded surface."""
    _, place, weld = np.unique(
        np.round(vertices / _WELD_M).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    corners = vertices[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    good = area > 1e-9
    faces, normals, owner = weld.ravel()[triangles[good]], cross[good] / area[good, None], owner[good]
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    face = np.repeat(np.arange(len(faces)), 3)
    real = ends[:, 0] != ends[:, 1]
    keys, group, count = np.unique(
        np.column_stack([owner[face], ends])[real], axis=0, return_inverse=True, return_counts=True
    )
    # Faces turn where their normals' mean is shorter than that of two faces at the limit; a lone face is a border.
    total = np.zeros((len(keys), 3))
    np.add.at(total, group.ravel(), normals[face[real]])
    mean = np.linalg.norm(total, axis=1) / count
    edge = (count == 1) | (mean < np.sqrt((1 + flat_cosine) / 2))
    return vertices[place[keys[edge, 1]]], vertices[place[keys[edge, 2]]]


def _compute_unit_directions(start: Float64Array, end: Float64Array) -> Float64Array:
    direction = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    unit: Float64Array = direction * np.where(direction @ _SIGN < 0, -1.0, 1.0)[:, None]
    return unit


def _join_collinear(
    start: Float64Array, end: Float64Array, tolerance_m: float
) -> tuple[Float64Array, Float64Array, Int64Array]:
    """Pieces (k, 3), (k, 3) and the line (k,) each lies on: collinear edges joined where they touch or overlap."""
    direction = _compute_unit_directions(start, end)
    foot = start - np.einsum("ij,ij->i", start, direction)[:, None] * direction
    reach = max(float(np.abs(np.concatenate([start, end])).max()), 1.0)  # what a turn moves at the far end
    place = np.hstack([direction * reach, foot])
    pairs = cKDTree(place).query_pairs(tolerance_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(start), len(start)))
    _, line = connected_components(graph, directed=False)
    leader = np.zeros(line.max() + 1, dtype=np.int64)
    by_length = np.argsort(np.linalg.norm(end - start, axis=1))
    leader[line[by_length]] = by_length  # the longest is written last
    axis, origin = direction[leader[line]], foot[leader[line]]
    along = np.sort(np.column_stack([np.einsum("ij,ij->i", p, axis) for p in (start, end)]), axis=1)
    # Along each line from low to high: a piece begins where all before it on the line have ended.
    order = np.lexsort((along[:, 0], line))
    line, along, axis, origin = line[order], along[order], axis[order], origin[order]
    span = float(along.max() - along.min()) + 1.0
    ended = np.maximum.accumulate(along[:, 1] + line * span) - line * span
    begins = np.flatnonzero(np.r_[True, (line[1:] != line[:-1]) | (along[1:, 0] > ended[:-1] + tolerance_m)])
    last = np.r_[begins[1:], len(line)] - 1
    return (
        origin[begins] + along[begins, :1] * axis[begins],
        origin[begins] + ended[last, None] * axis[begins],
        line[begins].astype(np.int64),
    )


def _group_features(start: Float64Array, end: Float64Array, line: Int64Array, radius_m: float) -> Int64Array:
    """Feature (k,) of pieces: lines are taken in the order of their length, each with the free ones around it.

    No chains: the rungs of a ladder do not become one feature.
    """
    direction = _compute_unit_directions(start, end)
    foot = start - np.einsum("ij,ij->i", start, direction)[:, None] * direction
    lines, first, of_line = np.unique(line, return_index=True, return_inverse=True)
    length = np.bincount(of_line.ravel(), weights=np.linalg.norm(end - start, axis=1))
    # A turn of one degree is as far as the radius.
    place = np.hstack([direction[first] * (radius_m / np.radians(1.0)), foot[first]])
    tree = cKDTree(place)
    feature = np.full(len(lines), -1, dtype=np.int64)
    for number, k in enumerate(np.argsort(-length)):
        if feature[k] < 0:
            near = np.array(tree.query_ball_point(place[k], radius_m), dtype=np.int64)
            feature[near[feature[near] < 0]] = number
    return np.unique(feature, return_inverse=True)[1].ravel()[of_line.ravel()].astype(np.int64)
