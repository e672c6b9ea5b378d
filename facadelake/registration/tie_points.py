"""Tie points in site, triangulated with the poses that detections are registered with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import (
    BoolArray,
    Float64Array,
    Float64N,
    Float64Nx2,
    Float64Nx3,
    Float64Nx3x3,
    Int64Array,
    RowIndices,
)
from facadelake.core.camera import PosedCamera

_IMAGE_POINTS_MIN = 3  # with two, a wrong match along the epipolar line has no residual
_SIGMA_MIN_PX = 0.5  # features are not located more accurately
_RESIDUAL_SIGMAS_MAX = 3.0  # a tie point with larger residuals contains a wrong match
# Smallest over largest eigenvalue of the information matrix: rays that meet at 0.6 deg do not determine the distance.
_EIGENVALUE_RATIO_MIN = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockImagePoints:
    """Image points of a reconstruction.

    Photograph ``photo_ids[photo[k]]`` shows the tie point numbered ``point[k]`` at the pixel ``xy_img[k]`` (k, 2).
    """

    photo_ids: Sequence[str]
    photo: RowIndices
    point: Int64Array
    xy_img: Float64Nx2


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoImagePoints:
    """Image points of one photograph: pixels (k, 2), and their tie points (k,) as rows of ``TiePoints``."""

    xy_img: Float64Nx2
    point: RowIndices


@dataclass(frozen=True, kw_only=True, eq=False)
class TiePoints:
    """``xyz_site_m`` (m, 3), ``covariance_site_m2`` (m, 3, 3), and the image points of each photograph by photo_id."""

    xyz_site_m: Float64Nx3
    covariance_site_m2: Float64Nx3x3
    image_points: Mapping[str, PhotoImagePoints]


def triangulate_tie_points(image_points: BlockImagePoints, posed: Mapping[str, PosedCamera]) -> TiePoints:
    """The tie points on which three or more of the cameras ``posed`` (by photo_id) agree.

    Least squares of the distances from the rays in pixels, in two iterations: in the second each ray is weighted by its
    own distance.
    """
    names = list(image_points.photo_ids)
    localised = np.array([name in posed for name in names], dtype=bool)
    rows = np.flatnonzero(localised[image_points.photo]) if len(names) else np.zeros(0, dtype=np.int64)
    rows = rows[np.argsort(image_points.photo[rows], kind="stable")]
    photo, xy = image_points.photo[rows], image_points.xy_img[rows]
    numbers, point = np.unique(image_points.point[rows], return_inverse=True)
    origins, directions, focal_px = _compute_rays(names, photo, xy, posed)
    xyz, covariance, valid = _intersect_rays(origins, directions, focal_px, point, len(numbers))
    renumbered = np.cumsum(valid) - 1
    by_photo = {}
    for index in np.unique(photo):
        start, stop = np.searchsorted(photo, [index, index + 1])
        selected = start + np.flatnonzero(valid[point[start:stop]])
        by_photo[names[index]] = PhotoImagePoints(xy_img=xy[selected], point=renumbered[point[selected]])
    return TiePoints(xyz_site_m=xyz[valid], covariance_site_m2=covariance[valid], image_points=by_photo)


def _compute_rays(
    names: Sequence[str], photo: RowIndices, xy: Float64Nx2, posed: Mapping[str, PosedCamera]
) -> tuple[Float64Nx3, Float64Nx3, Float64N]:
    """Rays of image points.

    Args:
        names: photo_ids.
        photo: photograph (k,) of each image point, ascending.
        xy: pixels (k, 2).
        posed: cameras by photo_id.

    Returns:
        Origins (k, 3) and unit directions (k, 3) in site, focal lengths (k,) in pixels.
    """
    origins, directions, focal_px = np.zeros((len(xy), 3)), np.zeros((len(xy), 3)), np.ones(len(xy))
    for index in np.unique(photo):
        selected = slice(*np.searchsorted(photo, [index, index + 1]))
        camera = posed[names[index]]
        origins[selected], directions[selected] = camera.rays_site_from_img(xy[selected])
        focal_px[selected] = np.sqrt(camera.camera.fx_px * camera.camera.fy_px)
    return origins, directions, focal_px


def _intersect_rays(
    origins: Float64Nx3, directions: Float64Nx3, focal_px: Float64N, point: RowIndices, count: int
) -> tuple[Float64Nx3, Float64Nx3x3, BoolArray]:
    """Intersect the rays of each tie point.

    Args:
        origins: origins (k, 3) in site.
        directions: unit directions (k, 3) in site.
        focal_px: focal lengths (k,).
        point: tie point (k,) of each ray.
        count: number of tie points.

    Returns:
        Points (count, 3), covariances (count, 3, 3) in m2, and which are valid (count,).
    """
    depth = np.zeros(len(origins))
    weight = np.ones(len(origins))
    determined = np.bincount(point, minlength=count) >= _IMAGE_POINTS_MIN
    xyz: Float64Array = np.zeros((count, 3))
    information: Float64Array = np.zeros((count, 3, 3))
    foot = origins - np.einsum("ki,ki->k", origins, directions)[:, None] * directions
    for _ in range(2):
        right = np.zeros((count, 3))
        # Element by element: a matrix (3, 3) for each of ten million image points would need 0.7 GB.
        for i in range(3):
            right[:, i] = np.bincount(point, weights=weight * foot[:, i], minlength=count)
            for j in range(3):
                across = float(i == j) - directions[:, i] * directions[:, j]
                information[:, i, j] = np.bincount(point, weights=weight * across, minlength=count)
        values = np.linalg.eigvalsh(information)
        determined = determined & (values[:, 0] > _EIGENVALUE_RATIO_MIN * values[:, 2])
        information[~determined] = np.eye(3)
        xyz = np.asarray(np.linalg.solve(information, right[:, :, None])[:, :, 0], dtype=np.float64)
        depth = np.einsum("ki,ki->k", xyz[point] - origins, directions)
        weight = (focal_px / np.maximum(depth, 0.1)) ** 2
    behind = np.bincount(point, weights=depth <= 0, minlength=count) > 0
    residual = xyz[point] - origins - depth[:, None] * directions
    residual_px2 = weight * np.einsum("ki,ki->k", residual, residual)
    ray_count = np.maximum(np.bincount(point, minlength=count), 1)
    # An image point has two residuals; a tie point has three unknowns.
    rms_px = np.sqrt(np.bincount(point, weights=residual_px2, minlength=count) / np.maximum(2 * ray_count - 3, 1))
    valid = determined & ~behind
    sigma_px = max(_SIGMA_MIN_PX, float(np.median(rms_px[valid]))) if valid.any() else _SIGMA_MIN_PX
    valid &= rms_px <= _RESIDUAL_SIGMAS_MAX * sigma_px
    covariance = np.zeros((count, 3, 3))
    covariance[valid] = sigma_px**2 * np.linalg.inv(information[valid])
    return xyz, covariance, valid
