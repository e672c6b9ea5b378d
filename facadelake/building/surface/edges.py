"""Extract the model's straight edges in 3D: creases and free borders of its surface, welded across elements.

Borders between abutting elements (piers and lintels of one wall) are included although photographs do not show them:
visibility depends on the view and is tested by rays (``facadelake.georeferencing.model.edge_samples``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from facadelake.core.arrays import Float64N, Float64Nx3, Int64Array, Int64Nx3, RowIndices

_WELD_M = 0.001
# Edges have no sense; their sign is taken from a vector along which no building is built.
_SIGN_VECTOR = np.array([0.613, 0.352, 0.707])


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelEdges:
    """Straight edge segments in site, without duplicates.

    ``start_site_m``, ``end_site_m`` (m, 3): end points. ``feature`` (m,): number of the feature, from 0. Edges of one
    feature are on one line of the building (a row of sills, the reveals of windows above one another); deviations of
    the building from its design are assumed to be common to them.
    """

    start_site_m: Float64Nx3
    end_site_m: Float64Nx3
    feature: Int64Array

    @property
    def length_m(self) -> Float64N:
        """Lengths (m,)."""
        length: Float64N = np.linalg.norm(self.end_site_m - self.start_site_m, axis=1)
        return length


def extract_model_edges(
    vertices_site_m: Float64Nx3,
    triangles: Int64Nx3,
    element_of_triangle: RowIndices,
    *,
    crease_deg: float = 25.0,
    min_length_m: float = 0.10,
    collinear_m: float = 0.005,
    feature_radius_m: float = 0.25,
) -> ModelEdges:
    """Extract the straight edges of a surface: borders of elements, and creases.

    Args:
        vertices_site_m: vertices (n, 3) in site.
        triangles: rows of the vertices (m, 3).
        element_of_triangle: row of each triangle's element (m,).
        crease_deg: minimum angle between the two faces of a crease; smaller angles are a meshed curve.
        min_length_m: shorter edges are omitted.
        collinear_m: segments of one line within this distance are joined.
        feature_radius_m: parallel lines within this distance of the longest of them are one feature.

    Returns:
        The edges in site; none for a mesh without triangles.
    """
    start, end = _find_creases(vertices_site_m, triangles, element_of_triangle, np.cos(np.radians(crease_deg)))
    length = np.linalg.norm(end - start, axis=1)
    kept = length > _WELD_M
    start, end = start[kept], end[kept]
    if len(start) == 0:
        return ModelEdges(start_site_m=start, end_site_m=end, feature=np.zeros(0, dtype=np.int64))
    centre = (start.min(axis=0) + start.max(axis=0)) / 2
    joined_start, joined_end, line = _join_collinear(start - centre, end - centre, collinear_m)
    is_long = np.linalg.norm(joined_end - joined_start, axis=1) >= min_length_m
    joined_start, joined_end, line = joined_start[is_long], joined_end[is_long], line[is_long]
    return ModelEdges(
        start_site_m=joined_start + centre,
        end_site_m=joined_end + centre,
        feature=_group_features(joined_start, joined_end, line, feature_radius_m),
    )


def _find_creases(
    vertices: Float64Nx3, triangles: Int64Nx3, element: RowIndices, flat_cosine: float
) -> tuple[Float64Nx3, Float64Nx3]:
    """End points (k, 3), (k, 3) of the creases and borders of each element's welded surface."""
    _, first, weld = np.unique(
        np.round(vertices / _WELD_M).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    corners = vertices[triangles]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    has_area = area > 1e-9
    faces, element = weld.ravel()[triangles[has_area]], element[has_area]
    normals = cross[has_area] / area[has_area, None]
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    face = np.repeat(np.arange(len(faces)), 3)
    has_length = ends[:, 0] != ends[:, 1]
    keys, group, count = np.unique(
        np.column_stack([element[face], ends])[has_length], axis=0, return_inverse=True, return_counts=True
    )
    # A crease is where the mean of the faces' normals is shorter than at the limiting angle; one face is a border.
    total = np.zeros((len(keys), 3))
    np.add.at(total, group.ravel(), normals[face[has_length]])
    mean = np.linalg.norm(total, axis=1) / count
    edge = (count == 1) | (mean < np.sqrt((1 + flat_cosine) / 2))
    return vertices[first[keys[edge, 1]]], vertices[first[keys[edge, 2]]]


def _compute_unit_directions(start: Float64Nx3, end: Float64Nx3) -> Float64Nx3:
    direction = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    unit: Float64Nx3 = direction * np.where(direction @ _SIGN_VECTOR < 0, -1.0, 1.0)[:, None]
    return unit


def _join_collinear(
    start: Float64Nx3, end: Float64Nx3, tolerance_m: float
) -> tuple[Float64Nx3, Float64Nx3, Int64Array]:
    """Join collinear edges that touch or overlap; returns segments (k, 3), (k, 3) and the line (k,) of each."""
    direction = _compute_unit_directions(start, end)
    foot = start - np.einsum("ij,ij->i", start, direction)[:, None] * direction
    lever_m = max(float(np.abs(np.concatenate([start, end])).max()), 1.0)  # converts angles to metres at the far end
    coordinates = np.hstack([direction * lever_m, foot])
    pairs = cKDTree(coordinates).query_pairs(tolerance_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(start), len(start)))
    _, line = connected_components(graph, directed=False)
    longest = np.zeros(line.max() + 1, dtype=np.int64)
    by_length = np.argsort(np.linalg.norm(end - start, axis=1))
    longest[line[by_length]] = by_length  # the longest is written last
    axis, origin = direction[longest[line]], foot[longest[line]]
    along = np.sort(np.column_stack([np.einsum("ij,ij->i", p, axis) for p in (start, end)]), axis=1)
    # Along each line, a segment begins where all segments before it have ended.
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


def _group_features(start: Float64Nx3, end: Float64Nx3, line: Int64Array, radius_m: float) -> Int64Array:
    """Feature (k,) of each segment: each line in order of length takes the ungrouped lines around it.

    Lines are not chained: the rungs of a ladder do not become one feature.
    """
    direction = _compute_unit_directions(start, end)
    foot = start - np.einsum("ij,ij->i", start, direction)[:, None] * direction
    lines, first, of_line = np.unique(line, return_index=True, return_inverse=True)
    length = np.bincount(of_line.ravel(), weights=np.linalg.norm(end - start, axis=1))
    # An angle of one degree counts as much as the radius.
    coordinates = np.hstack([direction[first] * (radius_m / np.radians(1.0)), foot[first]])
    tree = cKDTree(coordinates)
    feature = np.full(len(lines), -1, dtype=np.int64)
    for number, k in enumerate(np.argsort(-length)):
        if feature[k] < 0:
            near = np.array(tree.query_ball_point(coordinates[k], radius_m), dtype=np.int64)
            feature[near[feature[near] < 0]] = number
    return np.unique(feature, return_inverse=True)[1].ravel()[of_line.ravel()].astype(np.int64)
