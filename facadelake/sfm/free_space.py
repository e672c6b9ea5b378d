"""Tetrahedra of the tie points that rays cross (free space), and those behind the points (solid)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from facadelake.core.arrays import Float64N, Float64Nx3, Int64Array

_PARALLEL_TOLERANCE = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class FacetCrossings:
    """Facets of tetrahedra crossed by rays on their way from camera to point.

    ``tetrahedron`` (k,) is left through its facet ``facet`` (k,) (0 to 3: opposite the vertex of that number), at
    ``distance_to_end`` (k,) before the point of the ray. ``camera_tetrahedra`` contain the cameras;
    ``solid_tetrahedron`` (rays,) is the one just behind each ray's point (-1: outside).
    """

    tetrahedron: Int64Array
    facet: Int64Array
    distance_to_end: Float64N
    camera_tetrahedra: Int64Array
    solid_tetrahedron: Int64Array


def walk_rays(
    delaunay: Delaunay, origins: Float64Nx3, ends: Float64Nx3, end_vertex: Int64Array, depth: Float64N
) -> FacetCrossings:
    """Facets that rays cross from cameras to tie points.

    All rays advance together, one tetrahedron at a time: a ray leaves a tetrahedron where its first barycentric
    coordinate vanishes.

    Args:
        delaunay: tetrahedra of the tie points and of a bounding box.
        origins: projection centres (n, 3), in the frame of the tetrahedra.
        ends: points (n, 3) at which the rays end.
        end_vertex: index (n,) of the tetrahedra's vertex that each end is.
        depth: distance (n,) behind its end at which a ray looks for the solid tetrahedron.

    Returns:
        The crossings of all rays, in no particular order.
    """
    direction = ends - origins
    length = np.linalg.norm(direction, axis=1)
    xyz_solid = ends + direction * (depth / length)[:, None]
    tetrahedron = _locate_tetrahedra(delaunay, origins)
    camera_tetrahedra = np.unique(tetrahedron[tetrahedron >= 0])
    ray = np.flatnonzero(tetrahedron >= 0)
    tetrahedron = tetrahedron[ray]
    tetrahedra, facets, distance = [], [], []
    for _ in range(20 * int(np.cbrt(len(delaunay.simplices))) + 100):
        arrived = (delaunay.simplices[tetrahedron] == end_vertex[ray, None]).any(axis=1)
        ray, tetrahedron = ray[~arrived], tetrahedron[~arrived]
        if len(ray) == 0:
            break
        exit_at, facet = _find_exit(delaunay, tetrahedron, origins[ray], direction[ray])
        neighbour = delaunay.neighbors[tetrahedron, facet].astype(np.int64)
        crosses = np.isfinite(exit_at) & (exit_at < 1.0) & (neighbour >= 0)
        tetrahedra.append(tetrahedron[crosses])
        facets.append(facet[crosses])
        distance.append((1.0 - exit_at[crosses]) * length[ray[crosses]])
        ray, tetrahedron = ray[crosses], neighbour[crosses]
    return FacetCrossings(
        tetrahedron=np.concatenate(tetrahedra) if tetrahedra else np.zeros(0, dtype=np.int64),
        facet=np.concatenate(facets) if facets else np.zeros(0, dtype=np.int64),
        distance_to_end=np.concatenate(distance) if distance else np.zeros(0),
        camera_tetrahedra=camera_tetrahedra,
        solid_tetrahedron=_locate_tetrahedra(delaunay, xyz_solid),
    )


def _locate_tetrahedra(delaunay: Delaunay, xyz: Float64Nx3) -> Int64Array:
    """The tetrahedron of each point (n, 3), -1 outside.

    Each distinct place is located once, neighbours one after the other, so that each search starts near its result.
    """
    places, place_of_point = np.unique(xyz, axis=0, return_inverse=True)
    low, high = places.min(axis=0), places.max(axis=0)
    cell = ((places - low) / np.maximum(high - low, 1e-300) * 63).astype(np.int64)
    # Boustrophedon order: consecutive rows run in opposite directions, so that there are no jumps between them.
    cell[:, 1] = np.where(cell[:, 0] % 2, 63 - cell[:, 1], cell[:, 1])
    order = np.lexsort((cell[:, 2], cell[:, 1], cell[:, 0]))
    found = np.empty(len(places), dtype=np.int64)
    found[order] = delaunay.find_simplex(places[order])
    return found[place_of_point.ravel()]


def _find_exit(
    delaunay: Delaunay, tetrahedron: Int64Array, origin: Float64Nx3, direction: Float64Nx3
) -> tuple[Float64N, Int64Array]:
    """The ray parameter at which each tetrahedron is left, and the facet; NaN for a degenerate tetrahedron."""
    transform = delaunay.transform[tetrahedron]
    start = np.einsum("nij,nj->ni", transform[:, :3], origin - transform[:, 3])
    slope = np.einsum("nij,nj->ni", transform[:, :3], direction)
    start = np.column_stack([start, 1.0 - start.sum(axis=1)])
    slope = np.column_stack([slope, -slope.sum(axis=1)])
    with np.errstate(divide="ignore", invalid="ignore"):
        exit_at = np.where(
            slope < -_PARALLEL_TOLERANCE * np.abs(slope).max(axis=1, keepdims=True), -start / slope, np.inf
        )
    facet = np.argmin(np.where(np.isnan(exit_at), np.inf, exit_at), axis=1)
    return exit_at[np.arange(len(exit_at)), facet], facet.astype(np.int64)
