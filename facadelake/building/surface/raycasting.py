"""Rays, depth and closest points on a triangle surface in site (Open3D's RaycastingScene, refined to float64)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from facadelake.building.model import BuildingModel
from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.core.errors import ModelError

MISS = -1
_CHUNK = 1_000_000  # rays per cast: about 100 MB of float64 around one
_MIN_COSINE = 1e-6  # |cos| between ray and normal below which the plane cannot refine a hit


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """Where n rays met the surface; a miss has distance inf, NaN point and normal, triangle and element ``MISS``.

    ``distance_m`` (n,), ``xyz_site_m`` (n, 3), ``normal_site`` (n, 3) unit and turned to the ray's origin,
    ``triangle`` (n,), ``element`` (n,) row of the building's elements.
    """

    distance_m: Float64Array
    xyz_site_m: Float64Array
    normal_site: Float64Array
    triangle: Int64Array
    element: Int64Array

    @property
    def hit(self) -> BoolArray:
        """Which rays met the surface (n,)."""
        met: BoolArray = self.triangle != MISS
        return met


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosestPoints:
    """The surface's points closest to n points; ``normal_site`` points as the triangle is wound."""

    distance_m: Float64Array
    xyz_site_m: Float64Array
    normal_site: Float64Array
    triangle: Int64Array
    element: Int64Array


class Surface:
    """A triangle surface that rays can be cast at; ``vertices_site_m`` (n, 3) and ``triangles`` (m, 3) as given."""

    def __init__(self, building: BuildingModel) -> None:
        self._build(building.vertices_site_m, building.triangles, building.element_of_triangle)

    @classmethod
    def from_mesh(
        cls,
        vertices_site_m: Float64Array,
        triangles: Int64Array,
        element_of_triangle: Int64Array | None = None,
    ) -> Surface:
        """A surface of any mesh in site; without ``element_of_triangle`` every triangle belongs to element 0."""
        surface = cls.__new__(cls)
        owner = np.zeros(len(triangles), dtype=np.int64) if element_of_triangle is None else element_of_triangle
        surface._build(vertices_site_m, triangles, owner)
        return surface

    def _build(self, vertices: Float64Array, triangles: Int64Array, owner: Int64Array) -> None:
        if len(triangles) == 0:
            raise ModelError("the surface has no triangles, so no ray can meet it; is the model empty?")
        self.vertices_site_m = np.asarray(vertices, dtype=np.float64)
        self.triangles = np.asarray(triangles, dtype=np.int64)
        self._owner = np.asarray(owner, dtype=np.int64)
        corners = self.vertices_site_m[self.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        self.normals_site: Float64Array = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
        self.areas_m2: Float64Array = length[:, 0] / 2
        # float32 keeps about 1e-7 of the coordinate, so the scene stands around its own middle.
        self.centre_site_m: Float64Array = (self.vertices_site_m.min(axis=0) + self.vertices_site_m.max(axis=0)) / 2
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor((self.vertices_site_m - self.centre_site_m).astype(np.float32)),
            o3d.core.Tensor(self.triangles.astype(np.uint32)),
        )

    def cast(self, origins_site_m: Float64Array, directions_site: Float64Array) -> Hits:
        """First hits of rays from ``origins_site_m`` (n, 3) along ``directions_site`` (n, 3, any length)."""
        origins = np.asarray(origins_site_m, dtype=np.float64).reshape(-1, 3)
        directions = np.asarray(directions_site, dtype=np.float64).reshape(-1, 3)
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        distance = np.full(len(unit), np.inf)
        triangle = np.full(len(unit), MISS, dtype=np.int64)
        for start in range(0, len(unit), _CHUNK):
            part = slice(start, start + _CHUNK)
            rays = np.hstack([origins[part] - self.centre_site_m, unit[part]]).astype(np.float32)
            answer = self._scene.cast_rays(o3d.core.Tensor(rays))
            far = answer["t_hit"].numpy().astype(np.float64)
            met = np.isfinite(far)
            distance[part] = far
            triangle[part][met] = answer["primitive_ids"].numpy()[met].astype(np.int64)
        return self._refined(origins, unit, distance, triangle)

    def _refined(self, origins: Float64Array, unit: Float64Array, distance: Float64Array, triangle: Int64Array) -> Hits:
        """Hits whose distance is taken from the plane of the triangle that was hit, in float64."""
        met = triangle != MISS
        normal = np.full_like(unit, np.nan)
        normal[met] = self.normals_site[triangle[met]]
        cosine = np.einsum("ij,ij->i", normal[met], unit[met])
        height = np.einsum(
            "ij,ij->i", normal[met], self.vertices_site_m[self.triangles[triangle[met], 0]] - origins[met]
        )
        plane = np.divide(height, cosine, out=distance[met].copy(), where=np.abs(cosine) > _MIN_COSINE)
        distance[met] = np.maximum(plane, 0.0)
        normal[met] *= -np.sign(np.where(cosine == 0, -1.0, cosine))[:, None]
        xyz = np.full_like(unit, np.nan)
        xyz[met] = origins[met] + distance[met, None] * unit[met]
        element = np.where(met, self._owner[np.where(met, triangle, 0)], MISS)
        return Hits(distance_m=distance, xyz_site_m=xyz, normal_site=normal, triangle=triangle, element=element)

    def render_depth(self, posed: PosedCamera, scale: float) -> tuple[Float64Array, Int64Array]:
        """Depth along the camera's z in metres (inf: miss) and element rows (``MISS``), both (h, w).

        ``scale`` <= 1 reduces the photograph's size; lens distortion is kept, so pixels match the photograph's.
        """
        camera = posed.camera
        width, height = max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))
        columns = (np.arange(width) + 0.5) * camera.width_px / width
        rows = (np.arange(height) + 0.5) * camera.height_px / height
        depth, element = np.empty((height, width)), np.empty((height, width), dtype=np.int64)
        band = max(1, _CHUNK // width)  # rows at a time: the rays of a whole photograph of 48 Mpx would take 5 GB
        for top in range(0, height, band):
            part = slice(top, top + band)
            grid = np.stack(np.meshgrid(columns, rows[part]), axis=-1).reshape(-1, 2)
            origins, directions = posed.rays_site_from_img(grid)
            hits = self.cast(origins, directions)
            along = directions @ posed.site_from_cam.rotation[:, 2]
            depth[part] = (hits.distance_m * along).reshape(-1, width)
            element[part] = hits.element.reshape(-1, width)
        return depth, element

    def find_closest_points(self, xyz_site_m: Float64Array) -> ClosestPoints:
        """The surface's closest point to each of ``xyz_site_m`` (n, 3), to about 1e-6 of the surface's extent."""
        points = np.asarray(xyz_site_m, dtype=np.float64).reshape(-1, 3) - self.centre_site_m
        answer = self._scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        foot = answer["points"].numpy().astype(np.float64)
        # The foot was rounded to float32: put it back into its triangle's plane.
        normal = self.normals_site[triangle]
        anchor = self.vertices_site_m[self.triangles[triangle, 0]] - self.centre_site_m
        foot -= np.einsum("ij,ij->i", foot - anchor, normal)[:, None] * normal
        return ClosestPoints(
            distance_m=np.linalg.norm(points - foot, axis=1),
            xyz_site_m=foot + self.centre_site_m,
            normal_site=normal,
            triangle=triangle,
            element=self._owner[triangle],
        )

    def measure_distance(self, xyz_site_m: Float64Array) -> Float64Array:
        """Distance in metres (n,) of points (n, 3) to the surface."""
        return self.find_closest_points(xyz_site_m).distance_m
