"""Intersection: a point from its image rays in posed photographs, robust against a wrong mark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares

from facadelake.core.arrays import BoolArray, Float64Array, Float64x3
from facadelake.core.camera import Camera
from facadelake.core.frames import Similarity

# A mark with a larger residual is on another object.
MAX_MARK_RESIDUAL_PX = 8.0
# Rays that intersect at a smaller angle leave the distance undetermined.
MIN_ANGLE_DEG = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageRay:
    """A mark in a photograph: the camera, its pose in some world frame, and the pixel (2,)."""

    camera: Camera
    world_from_cam: Similarity
    xy_img: Float64Array

    def compute_residual_px(self, xyz_world: Float64x3) -> Float64Array:
        """Projection minus mark (2,) in pixels; 1e6 px where the point lies behind the camera."""
        xy = self.camera.project(self.world_from_cam.invert().apply(xyz_world[None]))[0]
        return xy - self.xy_img if np.isfinite(xy).all() else np.full(2, 1e6)

    def compute_ray(self) -> tuple[Float64x3, Float64x3]:
        """Origin (3,) and unit direction (3,) in the world frame."""
        direction = self.world_from_cam.rotate(self.camera.rays_cam_from_img(self.xy_img[None]))[0]
        return self.world_from_cam.translation, direction


@dataclass(frozen=True, kw_only=True, eq=False)
class Intersection:
    """The point (3,) in the world frame, the rays used (n,), and the root mean square of their residuals."""

    xyz_world: Float64x3
    used: BoolArray
    rms_px: float


def _compute_midpoint(rays: Sequence[ImageRay]) -> Float64x3 | None:
    """Least-squares point (3,) of several rays; None where they are nearly parallel."""
    origins, directions = (np.array(parts) for parts in zip(*(ray.compute_ray() for ray in rays), strict=True))
    widest = np.degrees(np.arccos(np.clip((directions @ directions.T).min(), -1.0, 1.0)))
    if widest < MIN_ANGLE_DEG:
        return None
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    point: Float64Array = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, origins))
    return point


def intersect_rays(rays: Sequence[ImageRay]) -> Intersection | None:
    """The point on which most rays agree, refined by reprojection error; None where no two agree at a useful angle."""
    best: BoolArray = np.zeros(len(rays), dtype=bool)
    for pair in combinations(rays, 2):
        start = _compute_midpoint(pair)
        if start is None:
            continue
        agrees = np.array([np.linalg.norm(ray.compute_residual_px(start)) < MAX_MARK_RESIDUAL_PX for ray in rays])
        if agrees.sum() > best.sum():
            best = agrees
    if best.sum() < 2:
        return None
    used = [ray for ray, good in zip(rays, best, strict=True) if good]
    start = _compute_midpoint(used)
    if start is None:
        return None
    # Lengths in a free network have no unit: steps are scaled by the distance to the cameras.
    scale = float(np.linalg.norm(start - used[0].world_from_cam.translation))
    fit = least_squares(
        lambda step: np.concatenate([ray.compute_residual_px(start + scale * step) for ray in used]),
        np.zeros(3),
        loss="soft_l1",
        x_scale=1e-3,
    )
    point = start + scale * fit.x
    errors = np.array([np.linalg.norm(ray.compute_residual_px(point)) for ray in used])
    return Intersection(xyz_world=point, used=best, rms_px=float(np.sqrt((errors**2).mean())))
