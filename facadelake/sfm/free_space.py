"""Which tetrahedra of tie points the rays of sight cross: evidence of free space, and of matter behind the points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from facadelake.core.arrays import Float64Array, Int64Array

_PARALLEL_TOLERANCE = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class FacetCrossings:
    """Facets crossed by rays on their way from camera to point, and where the rays begin and end.

    ``tetrahedron`` (k,) is left through its facet ``facet`` (k,) (0 to 3: the vertex opposite), ``before_end`` (k,) is
    how far before the point that happened; ``begins`` are the cameras' tetrahedra, ``behind`` (rays,) those just
    behind each ray's point (-1: outside).
    """

    tetrahedron: Int64Array
    facet: Int64Array
    before_end: Float64Array
    begins: Int64Array
    behind: Int64Array


def walk_rays(
    delaunay: Delaunay, origins: Float64Array, ends: Float64Array, end_vertex: Int64Array, depth: Float64Array
) -> FacetCrossings:
    """Walk rays (n) from ``origins`` (n, 3) to ``ends`` (n, 3), which are vertices ``end_vertex`` (n,).

    ``depth`` (n,): how far behind its point a ray looks for matter. All rays step together, one tetrahedron at a time:
    a ray leaves a tetrahedron where its first barycentric coordinate vanishes.
    """
    direction = ends - origins
    length = np.linalg.norm(direction, axis=1)
    behind_at = ends + direction * (depth / length)[:, None]
    now = _locate_tetrahedra(delaunay, origins)
    begins = np.unique(now[now >= 0])
    ray = np.flatnonzero(now >= 0)
    now = now[ray]
    left, through, distance = [], [], []
    for _ in range(20 * int(np.cbrt(len(delaunay.simplices))) + 100):
        arrived = (delaunay.simplices[now] == end_vertex[ray, None]).any(axis=1)
        ray, now = ray[~arrived], now[~arrived]
        if len(ray) == 0:
            break
        at, facet = _find_exit(delaunay, now, origins[ray], direction[ray])
        onward = delaunay.neighbors[now, facet].astype(np.int64)
        good = np.isfinite(at) & (at < 1.0) & (onward >= 0)
        left.append(now[good])
        through.append(facet[good])
        distance.append((1.0 - at[good]) * length[ray[good]])
        ray, now = ray[good], onward[good]
    return FacetCrossings(
        tetrahedron=np.concatenate(left) if left else np.zeros(0, dtype=np.int64),
        facet=np.concatenate(through) if through else np.zeros(0, dtype=np.int64),
        before_end=np.concatenate(distance) if distance else np.zeros(0),
        begins=begins,
        behind=_locate_tetrahedra(delaunay, behind_at),
    )


def _locate_tetrahedra(delaunay: Delaunay, xyz: Float64Array) -> Int64Array:
    """The tetrahedron of each point (n, 3), -1 outside: each place once, neighbours in turn, for short searches."""
    places, which = np.unique(xyz, axis=0, return_inverse=True)
    low, high = places.min(axis=0), places.max(axis=0)
    cell = ((places - low) / np.maximum(high - low, 1e-300) * 63).astype(np.int64)
    cell[:, 1] = np.where(cell[:, 0] % 2, 63 - cell[:, 1], cell[:, 1])  # boustrophedon: no jumps between rows
    order = np.lexsort((cell[:, 2], cell[:, 1], cell[:, 0]))
    found = np.empty(len(places), dtype=np.int64)
    found[order] = delaunay.find_simplex(places[order])
    return found[which.ravel()]


def _find_exit(
    delaunay: Delaunay, tetrahedron: Int64Array, origin: Float64Array, direction: Float64Array
) -> tuple[Float64Array, Int64Array]:
    """Where along the ray (in its length) each tetrahedron is left, and through which facet; NaN for a flat one."""
    transform = delaunay.transform[tetrahedron]
    start = np.einsum("nij,nj->ni", transform[:, :3], origin - transform[:, 3])
    slope = np.einsum("nij,nj->ni", transform[:, :3], direction)
    start = np.column_stack([start, 1.0 - start.sum(axis=1)])
    slope = np.column_stack([slope, -slope.sum(axis=1)])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where(slope < -_PARALLEL_TOLERANCE * np.abs(slope).max(axis=1, keepdims=True), -start / slope, np.inf)
    facet = np.argmin(np.where(np.isnan(at), np.inf, at), axis=1)
    return at[np.arange(len(at)), facet], facet.astype(np.int64)
