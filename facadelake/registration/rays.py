"""Rays of pixels in site, and the covariance (3, 3) in site of the point where a ray meets the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import (
    Float64Array,
    Float64N,
    Float64Nx2,
    Float64Nx3,
    Float64Nx3x3,
    Float64Nx6x6,
    RowIndices,
)
from facadelake.core.camera import Camera, PosedCamera

# Incidence limit 89.4 deg: the covariance on a plane seen edge-on is infinite.
_COSINE_MIN = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelRays:
    """Rays of k pixels in site.

    ``origin_site_m`` (k, 3); ``direction_site`` (k, 3) unit; ``direction_per_px`` (k, 3, 2): derivative of the
    direction by the pixel, to the right and down; ``solid_angle_sr`` (k,): solid angle of a pixel; ``forward_cosine``
    (k,): cosine of the angle to the optical axis, by which a distance is multiplied to get the depth.
    """

    origin_site_m: Float64Nx3
    direction_site: Float64Nx3
    direction_per_px: Float64Array
    solid_angle_sr: Float64N
    forward_cosine: Float64N


def compute_pixel_rays(cameras: Sequence[PosedCamera], camera_index: RowIndices, xy_img: Float64Nx2) -> PixelRays:
    """Rays of the pixels ``xy_img`` (k, 2), the pixel k in the photograph of ``cameras[camera_index[k]]``."""
    count = len(xy_img)
    origin, direction = np.empty((count, 3)), np.empty((count, 3))
    direction_per_px, solid, forward = np.empty((count, 3, 2)), np.empty(count), np.empty(count)
    for index in np.unique(camera_index):
        rows = np.flatnonzero(camera_index == index)
        posed = cameras[index]
        origin[rows], direction[rows] = posed.rays_site_from_img(xy_img[rows])
        rotation = posed.site_from_cam.rotation
        forward[rows] = direction[rows] @ rotation[:, 2]
        derivative_cam, solid[rows] = _differentiate_rays(posed.camera, direction[rows] @ rotation)
        direction_per_px[rows] = rotation @ derivative_cam
    return PixelRays(
        origin_site_m=origin,
        direction_site=direction,
        direction_per_px=direction_per_px,
        solid_angle_sr=solid,
        forward_cosine=forward,
    )


def _differentiate_rays(camera: Camera, rays_cam: Float64Nx3) -> tuple[Float64Array, Float64N]:
    """Derivative (k, 3, 2) of unit rays by their pixel, and the pixel's solid angle (k,) in sr.

    By inverting the Jacobian of Brown's distortion model at the rays ``rays_cam`` (k, 3).
    """
    x, y = (rays_cam[:, :2] / rays_cam[:, 2:]).T
    r2 = x * x + y * y
    radial = 1 + camera.k1 * r2 + camera.k2 * r2 * r2
    slope = 2 * camera.k1 + 4 * camera.k2 * r2  # d radial / dx = slope x
    xx = camera.fx_px * (radial + slope * x * x + 2 * camera.p1 * y + 6 * camera.p2 * x)
    yy = camera.fy_px * (radial + slope * y * y + 6 * camera.p1 * y + 2 * camera.p2 * x)
    mixed = slope * x * y + 2 * camera.p1 * x + 2 * camera.p2 * y
    xy, yx = camera.fx_px * mixed, camera.fy_px * mixed
    determinant = xx * yy - xy * yx
    inverse = np.array([[yy, -xy], [-yx, xx]]).transpose(2, 0, 1) / determinant[:, None, None]
    length = np.sqrt(1 + r2)
    # d unit = (I - unit unit') d(x, y, 1) / length
    projection = np.eye(3)[None] - rays_cam[:, :, None] * rays_cam[:, None, :]
    derivative: Float64Array = projection[:, :, :2] @ inverse / length[:, None, None]
    solid: Float64Array = 1 / (np.abs(determinant) * length**3)
    return derivative, solid


def compute_surface_covariance(
    direction_site: Float64Nx3, normal_site: Float64Nx3, model_sigma_m: float
) -> Float64Nx3x3:
    """Covariance (n, 3, 3) in m2 of positions due to the distance of the real surface from its model.

    It has rank 1, along the ray; all observations of one point share it. ``direction_site`` (n, 3) unit rays,
    ``normal_site`` (n, 3) unit normals, ``model_sigma_m`` one sigma of the distance along the normal.
    """
    along = direction_site / _compute_facing_cosine(direction_site, normal_site)[:, None]
    covariance: Float64Array = model_sigma_m**2 * along[:, :, None] * along[:, None, :]
    return covariance


def compute_ray_covariance(
    direction_site: Float64Nx3,
    distance_m: Float64N,
    normal_site: Float64Nx3,
    direction_per_px: Float64Array,
    pixel_sigma_px: Float64Nx2,
    site_from_cam: Float64Nx3x3,
    pose_covariance: Float64Nx6x6,
) -> Float64Nx3x3:
    """Covariance of positions due to their rays alone: pixel and pose, with the surface where the model has it.

    First-order propagation; the error of the ray is projected along the ray onto the surface's tangent plane.

    Args:
        direction_site: unit rays (n, 3) in site.
        distance_m: distances (n,) from the camera to the positions.
        normal_site: unit normals (n, 3) of the surface, towards the camera.
        direction_per_px: derivatives (n, 3, 2) of the rays by the pixel.
        pixel_sigma_px: one sigma (n, 2) of the pixel in x and y.
        site_from_cam: rotations (n, 3, 3) of the cameras.
        pose_covariance: covariances (n, 6, 6) of the poses: centre (m, site), attitude (rad, about the camera's own
            x, y and z axes).

    Returns:
        Covariances (n, 3, 3) in m2, in site.
    """
    cosine = _compute_facing_cosine(direction_site, normal_site)
    onto_plane = np.eye(3)[None] - direction_site[:, :, None] * normal_site[:, None, :] / cosine[:, None, None]
    shift_by_pixel = distance_m[:, None, None] * direction_per_px * pixel_sigma_px[:, None, :]
    # site_from_cam (I + [w]x) ray_cam: a rotation w about the camera's axis k shifts the ray by (axis k in site) x ray.
    axes = site_from_cam.transpose(0, 2, 1)
    shift_by_attitude = distance_m[:, None, None] * np.cross(axes, direction_site[:, None, :]).transpose(0, 2, 1)
    shift_by_pose = np.concatenate([np.broadcast_to(np.eye(3), shift_by_attitude.shape), shift_by_attitude], axis=2)
    propagated = shift_by_pixel @ shift_by_pixel.transpose(
        0, 2, 1
    ) + shift_by_pose @ pose_covariance @ shift_by_pose.transpose(0, 2, 1)
    covariance: Float64Array = onto_plane @ propagated @ onto_plane.transpose(0, 2, 1)
    return (covariance + covariance.transpose(0, 2, 1)) / 2


def _compute_facing_cosine(direction_site: Float64Nx3, normal_site: Float64Nx3) -> Float64N:
    """Cosine (n,) between rays and normals: negative, as normals face the camera, and at most ``-_COSINE_MIN``."""
    cosine: Float64Array = np.minimum(np.einsum("ij,ij->i", direction_site, normal_site), -_COSINE_MIN)
    return cosine
