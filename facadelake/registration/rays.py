"""Rays of pixels, and the 3x3 covariance (site) of the place where one meets the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import Camera, PosedCamera


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelRays:
    """Rays of k pixels in site: ``origin_site_m`` (k, 3), ``direction_site`` (k, 3) unit, ``direction_per_px`` (k, 3, 2) what
    the direction turns by a pixel to the right and down, ``solid_angle_sr`` (k,) steradian a square pixel, and
    ``forward_cosine`` (k,) the share of a distance that is depth."""

    origin_site_m: Float64Array
    direction_site: Float64Array
    direction_per_px: Float64Array
    solid_angle_sr: Float64Array
    forward_cosine: Float64Array


def compute_pixel_rays(cameras: Sequence[PosedCamera], camera_of: Int64Array, xy_img: Float64Array) -> PixelRays:
    """Rays of the pixels ``xy_img`` (k, 2), each of ``cameras[camera_of]`` (k,)."""
    count = len(xy_img)
    origin, direction = np.empty((count, 3)), np.empty((count, 3))
    by_pixel, solid, forward = np.empty((count, 3, 2)), np.empty(count), np.empty(count)
    for number in np.unique(camera_of):
        own = np.flatnonzero(camera_of == number)
        posed = cameras[number]
        origin[own], direction[own] = posed.rays_site_from_img(xy_img[own])
        rotation = posed.site_from_cam.rotation
        forward[own] = direction[own] @ rotation[:, 2]
        turned, solid[own] = _differentiate_rays(posed.camera, direction[own] @ rotation)
        by_pixel[own] = rotation @ turned
    return PixelRays(
        origin_site_m=origin,
        direction_site=direction,
        direction_per_px=by_pixel,
        solid_angle_sr=solid,
        forward_cosine=forward,
    )


def _differentiate_rays(camera: Camera, rays_cam: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Derivative (k, 3, 2) of unit rays by their pixel, and the pixel's solid angle (k,); Brown's model, inverted."""
    x, y = (rays_cam[:, :2] / rays_cam[:, 2:]).T
    r2 = x * x + y * y
    radial = 1 + camera.k1 * r2 + camera.k2 * r2 * r2
    slope = 2 * camera.k1 + 4 * camera.k2 * r2  # d radial / dx = slope x
    xx = camera.fx_px * (radial + slope * x * x + 2 * camera.p1 * y + 6 * camera.p2 * x)
    yy = camera.fy_px * (radial + slope * y * y + 6 * camera.p1 * y + 2 * camera.p2 * x)
    mixed = slope * x * y + 2 * camera.p1 * x + 2 * camera.p2 * y
    xy, yx = camera.fx_px * mixed, camera.fy_px * mixed
    grown = xx * yy - xy * yx
    plane = np.array([[yy, -xy], [-yx, xx]]).transpose(2, 0, 1) / grown[:, None, None]
    length = np.sqrt(1 + r2)
    # d unit = (I - unit unit') d(x, y, 1) / length
    across = np.eye(3)[None] - rays_cam[:, :, None] * rays_cam[:, None, :]
    turned: Float64Array = across[:, :, :2] @ plane / length[:, None, None]
    solid: Float64Array = 1 / (np.abs(grown) * length**3)
    return turned, solid


_COSINE_MIN = 0.01  # of a ray flatter than 89.4 deg to the normal nothing finite can be said


def compute_surface_covariance(
    direction_site: Float64Array, normal_site: Float64Array, model_sigma_m: float
) -> Float64Array:
    """Covariance (n, 3, 3) in m2 of places by a surface that stands ``model_sigma_m`` (one sigma) off its model.

    It has rank 1, along the ray; all sightings of a place share the surface.
    """
    along = direction_site / _compute_facing_cosine(direction_site, normal_site)[:, None]
    covariance: Float64Array = model_sigma_m**2 * along[:, :, None] * along[:, None, :]
    return covariance


def compute_ray_covariance(
    direction_site: Float64Array,
    distance_m: Float64Array,
    normal_site: Float64Array,
    by_pixel: Float64Array,
    pixel_sigma_px: Float64Array,
    site_from_cam: Float64Array,
    pose_covariance: Float64Array,
) -> Float64Array:
    """Covariance (n, 3, 3) in m2 of places by their rays alone, on a surface that is where the model has it.

    ``direction_site`` (n, 3) unit, ``normal_site`` (n, 3); ``direction_per_px`` (n, 3, 2): the direction's derivative by the
    pixel, ``pixel_sigma_px`` (n, 2) in x and y; ``site_from_cam`` (n, 3, 3) rotations; ``pose_covariance`` (n, 6, 6):
    centre (m, site) and attitude (rad, about the camera's own x, y, z).
    """
    cosine = _compute_facing_cosine(direction_site, normal_site)
    onto_plane = np.eye(3)[None] - direction_site[:, :, None] * normal_site[:, None, :] / cosine[:, None, None]
    by_pixels = distance_m[:, None, None] * by_pixel * pixel_sigma_px[:, None, :]
    # site_from_cam (I + [turn]x) ray_cam: a turn about the camera's axis k moves the ray by (axis k in site) x ray.
    axes = site_from_cam.transpose(0, 2, 1)
    by_turn = distance_m[:, None, None] * np.cross(axes, direction_site[:, None, :]).transpose(0, 2, 1)
    by_pose = np.concatenate([np.broadcast_to(np.eye(3), by_turn.shape), by_turn], axis=2)
    moved = by_pixels @ by_pixels.transpose(0, 2, 1) + by_pose @ pose_covariance @ by_pose.transpose(0, 2, 1)
    covariance: Float64Array = onto_plane @ moved @ onto_plane.transpose(0, 2, 1)
    return (covariance + covariance.transpose(0, 2, 1)) / 2


def _compute_facing_cosine(direction_site: Float64Array, normal_site: Float64Array) -> Float64Array:
    """``normal . direction`` (n,): negative, as normals face the camera, and kept off zero."""
    cosine: Float64Array = np.minimum(np.einsum("ij,ij->i", direction_site, normal_site), -_COSINE_MIN)
    return cosine
