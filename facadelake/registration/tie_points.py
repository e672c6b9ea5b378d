"""Points that several photographs share, put into site by the very cameras that detections are registered with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from facadelake.core.arrays import BoolArray, Float64Array, Int64Array
from facadelake.core.camera import PosedCamera

_IMAGE_POINTS_MIN = 3  # with two, a wrong match along the epipolar line leaves no residual
_SIGMA_MIN_PX = 0.5  # features are not found better
_RESIDUAL_SIGMAS_MAX = 3.0  # a point whose sightings disagree by more holds a wrong match
_EIGENVALUE_RATIO_MIN = (
    1e-4  # smallest over largest eigenvalue of the rays' information below which the distance is open: 0.6 deg
)


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockImagePoints:
    """Sightings of tie points, as structure from motion leaves them: photograph ``photo_ids[photo[k]]`` saw the point
    numbered ``point[k]`` at pixel ``xy_img[k]`` (k, 2)."""

    photo_ids: Sequence[str]
    photo: Int64Array
    point: Int64Array
    xy_img: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoImagePoints:
    """What one photograph saw: pixels (k, 2) and the points (k,), rows of ``TiePoints``."""

    xy_img: Float64Array
    point: Int64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TiePoints:
    """``xyz_site_m`` (m, 3) with ``covariance_site_m2`` (m, 3, 3), and each photograph's sightings of them."""

    xyz_site_m: Float64Array
    covariance_site_m2: Float64Array
    image_points: Mapping[str, PhotoImagePoints]


def triangulate_tie_points(tracks: BlockImagePoints, posed: Mapping[str, PosedCamera]) -> TiePoints:
    """The tie points that three or more of the cameras ``posed`` (by photo_id) agree on.

    Least squares of the rays' distances in pixels, twice: the second time each ray is weighted by its own distance.
    """
    names = list(tracks.photo_ids)
    known = np.array([name in posed for name in names], dtype=bool)
    rows = np.flatnonzero(known[tracks.photo]) if len(names) else np.zeros(0, dtype=np.int64)
    rows = rows[np.argsort(tracks.photo[rows], kind="stable")]
    photo, xy = tracks.photo[rows], tracks.xy_img[rows]
    numbers, point = np.unique(tracks.point[rows], return_inverse=True)
    origins, directions, focal_px = _compute_rays(names, photo, xy, posed)
    xyz, covariance, good = _intersect_rays(origins, directions, focal_px, point, len(numbers))
    renumbered = np.cumsum(good) - 1
    sights = {}
    for index in np.unique(photo):
        start, stop = np.searchsorted(photo, [index, index + 1])
        mine = start + np.flatnonzero(good[point[start:stop]])
        sights[names[index]] = PhotoImagePoints(xy_img=xy[mine], point=renumbered[point[mine]])
    return TiePoints(xyz_site_m=xyz[good], covariance_site_m2=covariance[good], image_points=sights)


def _compute_rays(
    names: Sequence[str], photo: Int64Array, xy: Float64Array, posed: Mapping[str, PosedCamera]
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Origins and directions (k, 3) and focal lengths (k,) of sightings, which come by photograph."""
    origins, directions, focal_px = np.zeros((len(xy), 3)), np.zeros((len(xy), 3)), np.ones(len(xy))
    for index in np.unique(photo):
        part = slice(*np.searchsorted(photo, [index, index + 1]))
        camera = posed[names[index]]
        origins[part], directions[part] = camera.rays_site_from_img(xy[part])
        focal_px[part] = np.sqrt(camera.camera.fx_px * camera.camera.fy_px)
    return origins, directions, focal_px


def _intersect_rays(
    origins: Float64Array, directions: Float64Array, focal_px: Float64Array, point: Int64Array, count: int
) -> tuple[Float64Array, Float64Array, BoolArray]:
    """Points (count, 3), their covariance (count, 3, 3) and which are to be believed."""
    along = np.zeros(len(origins))
    weight = np.ones(len(origins))
    enough = np.bincount(point, minlength=count) >= _IMAGE_POINTS_MIN
    xyz: Float64Array = np.zeros((count, 3))
    information: Float64Array = np.zeros((count, 3, 3))
    foot = origins - np.einsum("ki,ki->k", origins, directions)[:, None] * directions
    for _ in range(2):
        right = np.zeros((count, 3))
        # Column by column: a matrix (3, 3) for each of ten million sightings would take 0.7 GB.
        for i in range(3):
            right[:, i] = np.bincount(point, weights=weight * foot[:, i], minlength=count)
            for j in range(3):
                across = float(i == j) - directions[:, i] * directions[:, j]
                information[:, i, j] = np.bincount(point, weights=weight * across, minlength=count)
        values = np.linalg.eigvalsh(information)
        enough = enough & (values[:, 0] > _EIGENVALUE_RATIO_MIN * values[:, 2])
        information[~enough] = np.eye(3)
        xyz = np.asarray(np.linalg.solve(information, right[:, :, None])[:, :, 0], dtype=np.float64)
        along = np.einsum("ki,ki->k", xyz[point] - origins, directions)
        weight = (focal_px / np.maximum(along, 0.1)) ** 2
    behind = np.bincount(point, weights=along <= 0, minlength=count) > 0
    off = xyz[point] - origins - along[:, None] * directions
    off_px2 = weight * np.einsum("ki,ki->k", off, off)
    sights = np.maximum(np.bincount(point, minlength=count), 1)
    # A sighting has two residuals, a point takes three of them.
    rms_px = np.sqrt(np.bincount(point, weights=off_px2, minlength=count) / np.maximum(2 * sights - 3, 1))
    good = enough & ~behind
    sigma_px = max(_SIGMA_MIN_PX, float(np.median(rms_px[good]))) if good.any() else _SIGMA_MIN_PX
    good &= rms_px <= _RESIDUAL_SIGMAS_MAX * sigma_px
    covariance = np.zeros((count, 3, 3))
    covariance[good] = sigma_px**2 * np.linalg.inv(information[good])
    return xyz, covariance, good
