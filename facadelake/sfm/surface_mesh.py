"""The as-built surface: a mesh of the tie points that separates free space from solid matter.

The wheel of pycolmap has no Delaunay meshing (it is built without CGAL), so the method is implemented here: Delaunay
tetrahedra of the tie points; each ray votes the tetrahedra on its way free and the one behind its point solid; a
minimum cut separates the two. Source: Labatut, Pons, Keriven 2009, "Robust and efficient surface reconstruction from
range data".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow
from scipy.spatial import Delaunay, cKDTree

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Int64Array, Int64Nx3
from facadelake.core.errors import InputDataError
from facadelake.core.progress import report_progress
from facadelake.sfm.free_space import FacetCrossings, walk_rays
from facadelake.sfm.reconstruction import Reconstruction, read_reconstruction

_MAX_POINTS = 30_000
_MIN_POINTS = 50
_RAYS_PER_POINT = 4
# Weight of one ray against the shape term; the maximum flow needs integers.
_RAY_WEIGHT = 100
_SHAPE_WEIGHT = 60
# Triangles with an edge this many times longer than usual close gaps without observations.
_MAX_EDGE_FACTOR = 4.0
_EDGE_PERCENTILE = 90.0


def write_as_built_mesh(reconstruction_folder: Path, folder: Path) -> None:
    """Mesh the tie points of a reconstruction and write ``folder/mesh.npz`` (frame sfm).

    Raises InputDataError for fewer than 50 tie points with three image points or more.
    """
    vertices, triangles = mesh_tie_points(read_reconstruction(reconstruction_folder))
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "mesh.npz", vertices_sfm=vertices, triangles=triangles)


def read_mesh(folder: Path) -> tuple[Float64Nx3, Int64Nx3]:
    """Vertices (n, 3) in sfm and triangles (m, 3) of ``folder/mesh.npz``; normals point to the free side.

    Raises InputDataError where the folder holds no mesh.
    """
    try:
        with np.load(folder / "mesh.npz") as loaded:
            return loaded["vertices_sfm"], loaded["triangles"]
    except (OSError, ValueError, KeyError) as error:
        raise InputDataError(f"{folder} holds no as-built mesh ({error}); remove the folder and run again") from error


def mesh_tie_points(
    reconstruction: Reconstruction, *, seed: int = 1, max_points: int = _MAX_POINTS
) -> tuple[Float64Nx3, Int64Nx3]:
    """The surface between free space and solid matter: vertices (n, 3) in sfm, triangles (m, 3).

    Of more than ``max_points`` tie points with three image points or more, that many are sampled with ``seed``. Raises
    InputDataError for fewer than 50 of them.
    """
    with report_progress("Meshing tie points", 4) as step:
        point, photo = _select_image_points(reconstruction, seed, max_points)
        kept, vertex = np.unique(point, return_inverse=True)
        if len(kept) < _MIN_POINTS:
            raise InputDataError(
                f"{len(kept)} tie points have three image points or more; a surface needs {_MIN_POINTS} such points: "
                "photograph with more overlap"
            )
        xyz = reconstruction.xyz_sfm[kept]
        spacing = cKDTree(xyz).query(xyz, k=5)[0][:, 1:].mean(axis=1)
        corners = _enclose(np.vstack([xyz, reconstruction.centres_sfm]))
        delaunay = Delaunay(np.vstack([xyz, corners]))
        step.advance()
        crossings = walk_rays(delaunay, reconstruction.centres_sfm[photo], xyz[vertex], vertex, spacing[vertex])
        step.advance()
        free = _find_free_space(delaunay, crossings, float(np.median(spacing)))
        step.advance()
        triangles = _extract_interface(delaunay, free)
        triangles = _drop_long_triangles(delaunay.points, triangles[(triangles < len(xyz)).all(axis=1)])
        step.advance()
    used, renumbered = np.unique(triangles, return_inverse=True)
    return xyz[used], renumbered.reshape(-1, 3).astype(np.int64)


def _select_image_points(reconstruction: Reconstruction, seed: int, max_points: int) -> tuple[Int64Array, Int64Array]:
    """Tie points and photographs of the rays: points with three image points or more, at most four rays each."""
    rng = np.random.default_rng(seed)
    image_point_count = np.bincount(reconstruction.image_point_tie_point, minlength=len(reconstruction.xyz_sfm))
    chosen = np.flatnonzero(image_point_count >= 3)
    if len(chosen) > max_points:
        chosen = rng.choice(chosen, max_points, replace=False)
    rows = np.flatnonzero(np.isin(reconstruction.image_point_tie_point, chosen))
    rows = rng.permutation(rows)
    rows = rows[np.argsort(reconstruction.image_point_tie_point[rows], kind="stable")]
    point = reconstruction.image_point_tie_point[rows]
    first = np.concatenate([[True], point[1:] != point[:-1]])
    rank = np.arange(len(point)) - np.flatnonzero(first)[np.cumsum(first) - 1]
    rows = rows[rank < _RAYS_PER_POINT]
    return reconstruction.image_point_tie_point[rows], reconstruction.image_point_photo[rows]


def _enclose(xyz: Float64Nx3) -> Float64Nx3:
    """Eight corners of a box three times as wide as all points, so that every camera is in a tetrahedron."""
    centre, half_width = (xyz.max(axis=0) + xyz.min(axis=0)) / 2, (xyz.max(axis=0) - xyz.min(axis=0)).max() * 1.5
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners: Float64Array = centre + half_width * signs
    return corners


def _find_free_space(delaunay: Delaunay, crossings: FacetCrossings, spacing: float) -> BoolArray:
    """Which tetrahedra (t,) are free space, by a minimum cut between those of cameras and those behind points."""
    count = len(delaunay.simplices)
    source, sink = count, count + 1
    # Crossings close to the point get little weight: the point itself is uncertain by about the spacing.
    ray_weight = _RAY_WEIGHT * (1.0 - np.exp(-0.5 * (crossings.distance_to_end / spacing) ** 2))
    solid = crossings.solid_tetrahedron[crossings.solid_tetrahedron >= 0]
    facet_tetrahedron = np.repeat(np.arange(count), 4)
    facet_neighbour = delaunay.neighbors.ravel().astype(np.int64)
    inner = facet_neighbour >= 0
    hull_tetrahedra = np.flatnonzero((delaunay.neighbors < 0).any(axis=1))
    rows = np.concatenate(
        [
            crossings.tetrahedron,
            facet_tetrahedron[inner],
            np.full(len(crossings.camera_tetrahedra) + len(hull_tetrahedra), source),
            solid,
        ]
    )
    columns = np.concatenate(
        [
            delaunay.neighbors[crossings.tetrahedron, crossings.facet],
            facet_neighbour[inner],
            crossings.camera_tetrahedra,
            hull_tetrahedra,
            np.full(len(solid), sink),
        ]
    )
    infinite = float(2**30)
    weights = np.concatenate(
        [
            ray_weight,
            _SHAPE_WEIGHT * _compute_shape_term(delaunay)[inner],
            np.full(len(crossings.camera_tetrahedra) + len(hull_tetrahedra), infinite),
            np.full(len(solid), float(_RAY_WEIGHT)),
        ]
    )
    summed = coo_array((weights, (rows, columns)), shape=(count + 2, count + 2)).tocsr()
    capacity = csr_array(
        (np.minimum(summed.data, infinite).astype(np.int32), summed.indices, summed.indptr), shape=summed.shape
    )
    flow = maximum_flow(capacity, source, sink).flow
    residual = capacity - flow
    residual.eliminate_zeros()
    reached = np.zeros(count + 2, dtype=bool)
    reached[breadth_first_order(residual, source, return_predecessors=False)] = True
    return reached[:count]


def _compute_shape_term(delaunay: Delaunay) -> Float64N:
    """Shape term of every facet (4 t,), 0 (good) to 2: large where a circumsphere extends far beyond the facet."""
    corners = delaunay.points[delaunay.simplices]
    base = corners[:, 0]
    edges = corners[:, 1:] - base[:, None]
    with np.errstate(all="ignore"):
        determinant = np.linalg.det(edges)
        degenerate = np.abs(determinant) < 1e-12 * np.abs(edges).max(axis=(1, 2)) ** 3
        edges = np.where(degenerate[:, None, None], np.eye(3), edges)
        centre = base + np.linalg.solve(edges, 0.5 * (edges**2).sum(axis=2)[:, :, None])[:, :, 0]
    radius = np.linalg.norm(centre - base, axis=1)
    cosine = np.empty((len(corners), 4))
    for facet in range(4):
        a, b, c = (corners[:, k] for k in range(4) if k != facet)
        normal = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        side = np.sign(np.einsum("ij,ij->i", normal, corners[:, facet] - a))
        cosine[:, facet] = side * np.einsum("ij,ij->i", normal, centre - a) / np.maximum(radius, 1e-300)
    cosine[degenerate] = -1.0
    cosine_here = cosine.ravel()
    neighbour = delaunay.neighbors.ravel()
    # The facet of the neighbour that is shared with this tetrahedron.
    facet_across = np.argmax(delaunay.neighbors[neighbour] == np.repeat(np.arange(len(corners)), 4)[:, None], axis=1)
    cosine_across = cosine[neighbour, facet_across]
    shape_term: Float64Array = 1.0 - np.clip(np.minimum(cosine_here, cosine_across), -1.0, 1.0)
    return shape_term


def _extract_interface(delaunay: Delaunay, free: BoolArray) -> Int64Nx3:
    """Facets (m, 3) between solid and free tetrahedra, oriented with their normals to the free side."""
    solid, facet = np.nonzero(~free[:, None] & (delaunay.neighbors >= 0) & free[delaunay.neighbors])
    corners = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[facet]
    triangles = np.take_along_axis(delaunay.simplices[solid], corners, axis=1).astype(np.int64)
    a, b, c = (delaunay.points[triangles[:, k]] for k in range(3))
    opposite = delaunay.points[delaunay.simplices[solid, facet]]
    flipped = np.einsum("ij,ij->i", np.cross(b - a, c - a), opposite - a) > 0
    triangles[flipped] = triangles[flipped][:, [0, 2, 1]]
    return triangles


def _drop_long_triangles(points: Float64Nx3, triangles: Int64Nx3) -> Int64Nx3:
    """The triangles whose longest edge is not far above the usual length."""
    edges = np.linalg.norm(points[triangles] - points[np.roll(triangles, 1, axis=1)], axis=2).max(axis=1)
    limit = _MAX_EDGE_FACTOR * np.percentile(edges, _EDGE_PERCENTILE) if len(edges) else 0.0
    kept: Int64Array = triangles[edges <= limit]
    return kept
