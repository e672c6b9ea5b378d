"""Rays of pixels, and how they turn from pixel to pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facadelake.core.camera import Camera, PosedCamera
from facadelake.core.frames import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelRays:
    """Rays of k pixels in site: ``origin_site_m`` (k, 3), ``direction_site`` (k, 3) unit, ``by_pixel`` (k, 3, 2) what
    the direction turns by a pixel to the right and down, ``solid_angle`` (k,) steradian a square pixel, and
    ``forward`` (k,) the share of a distance that is depth."""

    origin_site_m: Array
    direction_site: Array
    by_pixel: Array
    solid_angle: Array
    forward: Array


def rays_of(cameras: Sequence[PosedCamera], camera_of: NDArray[np.int64], xy_img: Array) -> PixelRays:
    """Rays of the pixels ``xy_img`` (k, 2), each of ``cameras[camera_of]`` (k,)."""
    count = len(xy_img)
    origin, direction = np.empty((count, 3)), np.empty((count, 3))
    by_pixel, solid, forward = np.empty((count, 3, 2)), np.empty(count), np.empty(count)
    for number in np.unique(camera_of):
        own = np.flatnonzero(camera_of == number)
        posed = cameras[number]
        origin[own], direction[own] = posed.rays_site(xy_img[own])
        rotation = posed.site_from_cam.rotation
        forward[own] = direction[own] @ rotation[:, 2]
        turned, solid[own] = _turned_by_a_pixel(posed.camera, direction[own] @ rotation)
        by_pixel[own] = rotation @ turned
    return PixelRays(
        origin_site_m=origin, direction_site=direction, by_pixel=by_pixel, solid_angle=solid, forward=forward
    )


def _turned_by_a_pixel(camera: Camera, rays_cam: Array) -> tuple[Array, Array]:
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
    turned: Array = across[:, :, :2] @ plane / length[:, None, None]
    solid: Array = 1 / (np.abs(grown) * length**3)
    return turned, solid
