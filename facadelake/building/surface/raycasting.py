"""Cast rays, render depth and find closest points on a triangle surface in site.

Open3D's RaycastingScene computes in float32; hits are refined to float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from facadelake.building.model import BuildingModel
from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Int64Array, Int64Nx3, RowIndices
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import ModelError

MISS = -1
_CHUNK = 1_000_000  # rays per cast: about 100 MB of float64 around one
_MIN_COSINE = 1e-6  # hits of rays closer to the plane are not refined


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """First hits of n rays; a miss has distance inf, point and normal NaN, triangle and element ``MISS``.

    ``distance_m`` (n,), ``xyz_site_m`` (n, 3), ``normal_site`` (n, 3) unit normals on the ray's side, ``triangle``
    (n,), ``element`` (n,) rows of the building's elements.
    """

    distance_m: Float64N
    xyz_site_m: Float64Nx3
    normal_site: Float64Nx3
    triangle: RowIndices
    element: RowIndices

    @property
    def hit(self) -> BoolArray:
        """Mask (n,) of the rays that hit the surface."""
        is_hit: BoolArray = self.triangle != MISS
        return is_hit


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosestPoints:
    """The surface's closest points to n points, as ``Hits``, but ``normal_site`` follows the triangle's winding."""

    distance_m: Float64N
    xyz_site_m: Float64Nx3
    normal_site: Float64Nx3
    triangle: RowIndices
    element: RowIndices


class Surface:
    """A triangle surface for ray casting.

    ``vertices_site_m`` (n, 3) and ``triangles`` (m, 3) are the building's; ``normals_site`` (m, 3), unit, follow the
    triangles' winding; ``areas_m2`` (m,).
    """

    def __init__(self, building: BuildingModel) -> None:
        self._build(building.vertices_site_m, building.triangles, building.element_of_triangle)

    @classmethod
    def from_mesh(
        cls,
        vertices_site_m: Float64Nx3,
        triangles: Int64Nx3,
        element_of_triangle: RowIndices | None = None,
    ) -> Surface:
        """Build from a mesh in site; without ``element_of_triangle`` (m,) all triangles belong to element 0.

        Raises ModelError if there are no triangles.
        """
        surface = cls.__new__(cls)
        element = np.zeros(len(triangles), dtype=np.int64) if element_of_triangle is None else element_of_triangle
        surface._build(vertices_site_m, triangles, element)
        return surface

    def _build(self, vertices: Float64Nx3, triangles: Int64Nx3, element_of_triangle: RowIndices) -> None:
        if len(triangles) == 0:
            raise ModelError("the surface has no triangles, so rays cannot be cast; check that the model is not empty")
        self.vertices_site_m = np.asarray(vertices, dtype=np.float64)
        self.triangles = np.asarray(triangles, dtype=np.int64)
        self._element_of_triangle = np.asarray(element_of_triangle, dtype=np.int64)
        corners = self.vertices_site_m[self.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        self.normals_site: Float64Nx3 = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
        self.areas_m2: Float64N = length[:, 0] / 2
        # float32 resolves about 1e-7 of a coordinate, so the scene is centred.
        self.centre_site_m: Float64Array = (self.vertices_site_m.min(axis=0) + self.vertices_site_m.max(axis=0)) / 2
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor((self.vertices_site_m - self.centre_site_m).astype(np.float32)),
            o3d.core.Tensor(self.triangles.astype(np.uint32)),
        )

    def cast(self, origins_site_m: Float64Nx3, directions_site: Float64Nx3) -> Hits:
        """Cast rays from ``origins_site_m`` (n, 3) along ``directions_site`` (n, 3, any length); first hits."""
        origins = np.asarray(origins_site_m, dtype=np.float64).reshape(-1, 3)
        directions = np.asarray(directions_site, dtype=np.float64).reshape(-1, 3)
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        distance = np.full(len(unit), np.inf)
        triangle = np.full(len(unit), MISS, dtype=np.int64)
        for start in range(0, len(unit), _CHUNK):
            part = slice(start, start + _CHUNK)
            rays = np.hstack([origins[part] - self.centre_site_m, unit[part]]).astype(np.float32)
            result = self._scene.cast_rays(o3d.core.Tensor(rays))
            t_hit = result["t_hit"].numpy().astype(np.float64)
            is_hit = np.isfinite(t_hit)
            distance[part] = t_hit
            triangle[part][is_hit] = result["primitive_ids"].numpy()[is_hit].astype(np.int64)
        return self._refine_hits(origins, unit, distance, triangle)

    def _refine_hits(self, origins: Float64Nx3, unit: Float64Nx3, distance: Float64N, triangle: RowIndices) -> Hits:
        """Recompute distances in float64 from the planes of the triangles hit."""
        is_hit = triangle != MISS
        normal = np.full_like(unit, np.nan)
        normal[is_hit] = self.normals_site[triangle[is_hit]]
        cosine = np.einsum("ij,ij->i", normal[is_hit], unit[is_hit])
        height = np.einsum(
            "ij,ij->i", normal[is_hit], self.vertices_site_m[self.triangles[triangle[is_hit], 0]] - origins[is_hit]
        )
        plane = np.divide(height, cosine, out=distance[is_hit].copy(), where=np.abs(cosine) > _MIN_COSINE)
        distance[is_hit] = np.maximum(plane, 0.0)
        normal[is_hit] *= -np.sign(np.where(cosine == 0, -1.0, cosine))[:, None]
        xyz = np.full_like(unit, np.nan)
        xyz[is_hit] = origins[is_hit] + distance[is_hit, None] * unit[is_hit]
        element = np.where(is_hit, self._element_of_triangle[np.where(is_hit, triangle, 0)], MISS)
        return Hits(distance_m=distance, xyz_site_m=xyz, normal_site=normal, triangle=triangle, element=element)

    def render_depth(self, posed: PosedCamera, scale: float) -> tuple[Float64Array, Int64Array]:
        """Render depth along the camera's z in metres (inf: miss) and element rows (``MISS``), both (h, w).

        ``scale`` (at most 1) reduces the photograph's size. Lens distortion is applied, so that the pixels coincide
        with the photograph's.
        """
        camera = posed.camera
        width, height = max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))
        columns = (np.arange(width) + 0.5) * camera.width_px / width
        rows = (np.arange(height) + 0.5) * camera.height_px / height
        depth, element = np.empty((height, width)), np.empty((height, width), dtype=np.int64)
        band = max(1, _CHUNK // width)  # rows per cast: all rays of a photograph of 48 Mpx would take 5 GB
        for top in range(0, height, band):
            part = slice(top, top + band)
            grid = np.stack(np.meshgrid(columns, rows[part]), axis=-1).reshape(-1, 2)
            origins, directions = posed.rays_site_from_img(grid)
            hits = self.cast(origins, directions)
            along = directions @ posed.site_from_cam.rotation[:, 2]
            depth[part] = (hits.distance_m * along).reshape(-1, width)
            element[part] = hits.element.reshape(-1, width)
        return depth, element

    def find_closest_points(self, xyz_site_m: Float64Nx3) -> ClosestPoints:
        """Find the closest point of the surface to each of ``xyz_site_m`` (n, 3), to about 1e-6 of its extent."""
        points = np.asarray(xyz_site_m, dtype=np.float64).reshape(-1, 3) - self.centre_site_m
        result = self._scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
        triangle = result["primitive_ids"].numpy().astype(np.int64)
        foot = result["points"].numpy().astype(np.float64)
        # The foot is rounded to float32; project it onto the plane of its triangle.
        normal = self.normals_site[triangle]
        anchor = self.vertices_site_m[self.triangles[triangle, 0]] - self.centre_site_m
        foot -= np.einsum("ij,ij->i", foot - anchor, normal)[:, None] * normal
        return ClosestPoints(
            distance_m=np.linalg.norm(points - foot, axis=1),
            xyz_site_m=foot + self.centre_site_m,
            normal_site=normal,
            triangle=triangle,
            element=self._element_of_triangle[triangle],
        )

    def measure_distance(self, xyz_site_m: Float64Nx3) -> Float64N:
        """Distance in metres (n,) of points (n, 3) from the surface."""
        return self.find_closest_points(xyz_site_m).distance_m
