"""A point from its sightings in posed photographs, robust against a wrong mark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares

from facadelake.core.arrays import BoolArray, Float64Array
from facadelake.core.camera import Camera
from facadelake.core.frames import Similarity

# A mark that misses the point's own rays by more than this is on something else.
MAX_MARK_RESIDUAL_PX = 8.0
# Rays that meet at a smaller angle leave the distance open.
MIN_ANGLE_DEG = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageRay:
    """A mark in a photograph: the camera, its pose in some world frame, and the pixel (2,)."""

    camera: Camera
    world_from_cam: Similarity
    xy_img: Float64Array

    def compute_residual_px(self, xyz_world: Float64Array) -> Float64Array:
        """Projection minus mark (2,) in pixels; far off where the point lies behind the camera."""
        xy = self.camera.project(self.world_from_cam.invert().apply(xyz_world[None]))[0]
        return xy - self.xy_img if np.isfinite(xy).all() else np.full(2, 1e6)

    def compute_ray(self) -> tuple[Float64Array, Float64Array]:
        """Origin and unit direction in the world frame."""
        direction = self.world_from_cam.rotate(self.camera.rays_cam_from_img(self.xy_img[None]))[0]
        return self.world_from_cam.translation, direction


@dataclass(frozen=True, kw_only=True, eq=False)
class Intersection:
    """The point in the world frame, which views it rests on, and their root mean square error."""

    xyz_world: Float64Array
    used: BoolArray
    rms_px: float


def _compute_midpoint(views: Sequence[ImageRay]) -> Float64Array | None:
    """Least-squares point of several rays; None where they are near parallel."""
    origins, directions = (np.array(parts) for parts in zip(*(view.compute_ray() for view in views), strict=True))
    widest = np.degrees(np.arccos(np.clip((directions @ directions.T).min(), -1.0, 1.0)))
    if widest < MIN_ANGLE_DEG:
        return None
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    point: Float64Array = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, origins))
    return point


def intersect_rays(views: Sequence[ImageRay]) -> Intersection | None:
    """The point most views agree on, refined in pixels; None where fewer than two agree at a useful angle."""
    best: BoolArray = np.zeros(len(views), dtype=bool)
    for pair in combinations(views, 2):
        start = _compute_midpoint(pair)
        if start is None:
            continue
        near = np.array([np.linalg.norm(view.compute_residual_px(start)) < MAX_MARK_RESIDUAL_PX for view in views])
        if near.sum() > best.sum():
            best = near
    if best.sum() < 2:
        return None
    kept = [view for view, good in zip(views, best, strict=True) if good]
    start = _compute_midpoint(kept)
    if start is None:
        return None
    # Lengths in a free network have no unit: steps are scaled by the distance to the cameras.
    scale = float(np.linalg.norm(start - kept[0].world_from_cam.translation))
    fit = least_squares(
        lambda step: np.concatenate([view.compute_residual_px(start + scale * step) for view in kept]),
        np.zeros(3),
        loss="soft_l1",
        x_scale=1e-3,
    )
    point = start + scale * fit.x
    errors = np.array([np.linalg.norm(view.compute_residual_px(point)) for view in kept])
    return Intersection(xyz_world=point, used=best, rms_px=float(np.sqrt((errors**2).mean())))
