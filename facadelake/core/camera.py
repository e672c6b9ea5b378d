"""A calibrated camera: rays from pixels and pixels from points, in COLMAP's OPENCV model.

Pixels: the centre of the top left pixel is (0.5, 0.5), for image points and for the principal point alike.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import cv2
import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Float64Nx2, Float64Nx3, Float64x3, Float64x3x3
from facadelake.core.errors import InputDataError
from facadelake.core.frames import Similarity


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Intrinsics in pixels; ``k1 k2 p1 p2`` are Brown's radial and tangential terms (COLMAP's OPENCV model)."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def __post_init__(self) -> None:
        values = np.array(astuple(self), dtype=np.float64)
        if not np.isfinite(values).all() or min(self.width_px, self.height_px, self.fx_px, self.fy_px) <= 0:
            raise InputDataError(
                f"camera {self} is not usable: sizes and focal lengths must be positive, every value finite"
            )

    @property
    def matrix(self) -> Float64x3x3:
        """The calibration matrix (3, 3): focal lengths and principal point, px."""
        return np.array([[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1.0]])

    @property
    def distortion(self) -> Float64Array:
        """``k1, k2, p1, p2`` in OpenCV's order."""
        return np.array([self.k1, self.k2, self.p1, self.p2])

    def rays_cam_from_img(self, xy_img: Float64Nx2) -> Float64Nx3:
        """Unit ray directions (n, 3) in ``cam`` of pixels (n, 2); distortion is inverted iteratively to 1e-10."""
        xy = np.asarray(xy_img, dtype=np.float64).reshape(-1, 1, 2)
        if len(xy) == 0:
            return np.zeros((0, 3))
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
        normalised = cv2.undistortPoints(xy, self.matrix, self.distortion, criteria=stop).reshape(-1, 2)
        rays = np.column_stack([normalised, np.ones(len(normalised))]).astype(np.float64)
        unit: Float64Nx3 = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return unit

    def project(self, xyz_cam: Float64Nx3) -> Float64Nx2:
        """Pixels (n, 2) of points (n, 3) in ``cam``; NaN for points at or behind the camera."""
        xyz = np.asarray(xyz_cam, dtype=np.float64).reshape(-1, 3)
        in_front = xyz[:, 2] > 1e-9
        xy = np.full((len(xyz), 2), np.nan)
        if in_front.any():
            x, y = (xyz[in_front, :2] / xyz[in_front, 2:]).T
            r2 = x * x + y * y
            radial = 1 + self.k1 * r2 + self.k2 * r2 * r2
            xd = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
            yd = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
            xy[in_front] = np.column_stack([self.fx_px * xd + self.cx_px, self.fy_px * yd + self.cy_px])
        return xy

    def is_inside(self, xy_img: Float64Nx2) -> BoolArray:
        """Whether each pixel (n, 2) lies inside the photograph (n,)."""
        xy = np.asarray(xy_img, dtype=np.float64).reshape(-1, 2)
        return (xy[:, 0] >= 0) & (xy[:, 0] <= self.width_px) & (xy[:, 1] >= 0) & (xy[:, 1] <= self.height_px)


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedCamera:
    """A camera with its pose; ``site_from_cam`` is rigid (scale 1)."""

    camera: Camera
    site_from_cam: Similarity

    @property
    def centre_site_m(self) -> Float64x3:
        """The projection centre (3,) in ``site``, metres."""
        return self.site_from_cam.translation

    def rays_site_from_img(self, xy_img: Float64Nx2) -> tuple[Float64Nx3, Float64Nx3]:
        """Origins (n, 3) and unit directions (n, 3) in ``site`` of the rays through pixels (n, 2)."""
        directions = self.site_from_cam.rotate(self.camera.rays_cam_from_img(xy_img))
        return np.broadcast_to(self.centre_site_m, directions.shape).copy(), directions

    def project_site(self, xyz_site_m: Float64Nx3) -> Float64Nx2:
        """Pixels (n, 2) of points (n, 3) in ``site``; NaN for points at or behind the camera."""
        return self.camera.project(self.site_from_cam.invert().apply(xyz_site_m))
