"""Sun and sky on surfaces: shadows and sky openness by ray casting, baked once a campaign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.demo.recipe import Daylight

FAR_M = 400.0


class RayScene:
    """Triangles that rays meet: which solid, how far, under which angle (float32 inside, near the origin)."""

    def __init__(self, groups: Sequence[Float64Array]) -> None:
        self.scene = o3d.t.geometry.RaycastingScene()
        self.group_of: dict[int, int] = {}
        for index, triangles in enumerate(groups):
            n = len(triangles)
            vertices = o3d.core.Tensor(np.ascontiguousarray(triangles.reshape(-1, 3), dtype=np.float32))
            faces = o3d.core.Tensor(np.arange(3 * n, dtype=np.uint32).reshape(-1, 3))
            self.group_of[int(self.scene.add_triangles(vertices, faces))] = index

    @staticmethod
    def _rays(origins: Float64Array, directions: Float64Array) -> o3d.core.Tensor:
        return o3d.core.Tensor(np.concatenate([origins, directions], axis=1).astype(np.float32))

    def cast(self, origins: Float64Array, directions: Float64Array) -> tuple[Float64Array, Int64Array, Float64Array]:
        """Distance (n,; inf where nothing is met), group index (n,; -1), and unit normals (n, 3) of the first hits."""
        answer = self.scene.cast_rays(self._rays(origins, directions))
        ids = answer["geometry_ids"].numpy()
        table = np.full(max(self.group_of, default=0) + 2, -1, dtype=np.int64)
        for geometry, group in self.group_of.items():
            table[geometry] = group
        met = ids != self.scene.INVALID_ID
        groups = np.where(met, table[np.where(met, ids, len(table) - 1)], -1)
        return (
            answer["t_hit"].numpy().astype(np.float64),
            groups,
            answer["primitive_normals"].numpy().astype(np.float64),
        )

    def find_occluded(self, origins: Float64Array, directions: Float64Array, far_m: float = FAR_M) -> BoolArray:
        """Whether something stands within ``far_m`` along each ray."""
        return np.asarray(self.scene.test_occlusions(self._rays(origins, directions), tnear=0.0, tfar=far_m).numpy())


def compute_sun_direction(light: Daylight) -> Float64Array:
    """Unit vector (3,) in site towards the sun."""
    a, e = np.radians([light.sun_azimuth_deg, light.sun_elevation_deg])
    return np.array([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])


def sample_sky_directions(count: int) -> Float64Array:
    """Unit vectors (count, 3) spread evenly over the upper half sphere and a little below the horizon."""
    z = np.linspace(0.98, -0.25, count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5.0))
    r = np.sqrt(1 - z**2)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])


def compute_direct_light(
    scene: RayScene,
    points: Float64Array,
    normals: Float64Array,
    light: Daylight,
    samples: int,
    rng: np.random.Generator,
) -> Float64Array:
    """Cosine of the sun's incidence times the share of its disc that is seen, (n,)."""
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
    scene: RayScene, points: Float64Array, normals: Float64Array, count: int = 24, reach_m: float = 6.0
) -> Float64Array:
    """Cosine-weighted share of the half space before each point (n,) that is free of things within ``reach_m``."""
    total, free = np.zeros(len(points)), np.zeros(len(points))
    start = points + 0.004 * normals
    for direction in sample_sky_directions(count):
        weight = np.clip(normals @ direction, 0.0, 1.0) * (0.55 + 0.45 * max(direction[2], 0.0))
        use = weight > 0
        open_here = ~scene.find_occluded(start[use], np.broadcast_to(direction, (int(use.sum()), 3)), reach_m)
        total += weight
        free[use] += weight[use] * open_here
    return free / np.maximum(total, 1e-9)


def shade(sun_share: Float64Array, sky_share: Float64Array, light: Daylight) -> Float64Array:
    """Multiplier (..., 3) of a gamma-coded colour under sun and sky; exposure included."""
    linear = sun_share[..., None] * np.array(light.sun) + (0.25 + 0.75 * sky_share[..., None]) * np.array(light.sky)
    return np.asarray((light.exposure * linear) ** (1 / 2.2))
