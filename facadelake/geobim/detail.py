"""How much an element's body shows."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from facadelake.geobim.mesh import ElementMesh

_BOX_PLANES = 6
_DETAILED_PLANES = 100
_DETAILED_BODIES = 3  # a frame, its panes, its handle
_SAME_M = 0.002


def detail_level(mesh: ElementMesh) -> str:
    """``box``: at most six planes; ``detailed``: three separate bodies or more, or over 100 planes; else ``body``."""
    corners = mesh.vertices_ifc_m[mesh.triangles] - mesh.vertices_ifc_m.mean(axis=0)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset = np.einsum("ij,ij->i", normal, corners[:, 0])
    planes = len(np.unique(np.column_stack([np.round(normal * 50), np.round(offset / _SAME_M)]), axis=0))
    count = len(mesh.vertices_ifc_m)
    edges = np.vstack([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]]]).T
    graph = coo_array((np.ones(edges.shape[1], dtype=bool), (edges[0], edges[1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1][mesh.triangles[:, 0]]
    if planes > _DETAILED_PLANES or len(np.unique(labels)) >= _DETAILED_BODIES:
        return "detailed"
    return "box" if planes <= _BOX_PLANES else "body"
