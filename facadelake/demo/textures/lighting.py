"""Direct sunlight and sky light on surfaces, by ray casting; baked once per campaign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d

from facadelake.core.arrays import BoolArray, Float64Array, Float64N, Float64Nx3, Float64x3, Int64Array
from facadelake.demo.recipe import Daylight

FAR_M = 400.0


class RayScene:
    """Triangles for ray casting, in groups of one solid each (float32, so coordinates must be near the origin)."""

    def __init__(self, groups: Sequence[Float64Array]) -> None:
        self.scene = o3d.t.geometry.RaycastingScene()
        self.group_of: dict[int, int] = {}
        for index, triangles in enumerate(groups):
            n = len(triangles)
            vertices = o3d.core.Tensor(np.ascontiguousarray(triangles.reshape(-1, 3), dtype=np.float32))
            faces = o3d.core.Tensor(np.arange(3 * n, dtype=np.uint32).reshape(-1, 3))
            self.group_of[int(self.scene.add_triangles(vertices, faces))] = index
        self.find_occluded(np.zeros((1, 3)), np.ones((1, 3)))  # builds the tree here, before several threads use it

    @staticmethod
    def _pack_rays(origins: Float64Nx3, directions: Float64Nx3) -> o3d.core.Tensor:
        """Rays as Open3D expects them."""
        return o3d.core.Tensor(np.concatenate([origins, directions], axis=1).astype(np.float32))

    def cast(self, origins: Float64Nx3, directions: Float64Nx3) -> tuple[Float64N, Int64Array]:
        """Distance (n,; inf without a hit) and group index (n,; -1) of the first hits."""
        answer = self.scene.cast_rays(self._pack_rays(origins, directions))
        ids = answer["geometry_ids"].numpy()
        table = np.full(max(self.group_of, default=0) + 2, -1, dtype=np.int64)
        for geometry, group in self.group_of.items():
            table[geometry] = group
        hit = ids != self.scene.INVALID_ID
        groups = np.where(hit, table[np.where(hit, ids, len(table) - 1)], -1)
        return answer["t_hit"].numpy().astype(np.float64), groups

    def find_occluded(self, origins: Float64Nx3, directions: Float64Nx3, far_m: float = FAR_M) -> BoolArray:
        """Whether a triangle is within ``far_m`` along each ray."""
        return np.asarray(
            self.scene.test_occlusions(self._pack_rays(origins, directions), tnear=0.0, tfar=far_m).numpy()
        )


def compute_sun_direction(light: Daylight) -> Float64x3:
    """Unit vector (3,) in site towards the sun."""
    azimuth, elevation = np.radians([light.sun_azimuth_deg, light.sun_elevation_deg])
    return np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])


def sample_sky_directions(count: int) -> Float64Nx3:
    """Unit vectors (count, 3), evenly distributed over the upper hemisphere and slightly below the horizon."""
    z = np.linspace(0.98, -0.25, count)
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5.0))
    radius = np.sqrt(1 - z**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])


def compute_direct_light(
    scene: RayScene,
    points: Float64Nx3,
    normals: Float64Nx3,
    light: Daylight,
    samples: int,
    rng: np.random.Generator,
) -> Float64N:
    """Cosine of the sun's incidence times the visible share of its disc, (n,).

    Args:
        scene: the scene, for shadows.
        points: points (n, 3) in site, on surfaces.
        normals: outward unit normals (n, 3).
        light: direction of the sun.
        samples: rays to the disc per point.
        rng: draws the directions of the rays.
    """
    sun = compute_sun_direction(light)
    cosine = np.clip(normals @ sun, 0.0, 1.0)
    share = np.zeros(len(points))
    facing = cosine > 0
    start = points[facing] + 0.004 * normals[facing]
    for _ in range(samples):
        toward = sun + rng.normal(scale=0.008, size=(len(start), 3))
        share[facing] += ~scene.find_occluded(start, toward)
    return cosine * share / samples


def compute_sky_openness(
    scene: RayScene, points: Float64Nx3, normals: Float64Nx3, count: int = 24, reach_m: float = 6.0
) -> Float64N:
    """Cosine-weighted share (n,) of the hemisphere at each point that is free of obstacles.

    Args:
        scene: the scene.
        points: points (n, 3) in site, on surfaces.
        normals: outward unit normals (n, 3).
        count: number of directions.
        reach_m: distance up to which obstacles count.
    """
    total, free = np.zeros(len(points)), np.zeros(len(points))
    start = points + 0.004 * normals
    for direction in sample_sky_directions(count):
        weight = np.clip(normals @ direction, 0.0, 1.0) * (0.55 + 0.45 * max(direction[2], 0.0))
        facing = weight > 0
        visible = ~scene.find_occluded(start[facing], np.broadcast_to(direction, (int(facing.sum()), 3)), reach_m)
        total += weight
        free[facing] += weight[facing] * visible
    return free / np.maximum(total, 1e-9)


def shade(sun_share: Float64Array, sky_share: Float64Array, light: Daylight) -> Float64Array:
    """Multiplier (..., 3) of a gamma-coded colour under sun and sky, including exposure."""
    linear = sun_share[..., None] * np.array(light.sun) + (0.25 + 0.75 * sky_share[..., None]) * np.array(light.sky)
    return np.asarray((light.exposure * linear) ** (1 / 2.2))
