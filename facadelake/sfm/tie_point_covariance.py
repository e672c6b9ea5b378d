"""How well, from where and how finely each tie point was seen, the cameras taken as they stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import Float64Array, Int64Array
from facadelake.core.camera import PosedCamera
from facadelake.sfm.reconstruction import Reconstruction

# The mean length of a residual of two coordinates is 1.25 times the sigma of one (Rayleigh).
_RAYLEIGH_MEAN = 1.2533
_MIN_SIGMA_PX = 0.2


def estimate_pixel_sigma(reconstruction: Reconstruction) -> float:
    """One sigma of a tie point's sighting along x or y, in pixels of the photographs as stored, from the residuals."""
    return max(reconstruction.mean_reprojection_error_px / _RAYLEIGH_MEAN, _MIN_SIGMA_PX)


def compute_tie_point_covariance(
    reconstruction: Reconstruction, cameras: Sequence[PosedCamera], xyz: Float64Array, *, sigma_px: float
) -> Float64Array:
    """Covariance (m, 3, 3) of points ``xyz`` (m, 3) from their sightings in ``cameras``, one for each photograph.

    Cameras and points are in one frame, ``site`` or any other; the covariance is in its units. It is conditional: what
    the cameras themselves are wrong by is not in it. NaN where the sightings leave a direction open (one photograph),
    and for points that are NaN.
    Source: Foerstner and Wrobel 2016, Photogrammetric Computer Vision, section 13.4.
    """
    information = np.zeros((len(xyz), 3, 3))
    known = np.asarray(np.isfinite(xyz).all(axis=1))
    for k, posed in enumerate(cameras):
        rows = reconstruction.image_point_tie_point[reconstruction.image_point_photo == k]
        rows = rows[known[rows]]
        cam_from_frame = posed.site_from_cam.invert()
        x, y, z = cam_from_frame.apply(xyz[rows]).T
        # Distortion stretches a pixel by a few per cent: nothing to a covariance.
        zero = np.zeros_like(z)
        across = np.stack([posed.camera.fx_px / z, zero, -posed.camera.fx_px * x / z**2], axis=1)
        down = np.stack([zero, posed.camera.fy_px / z, -posed.camera.fy_px * y / z**2], axis=1)
        jacobian = np.stack([across, down], axis=1) @ (cam_from_frame.rotation * cam_from_frame.scale)
        np.add.at(information, rows, jacobian.transpose(0, 2, 1) @ jacobian / sigma_px**2)
    covariance = np.full_like(information, np.nan)
    values = np.linalg.eigvalsh(information)
    fixed = values[:, 0] > 1e-9 * values[:, 2]
    covariance[fixed] = np.linalg.inv(information[fixed])
    return covariance


@dataclass(frozen=True, kw_only=True, eq=False)
class TiePointViews:
    """Of each tie point: ``photographs`` (m,) that saw it, the mean unit ``direction`` (m, 3) in which they looked, and
    the finest ``gsd`` (m,), the length of a pixel there (inf where no photograph saw it)."""

    photographs: Int64Array
    direction: Float64Array
    gsd: Float64Array


def describe_tie_point_views(
    reconstruction: Reconstruction, cameras: Sequence[PosedCamera], xyz: Float64Array
) -> TiePointViews:
    """How ``cameras``, one for each photograph, saw the points ``xyz`` (m, 3); both are in one frame, any."""
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
