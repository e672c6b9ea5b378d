"""Covariance of tie points and the geometry of their image points, with the cameras taken as known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64N, Float64Nx3, Float64Nx3x3, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.sfm.reconstruction import Reconstruction

# The mean length of a residual of two coordinates is 1.25 times the sigma of one (Rayleigh).
_RAYLEIGH_MEAN = 1.2533
_MIN_SIGMA_PX = 0.2


def estimate_pixel_sigma(reconstruction: Reconstruction) -> float:
    """One sigma of an image point in x or y, in pixels of the photographs as stored, from the reprojection errors."""
    return max(reconstruction.mean_reprojection_error_px / _RAYLEIGH_MEAN, _MIN_SIGMA_PX)


def compute_tie_point_covariance(
    reconstruction: Reconstruction, cameras: Sequence[PosedCamera], xyz: Float64Nx3, *, sigma_px: float
) -> Float64Nx3x3:
    """Covariance (m, 3, 3) of points from their image points, conditional on the cameras.

    The uncertainty of the cameras themselves is not included. Source: Foerstner and Wrobel 2016, Photogrammetric
    Computer Vision, section 13.4.

    Args:
        reconstruction: the block whose image points determine the points.
        cameras: one for each photograph of the block, in the frame of ``xyz`` (``site`` or any other).
        xyz: the tie points (m, 3).
        sigma_px: one sigma of an image point in x or y, pixels.

    Returns:
        The covariance in squared units of the frame; NaN for points that are NaN, and where the image points leave a
        direction undetermined (one photograph).
    """
    information = np.zeros((len(xyz), 3, 3))
    finite = np.asarray(np.isfinite(xyz).all(axis=1))
    for k, posed in enumerate(cameras):
        rows = reconstruction.image_point_tie_point[reconstruction.image_point_photo == k]
        rows = rows[finite[rows]]
        cam_from_frame = posed.site_from_cam.invert()
        x, y, z = cam_from_frame.apply(xyz[rows]).T
        # Distortion changes the scale by a few per cent, which is negligible for a covariance.
        zero = np.zeros_like(z)
        row_x = np.stack([posed.camera.fx_px / z, zero, -posed.camera.fx_px * x / z**2], axis=1)
        row_y = np.stack([zero, posed.camera.fy_px / z, -posed.camera.fy_px * y / z**2], axis=1)
        jacobian = np.stack([row_x, row_y], axis=1) @ (cam_from_frame.rotation * cam_from_frame.scale)
        np.add.at(information, rows, jacobian.transpose(0, 2, 1) @ jacobian / sigma_px**2)
    covariance = np.full_like(information, np.nan)
    values = np.linalg.eigvalsh(information)
    determined = values[:, 0] > 1e-9 * values[:, 2]
    covariance[determined] = np.linalg.inv(information[determined])
    return covariance


@dataclass(frozen=True, kw_only=True, eq=False)
class TiePointViews:
    """How each tie point was observed.

    ``photographs`` (m,) counts the photographs that show it, ``direction`` (m, 3) is the mean viewing direction (unit
    vectors), ``gsd`` (m,) the smallest ground sampling distance, in units of the frame (inf without a photograph).
    """

    photographs: Int64Array
    direction: Float64Nx3
    gsd: Float64N


def describe_tie_point_views(
    reconstruction: Reconstruction, cameras: Sequence[PosedCamera], xyz: Float64Nx3
) -> TiePointViews:
    """How ``cameras``, one for each photograph, observed the points ``xyz`` (m, 3); both are in the same frame."""
    photographs = np.zeros(len(xyz), dtype=np.int64)
    direction, gsd = np.zeros((len(xyz), 3)), np.full(len(xyz), np.inf)
    for k, posed in enumerate(cameras):
        rows = np.unique(reconstruction.image_point_tie_point[reconstruction.image_point_photo == k])
        ray = xyz[rows] - posed.centre_site_m
        distance = np.linalg.norm(ray, axis=1)
        photographs[rows] += 1
        direction[rows] += ray / distance[:, None]
        gsd[rows] = np.fmin(gsd[rows], distance / posed.camera.fx_px)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    return TiePointViews(photographs=photographs, direction=direction / np.where(length > 0, length, 1.0), gsd=gsd)
