"""How well a detection's place on the surface is known: its 3x3 covariance in site, by exact derivatives.

The place is where the ray ``centre + t direction`` meets the plane ``normal . x = h``. Moving the ray by ``d`` at the
place moves the place by ``P d`` with ``P = I - direction normal' / (normal . direction)``: off the ray, back onto the
plane. Moving the plane out by ``b`` moves it by ``b direction / (normal . direction)``, along the ray: much, where the
ray grazes.
"""

from __future__ import annotations

import numpy as np

from facadelake.core.frames import Array

_LEAST_COSINE = 0.01  # of a ray flatter than 89.4 deg to the normal nothing finite can be said


def surface_covariance(direction_site: Array, normal_site: Array, model_sigma_m: float) -> Array:
    """Covariance (n, 3, 3) in m2 of places by a surface that stands ``model_sigma_m`` (one sigma) off its model.

    It has rank 1, along the ray; all sightings of a place share the surface.
    """
    along = direction_site / _facing(direction_site, normal_site)[:, None]
    covariance: Array = model_sigma_m**2 * along[:, :, None] * along[:, None, :]
    return covariance


def ray_covariance(
    direction_site: Array,
    distance_m: Array,
    normal_site: Array,
    by_pixel: Array,
    pixel_sigma_px: Array,
    site_from_cam: Array,
    pose_covariance: Array,
) -> Array:
    """Covariance (n, 3, 3) in m2 of places by their rays alone, on a surface that is where the model has it.

    ``direction_site`` (n, 3) unit, ``normal_site`` (n, 3); ``by_pixel`` (n, 3, 2): the direction's derivative by the
    pixel, ``pixel_sigma_px`` (n, 2) in x and y; ``site_from_cam`` (n, 3, 3) rotations; ``pose_covariance`` (n, 6, 6):
    centre (m, site) and attitude (rad, about the camera's own x, y, z).
    """
    cosine = _facing(direction_site, normal_site)
    onto_plane = np.eye(3)[None] - direction_site[:, :, None] * normal_site[:, None, :] / cosine[:, None, None]
    by_pixels = distance_m[:, None, None] * by_pixel * pixel_sigma_px[:, None, :]
    # site_from_cam (I + [turn]x) ray_cam: a turn about the camera's axis k moves the ray by (axis k in site) x ray.
    axes = site_from_cam.transpose(0, 2, 1)
    by_turn = distance_m[:, None, None] * np.cross(axes, direction_site[:, None, :]).transpose(0, 2, 1)
    by_pose = np.concatenate([np.broadcast_to(np.eye(3), by_turn.shape), by_turn], axis=2)
    moved = by_pixels @ by_pixels.transpose(0, 2, 1) + by_pose @ pose_covariance @ by_pose.transpose(0, 2, 1)
    covariance: Array = onto_plane @ moved @ onto_plane.transpose(0, 2, 1)
    return (covariance + covariance.transpose(0, 2, 1)) / 2


def _facing(direction_site: Array, normal_site: Array) -> Array:
    """``normal . direction`` (n,): negative, as normals face the camera, and kept off zero."""
    cosine: Array = np.minimum(np.einsum("ij,ij->i", direction_site, normal_site), -_LEAST_COSINE)
    return cosine
