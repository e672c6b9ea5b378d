"""Projection through COLMAP's OPENCV camera with its Jacobians, for many image points at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64Nx2, Float64Nx3
from facadelake.core.camera import Camera

LENS_PARAMETERS = ("focal_px", "aspect", "cx_px", "cy_px", "k1", "k2", "p1", "p2")
# One sigma of each lens parameter before the adjustment; focal length and principal point are relative to the focal
# length and the image's width. Sensors' pixels are square to a fraction of a percent.
LENS_PRIOR_SIGMA = (0.05, 0.005, 0.02, 0.02, 0.3, 0.3, 0.02, 0.02)
_MIN_DEPTH = 1e-6  # a point at or behind the camera has no image


def lens_from_camera(camera: Camera) -> Float64Array:
    """The lens parameters (8,): focal length (px), aspect fy/fx, principal point (px), k1, k2, p1, p2."""
    return np.array(
        [
            camera.fx_px,
            camera.fy_px / camera.fx_px,
            camera.cx_px,
            camera.cy_px,
            camera.k1,
            camera.k2,
            camera.p1,
            camera.p2,
        ]
    )


def camera_from_lens(lens: Float64Array, like: Camera) -> Camera:
    """The camera with lens parameters ``lens`` (8,) and the image size of ``like``."""
    focal, aspect, cx, cy, k1, k2, p1, p2 = (float(value) for value in lens)
    return Camera(
        width_px=like.width_px,
        height_px=like.height_px,
        fx_px=focal,
        fy_px=focal * aspect,
        cx_px=cx,
        cy_px=cy,
        k1=k1,
        k2=k2,
        p1=p1,
        p2=p2,
    )


def build_lens_prior(cameras: Sequence[Camera]) -> tuple[Float64Array, Float64Array]:
    """Prior mean and sigma (c, 8) of the lenses: square pixels, principal point in the image centre, no distortion."""
    mean = np.array(
        [[camera.fx_px, 1.0, camera.width_px / 2, camera.height_px / 2, 0.0, 0.0, 0.0, 0.0] for camera in cameras]
    )
    unit = np.array([[c.fx_px, 1.0, c.width_px, c.width_px, 1.0, 1.0, 1.0, 1.0] for c in cameras])
    return mean, np.array(LENS_PRIOR_SIGMA) * unit


@dataclass(frozen=True, kw_only=True, eq=False)
class ProjectedPoints:
    """Pixels ``xy_img`` (k, 2) with Jacobians by camera coordinates (k, 2, 3) and lens parameters (k, 2, 8).

    ``in_front`` (k,): the point lies before the camera; where false, pixels and Jacobians are meaningless.
    """

    xy_img: Float64Nx2
    jacobian_xyz_cam: Float64Array
    jacobian_lens: Float64Array
    in_front: BoolArray


def project(xyz_cam: Float64Nx3, lens: Float64Array) -> ProjectedPoints:
    """Project points (k, 3) in ``cam``, each through its own lens (k, 8). Source: Brown 1971, as in COLMAP's OPENCV."""
    in_front: BoolArray = xyz_cam[:, 2] > _MIN_DEPTH
    depth = np.where(in_front, xyz_cam[:, 2], 1.0)
    x, y = xyz_cam[:, 0] / depth, xyz_cam[:, 1] / depth
    focal, aspect, cx, cy, k1, k2, p1, p2 = lens.T
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    slope = 2 * (k1 + 2 * k2 * r2)  # d radial / d x is slope * x
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fy = focal * aspect
    xd_x = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    xd_y = slope * x * y + 2 * p1 * x + 2 * p2 * y
    yd_y = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    jacobian_xyz = np.empty((len(xyz_cam), 2, 3))
    jacobian_xyz[:, 0, 0], jacobian_xyz[:, 0, 1] = focal * xd_x / depth, focal * xd_y / depth
    jacobian_xyz[:, 1, 0], jacobian_xyz[:, 1, 1] = fy * xd_y / depth, fy * yd_y / depth
    jacobian_xyz[:, :, 2] = -(jacobian_xyz[:, :, 0] * x[:, None] + jacobian_xyz[:, :, 1] * y[:, None])
    jacobian_lens = np.zeros((len(xyz_cam), 2, len(LENS_PARAMETERS)))
    jacobian_lens[:, 0, 0], jacobian_lens[:, 1, 0] = xd, aspect * yd
    jacobian_lens[:, 1, 1] = focal * yd
    jacobian_lens[:, 0, 2] = jacobian_lens[:, 1, 3] = 1.0
    for column, power in ((4, r2), (5, r2 * r2)):
        jacobian_lens[:, 0, column], jacobian_lens[:, 1, column] = focal * x * power, fy * y * power
    jacobian_lens[:, 0, 6], jacobian_lens[:, 1, 6] = focal * 2 * x * y, fy * (r2 + 2 * y * y)
    jacobian_lens[:, 0, 7], jacobian_lens[:, 1, 7] = focal * (r2 + 2 * x * x), fy * 2 * x * y
    return ProjectedPoints(
        xy_img=np.column_stack([focal * xd + cx, fy * yd + cy]),
        jacobian_xyz_cam=jacobian_xyz,
        jacobian_lens=jacobian_lens,
        in_front=in_front,
    )
